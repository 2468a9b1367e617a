"""The quadrupole kick of the linac's power coupler, which makes the beam wider than high."""

from __future__ import annotations

import math
from typing import Final

from numba import njit

CENTRE: Final = 0.81
"""Of the kick [m from the cathode]."""

HALF_LENGTH: Final = 0.1
"""Where the kick ends on either side of the centre [m]; its profile is a squared cosine."""


@njit(cache=True)
def gradient(z: float, strength: float) -> float:
    """Return the gradient dB_y/dx [T/m] at z [m] of a kick integrated to ``strength`` [T].

    It rises and falls smoothly, so that no step of a particle is half inside.
    """
    distance = abs(z - CENTRE)
    if distance >= HALF_LENGTH:
        return 0.0
    return strength / HALF_LENGTH * math.cos(0.5 * math.pi * distance / HALF_LENGTH) ** 2
