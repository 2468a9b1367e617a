"""The solenoids around the gun: bucking and focusing (K1) and matching (K2)."""

from __future__ import annotations

from typing import Final

import numpy as np
from scipy.special import i0, i1

from awa_sim_node.simulation.field_map import FieldMap, FloatArray, coefficients, empty_map

FOCUSING_FIELD: Final = 0.12017 / 550.0
"""Peak field of the bucking and focusing solenoid per current [T/A]."""

MATCHING_FIELD: Final = 0.61126 / 440.0
"""Peak field of the matching solenoid per current [T/A]."""

_RADIUS: Final = 0.05


def solenoid_maps() -> tuple[FieldMap, FieldMap]:
    """Return the fields (B_z, B_r) of the focusing and the matching solenoid for 1 A.

    B_z on axis is a sine series over the length of the maps, because the bucking coil makes it 0 at
    the cathode.
    """
    data = coefficients()
    length = float(data["solenoid_length"])
    return (
        _map(data["focusing"] * FOCUSING_FIELD, length),
        _map(data["matching"] * MATCHING_FIELD, length),
    )


def superpose(first: FieldMap, second: FieldMap) -> FieldMap:
    """Return the sum of two maps on the same grid."""
    return first._replace(values=first.values + second.values)


def _map(sine: FloatArray, length: float) -> FieldMap:
    grid = empty_map(_RADIUS, 20, 0.0, length, 200)
    radii, positions, _ = grid.values.shape
    z = grid.dz * np.arange(positions)
    k = np.pi * np.arange(1, len(sine) + 1) / length
    values = np.empty((radii, positions, 2))
    for i in range(radii):
        r = i * grid.dr
        values[i, :, 0] = (sine * i0(k * r)) @ np.sin(np.outer(k, z))
        values[i, :, 1] = -(sine * i1(k * r)) @ np.cos(np.outer(k, z))
    return grid._replace(values=values)
