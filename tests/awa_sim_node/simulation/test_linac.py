"""The linac's field, and the energy it gives."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from scipy.integrate import trapezoid

from awa_sim_node.simulation.constants import SPEED_OF_LIGHT
from awa_sim_node.simulation.gun import ANGULAR_FREQUENCY, FREQUENCY
from awa_sim_node.simulation.linac import CELLS, LENGTH, START, linac_map, on_axis

LINAC = linac_map()


def test_the_gain_of_an_electron_at_the_speed_of_light() -> None:
    # On crest the field seen is the map times cos(omega z / c + phase): 0.404 MeV per MV/m. The
    # prototype's notes say 0.402.
    z: Any = LINAC.dz * np.arange(LINAC.values.shape[1])
    wave = np.exp(1j * ANGULAR_FREQUENCY / SPEED_OF_LIGHT * z)
    gain = abs(trapezoid(LINAC.values[0, :, 0] * wave, dx=LINAC.dz))
    assert gain == pytest.approx(0.4036, abs=0.0002)
    assert gain == pytest.approx(0.402, rel=0.005)


def test_seven_cells_of_half_a_wavelength() -> None:
    z = np.linspace(0.0, LENGTH, 4001)
    field = on_axis(z)
    zeros = z[np.flatnonzero(field[1:] * field[:-1] < 0.0)]
    within = zeros[np.abs(zeros - 0.5 * LENGTH) < 0.45 * CELLS * SPEED_OF_LIGHT / FREQUENCY / 2.0]
    assert len(within) == CELLS - 1
    np.testing.assert_allclose(np.diff(within), 0.5 * SPEED_OF_LIGHT / FREQUENCY, rtol=0.01)


def test_the_map_has_the_field_on_axis() -> None:
    z: Any = LINAC.dz * np.arange(LINAC.values.shape[1])
    assert LINAC.start == START
    assert LINAC.end == pytest.approx(START + LENGTH)
    expected = on_axis(z) / np.abs(on_axis(np.linspace(0.0, LENGTH, 20001, dtype=np.float64))).max()
    # The spectrum's end leaves a ripple of 0.7 % beside both edges.
    np.testing.assert_allclose(LINAC.values[0, :, 0], expected, atol=8e-3)


def test_it_fades_towards_its_ends() -> None:
    # The ripple grows with the radius: a beam of 20 mm sees 1 % of the peak where the map starts.
    assert math.isclose(LINAC.dr * (len(LINAC.values) - 1), 0.05)
    assert np.abs(LINAC.values[0, [0, -1], :2]).max() < 2e-3
    assert np.abs(LINAC.values[:9, [0, -1], :2]).max() < 0.01
