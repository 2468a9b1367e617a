"""Moments of a bunch: sizes, emittances and energy, as diagnostics would measure them."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from awa_sim_node.simulation.bunch import Bunch
from awa_sim_node.simulation.constants import ELECTRON_REST_ENERGY

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class Moments:
    """Moments of the flying particles; the fields are the surrogate's outputs.

    Attributes:
        sigma_x: Rms width [mm].
        sigma_y: Rms height [mm].
        sigma_z: Rms length [mm].
        eps_x: Normalised rms emittance, horizontal [mm mrad].
        eps_y: Normalised rms emittance, vertical [mm mrad].
        eps_z: Normalised rms emittance, longitudinal, of z and p_z/mc [mm mrad].
        dE: Rms energy spread [MeV].
        energy: Mean kinetic energy [MeV].
        transmission: Flying particles as a fraction of all particles.
    """

    sigma_x: float
    sigma_y: float
    sigma_z: float
    eps_x: float
    eps_y: float
    eps_z: float
    dE: float  # noqa: N815 (the name of the output)
    energy: float
    transmission: float


def moments(bunch: Bunch) -> Moments:
    """Return the moments of a bunch.

    With fewer than 2 flying particles, all moments except the transmission are NaN.
    """
    particles = bunch.flying
    share = len(particles) / len(bunch.state)
    if len(particles) < 2:
        return Moments(*[*[math.nan] * 8, share])
    energy = ELECTRON_REST_ENERGY * (np.sqrt(1.0 + (particles[:, 3:] ** 2).sum(axis=1)) - 1.0)
    sigma = 1e3 * particles[:, :3].std(axis=0)
    emittances = [emittance(particles[:, q], particles[:, 3 + q]) for q in range(3)]
    values = [*sigma, *emittances, energy.std(), energy.mean(), share]
    return Moments(*[float(value) for value in values])


def emittance(position: FloatArray, momentum: FloatArray) -> float:
    """Return the normalised rms emittance [mm mrad] of positions [m] and momenta [mc]."""
    covariance = np.cov(position, momentum, bias=True)
    return 1e6 * math.sqrt(max(float(np.linalg.det(covariance)), 0.0))
