"""The first linac cavity: seven cells in pi mode at the gun's frequency.

The map of the real cavity is not public. This one is synthetic: cells of half a wavelength with a
field that falls off smoothly at both ends, extended off axis by Maxwell's equations. An electron at
the speed of light gains 0.404 MeV on crest per MV/m.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from awa_sim_node.simulation.constants import SPEED_OF_LIGHT
from awa_sim_node.simulation.field_map import FieldMap, FloatArray, empty_map, rf_map
from awa_sim_node.simulation.gun import ANGULAR_FREQUENCY, FREQUENCY

START: Final = 0.6714
"""Start of the cavity's map [m from the cathode]."""

LENGTH: Final = 1.20713  # length of the map [m]
CELLS: Final = 7

_CELL: Final = 0.5 * SPEED_OF_LIGHT / FREQUENCY
_EDGE: Final = 0.018  # length over which the field falls off at either end [m]
_RADIUS: Final = 0.05
_HIGHEST_WAVE_NUMBER: Final = 150.0  # 1/m; beyond, the spectrum is negligible
_SAMPLES: Final = 4096


def on_axis(z: FloatArray) -> FloatArray:
    """Return E_z on axis, relative to its peak, at z [m from the start of the map]."""
    s = z - 0.5 * LENGTH
    half = 0.5 * CELLS * _CELL
    envelope = 0.5 * (np.tanh((s + half) / _EDGE) - np.tanh((s - half) / _EDGE))
    field: FloatArray = np.cos(np.pi * s / _CELL) * envelope
    return field


def linac_map() -> FieldMap:
    """Return the field (E_z, E_r, B_phi) per unit of the peak field on axis."""
    period = 2.0 * LENGTH  # padded, so that the two ends do not meet
    z = period * np.arange(_SAMPLES) / _SAMPLES - 0.5 * LENGTH
    field = on_axis(z)
    field /= np.abs(field).max()
    spectrum = np.fft.rfft(field) / _SAMPLES
    k = 2.0 * np.pi * np.arange(len(spectrum), dtype=np.float64) / period
    kept = k < _HIGHEST_WAVE_NUMBER
    # Shift the phases from the first sample to the start of the map.
    amplitude = spectrum[kept] * np.exp(-1j * k[kept] * z[0]) * np.where(k[kept] > 0.0, 2.0, 1.0)
    grid = empty_map(_RADIUS, 21, START, LENGTH, 601)
    return rf_map(k[kept], amplitude.real, -amplitude.imag, ANGULAR_FREQUENCY, grid)
