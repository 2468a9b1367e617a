"""The photocathode gun: one and a half cells at 1.3 GHz, in its accelerating mode."""

from __future__ import annotations

from typing import Final

import numpy as np

from awa_sim_node.simulation.field_map import FieldMap, coefficients, empty_map, rf_map

FREQUENCY: Final = 1.3e9
"""Frequency of gun and linac [Hz]."""

ANGULAR_FREQUENCY: Final = 2.0 * np.pi * FREQUENCY

_RADIUS: Final = 0.025  # radius of the iris [m]; beyond it, particles are lost


def gun_map() -> FieldMap:
    """Return the field (E_z, E_r, B_phi) per unit of the peak field on axis.

    E_z on axis is a cosine series over the length of the map, which makes the cathode a conductor.
    """
    data = coefficients()
    length = float(data["gun_length"])
    series = data["gun"]
    k = np.pi * np.arange(len(series), dtype=np.float64) / length
    grid = empty_map(_RADIUS, 11, 0.0, length, 301)
    return rf_map(k, series, np.zeros_like(series), ANGULAR_FREQUENCY, grid)
