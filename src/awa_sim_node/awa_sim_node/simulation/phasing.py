"""Crest phases: the phases at which a particle on axis gains most energy.

The machine's phases are relative to the crest. It is found by tracking one particle in the middle
of the pulse along the axis, without space charge.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from numba import njit
from scipy.optimize import minimize_scalar

from awa_sim_node.simulation.constants import CHARGE_OVER_MASS, SPEED_OF_LIGHT
from awa_sim_node.simulation.field_map import FieldMap, FloatArray
from awa_sim_node.simulation.gun import ANGULAR_FREQUENCY

_STEP = 2e-13  # s
_LONGEST = 2e-8  # s


@njit(cache=True)
def _on_axis(field: FloatArray, u: float) -> float:
    j = math.floor(u)
    if j < 0 or j > len(field) - 2:
        return 0.0
    return float(field[j] + (u - j) * (field[j + 1] - field[j]))


@njit(cache=True)
def _final_momentum(
    gun: FloatArray,
    gun_dz: float,
    gun_phase: float,
    linac: FloatArray,
    linac_start: float,
    linac_dz: float,
    linac_phase: float,
    end: float,
    dt: float,
) -> float:
    """Return p_z [mc] at ``end``, or -1 if the particle turns back."""
    z, p, t = 0.0, 0.0, 0.0
    kick = -CHARGE_OVER_MASS / SPEED_OF_LIGHT * dt
    while z < end:
        middle = z + 0.5 * dt * SPEED_OF_LIGHT * p / math.sqrt(1.0 + p * p)
        angle = ANGULAR_FREQUENCY * (t + 0.5 * dt)
        field = _on_axis(gun, middle / gun_dz) * math.cos(angle + gun_phase)
        u = (middle - linac_start) / linac_dz
        field += _on_axis(linac, u) * math.cos(angle + linac_phase)
        p += kick * field
        z = middle + 0.5 * dt * SPEED_OF_LIGHT * p / math.sqrt(1.0 + p * p)
        t += dt
        if z < 0.0 or t > _LONGEST:
            return -1.0
    return p


def gun_crest(gun: FieldMap) -> float:
    """Return the phase of highest energy behind the gun [deg], for a map in V/m."""
    field = np.ascontiguousarray(gun.values[0, :, 0])
    none = np.zeros(2)

    def momentum(phase: float) -> float:
        angle = math.radians(phase)
        return _final_momentum(field, gun.dz, angle, none, 1e3, 1.0, 0.0, gun.end, _STEP)

    return _highest(momentum, np.arange(-120.0, 30.0, 5.0))


def linac_crest(gun: FieldMap, gun_phase: float, linac: FieldMap) -> float:
    """Return the phase of highest energy behind the linac [deg], for maps in V/m.

    Args:
        gun: Map of the gun.
        gun_phase: Phase of the gun [deg].
        linac: Map of the linac.
    """
    gun_field = np.ascontiguousarray(gun.values[0, :, 0])
    linac_field = np.ascontiguousarray(linac.values[0, :, 0])
    start = math.radians(gun_phase)

    def momentum(phase: float) -> float:
        angle = math.radians(phase)
        return _final_momentum(
            gun_field,
            gun.dz,
            start,
            linac_field,
            linac.start,
            linac.dz,
            angle,
            linac.end,
            _STEP,
        )

    return _highest(momentum, np.arange(-180.0, 180.0, 15.0))


def _highest(function: Callable[[float], float], grid: FloatArray) -> float:
    """Return the position of the function's maximum near the best point of the grid."""
    best = grid[int(np.argmax([function(float(x)) for x in grid]))]
    step = grid[1] - grid[0]
    found = minimize_scalar(
        lambda x: -function(x),
        bounds=(best - step, best + step),
        method="bounded",
        options={"xatol": 1e-4},
    )
    return float(found.x)
