"""The quadrupole kick of the linac's power coupler, which makes the beam wider than high."""

from __future__ import annotations

import math
from typing import Final

from numba import njit

CENTRE: Final = 0.81
"""Centre of the kick [m from the cathode]."""

HALF_LENGTH: Final = 0.1
"""Distance of either end of the kick from its centre [m]; the profile is a squared cosine."""


@njit(cache=True)
def gradient(z: float, strength: float) -> float:
    """Return the gradient dB_y/dx [T/m] of the kick.

    The profile is smooth, so that particle steps across its ends stay accurate.

    Args:
        z: Position [m from the cathode].
        strength: Integral of the gradient over z [T].
    """
    distance = abs(z - CENTRE)
    if distance >= HALF_LENGTH:
        return 0.0
    return strength / HALF_LENGTH * math.cos(0.5 * math.pi * distance / HALF_LENGTH) ** 2
