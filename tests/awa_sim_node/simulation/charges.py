"""Bunches of known shape, for the tests of the simulation."""

from __future__ import annotations

import numpy as np
from scipy.stats import qmc

from awa_sim_node.simulation.bunch import FLYING, Bunch, FloatArray
from awa_sim_node.simulation.field_map import FieldMap, empty_map
from awa_sim_node.simulation.pusher import Beamline


def bunch_of(positions: FloatArray, momentum: FloatArray | float, charge: float = -1e-9) -> Bunch:
    """Particles at positions [m], ``(n, 3)``, with momenta [mc], ``(n, 3)`` or p_z alone."""
    n = len(positions)
    phase_space = np.zeros((n, 6))
    phase_space[:, :3] = positions
    if np.ndim(momentum) == 0:
        phase_space[:, 5] = momentum
    else:
        phase_space[:, 3:] = momentum
    return Bunch(phase_space, np.zeros(n), np.full(n, FLYING, dtype=np.int8), charge / n)


def uniform_sphere(n: int) -> FloatArray:
    """Points that fill the unit sphere evenly, ``(n, 3)``."""
    u = qmc.Sobol(3, scramble=True, seed=1).random(n)
    r, cosine, angle = np.cbrt(u[:, 0]), 2.0 * u[:, 1] - 1.0, 2.0 * np.pi * u[:, 2]
    across = r * np.sqrt(1.0 - cosine**2)
    return np.column_stack([across * np.cos(angle), across * np.sin(angle), r * cosine])


def uniform_cylinder(n: int) -> FloatArray:
    """Points that fill a cylinder of radius 1 from z = -1 to 1 evenly, ``(n, 3)``."""
    u = qmc.Sobol(3, scramble=True, seed=1).random(n)
    r, angle = np.sqrt(u[:, 0]), 2.0 * np.pi * u[:, 1]
    return np.column_stack([r * np.cos(angle), r * np.sin(angle), 2.0 * u[:, 2] - 1.0])


def no_map(components: int = 3) -> FieldMap:
    """A map of no field, over a millimetre."""
    field = empty_map(0.05, 2, 0.0, 1e-3, 2)
    return field._replace(values=np.zeros((2, 2, components)))


def constant_map(*values: float, length: float = 5.0) -> FieldMap:
    """A map whose components are the same everywhere."""
    field = empty_map(0.05, 2, 0.0, length, 3)
    return field._replace(values=np.broadcast_to(np.array(values), (2, 3, len(values))).copy())


def beamline(
    gun: FieldMap | None = None,
    solenoids: FieldMap | None = None,
    linac: FieldMap | None = None,
    coupler_kick: float = 0.0,
) -> Beamline:
    """A beamline of which all but the given fields are off."""
    return Beamline(gun or no_map(), solenoids or no_map(2), linac or no_map(), coupler_kick)
