"""The bunch of macro-particles that the laser frees from the cathode."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.special import erf, ndtri
from scipy.stats import qmc

from awa_sim_node.simulation.constants import ELECTRON_REST_ENERGY

FloatArray = NDArray[np.float64]

WAITING: Final = 0
FLYING: Final = 1
LOST: Final = 2

_EDGE_SIGMAS: Final = 4.0
_RISE_OVER_SIGMA: Final = 1.6869  # OPAL's definition of the rise: 10 % to 90 % of a Gaussian


@dataclass(frozen=True)
class Laser:
    """A round uniform spot with a flat top in time.

    Attributes:
        radius: Radius of the spot [m].
        duration: Full width at half maximum [s].
        rise_time: Rise time of the edges, by OPAL's definition [s].
        transverse_energy: Mean transverse energy of the emitted electrons [eV].
    """

    radius: float = 9e-3
    duration: float = 6e-12
    rise_time: float = 1.0745e-12
    transverse_energy: float = 0.3

    @property
    def tail(self) -> float:
        """Time from the first electron to the half height of the leading edge [s]."""
        return _EDGE_SIGMAS * self.rise_time / _RISE_OVER_SIGMA

    @property
    def centre(self) -> float:
        """Time from the first electron to the centre of the pulse [s]."""
        return 0.5 * self.duration + self.tail

    def emission_times(self, quantiles: FloatArray) -> FloatArray:
        """Return the times at which the given fractions of the charge have been emitted [s]."""
        sigma = self.rise_time / _RISE_OVER_SIGMA * math.sqrt(2.0)
        half = 0.5 * self.duration
        times = np.linspace(-self.centre, self.centre, 4001)
        power = erf((times + half) / sigma) - erf((times - half) / sigma)
        emitted = np.cumsum(power)
        emitted = (emitted - emitted[0]) / (emitted[-1] - emitted[0])
        return np.interp(quantiles, emitted, times) + self.centre


@dataclass(frozen=True)
class Bunch:
    """Macro-particles of equal charge.

    Attributes:
        phase_space: Positions x, y, z [m] and momenta p_x, p_y, p_z [mc], ``(n, 6)``; before its
            emission a particle is at the cathode.
        emission: Emission time of each particle [s], ``(n,)``.
        state: State of each particle, ``WAITING``, ``FLYING`` or ``LOST``, ``(n,)``.
        particle_charge: Charge of one particle [C].
    """

    phase_space: FloatArray
    emission: FloatArray
    state: NDArray[np.int8]
    particle_charge: float

    @property
    def flying(self) -> FloatArray:
        """Phase space of the flying particles."""
        flying: FloatArray = self.phase_space[self.state == FLYING]
        return flying


def emit(laser: Laser, charge: float, particles: int, seed: int) -> Bunch:
    """Sample a bunch of electrons from scrambled quasi-random numbers.

    Each has a twin rotated by 90 degrees about the axis, so that the bunch is as wide as high.

    Args:
        laser: Laser pulse that frees the electrons.
        charge: Magnitude of the bunch's charge [C].
        particles: Number of macro-particles.
        seed: Seed of the scrambling.

    Raises:
        ValueError: If the seed is negative.
    """
    if seed < 0:
        raise ValueError(f"seed = {seed} must be 0 or more")
    pairs = -(-particles // 2)
    sequence = qmc.Sobol(6, scramble=True, seed=seed)
    # Sobol points come in powers of two; any first part of them also fills the space.
    u = sequence.random_base2(max(pairs - 1, 1).bit_length())[:pairs]
    u = np.clip(u, 1e-9, 1.0 - 1e-9)
    r, angle = laser.radius * np.sqrt(u[:, 0]), 2.0 * np.pi * u[:, 1]
    thermal = math.sqrt(laser.transverse_energy * 1e-6 / ELECTRON_REST_ENERGY)
    phase_space = np.zeros((pairs, 2, 6))
    one, twin = phase_space[:, 0], phase_space[:, 1]
    one[:, 0], one[:, 1] = r * np.cos(angle), r * np.sin(angle)
    one[:, 3], one[:, 4] = thermal * ndtri(u[:, 3]), thermal * ndtri(u[:, 4])
    # The flux through a surface is proportional to the velocity across it.
    one[:, 5] = thermal * np.sqrt(-2.0 * np.log(u[:, 5]))
    twin[:, [0, 3, 5]] = one[:, [1, 4, 5]] * [-1.0, -1.0, 1.0]
    twin[:, [1, 4]] = one[:, [0, 3]]
    emission = np.repeat(laser.emission_times(u[:, 2]), 2)[:particles]
    phase_space = np.ascontiguousarray(phase_space.reshape(-1, 6)[:particles])
    state = np.full(particles, WAITING, dtype=np.int8)
    return Bunch(phase_space, emission, state, -charge / particles)
