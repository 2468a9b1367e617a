"""Field maps made of Fourier components: they obey Maxwell's equations off axis, too."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from awa_sim_node.simulation.constants import SPEED_OF_LIGHT
from awa_sim_node.simulation.field_map import FieldMap, bessel, coefficients, empty_map, rf_map
from awa_sim_node.simulation.gun import ANGULAR_FREQUENCY

FREE_SPACE = ANGULAR_FREQUENCY / SPEED_OF_LIGHT  # 27.2 per m


@pytest.fixture(scope="module")
def wave() -> FieldMap:
    """A standing wave of components on both sides of the wave number of free space, and at 0."""
    k = np.array([0.0, 12.0, FREE_SPACE, 40.0])
    shape = empty_map(0.02, 81, 0.3, 0.25, 501)
    cosine, sine = np.array([0.2, 0.5, -0.7, 1.0]), np.array([0.0, -0.4, 0.3, 0.6])
    return rf_map(k, cosine, sine, ANGULAR_FREQUENCY, shape)


def slopes(wave: FieldMap, component: int) -> tuple[np.ndarray, np.ndarray]:
    slopes: Any = np.gradient(wave.values[:, :, component], wave.dr, wave.dz, edge_order=2)
    d_r, d_z = slopes
    return d_r, d_z


def test_its_electric_field_has_no_sources(wave: FieldMap) -> None:
    e_r = wave.values[1:, :, 1]
    r = wave.dr * np.arange(1, len(wave.values))[:, None]
    divergence = slopes(wave, 1)[0][1:] + e_r / r + slopes(wave, 0)[1][1:]
    assert np.abs(divergence[:, 1:-1]).max() < 1e-3 * np.abs(slopes(wave, 0)[1]).max()


def test_ampere(wave: FieldMap) -> None:
    # With cos(omega t) for E and -sin(omega t) for B_phi: curl B = omega/c^2 E.
    b = wave.values[1:, :, 2]
    r = wave.dr * np.arange(1, len(wave.values))[:, None]
    scale = ANGULAR_FREQUENCY / SPEED_OF_LIGHT**2
    axial = slopes(wave, 2)[0][1:] + b / r - scale * wave.values[1:, :, 0]
    radial = slopes(wave, 2)[1][1:] + scale * wave.values[1:, :, 1]
    largest = scale * np.abs(wave.values[:, :, 0]).max()
    assert np.abs(axial).max() < 1e-3 * largest
    assert np.abs(radial[:, 1:-1]).max() < 1e-3 * largest


def test_faraday(wave: FieldMap) -> None:
    curl = slopes(wave, 1)[1] - slopes(wave, 0)[0]
    error = curl - ANGULAR_FREQUENCY * wave.values[:, :, 2]
    assert np.abs(error[:, 1:-1]).max() < 1e-3 * np.abs(curl).max()


def test_its_field_on_axis_is_the_series(wave: FieldMap) -> None:
    z = wave.dz * np.arange(wave.values.shape[1])
    expected = 0.2 + 0.5 * np.cos(12.0 * z) - 0.4 * np.sin(12.0 * z)
    expected += -0.7 * np.cos(FREE_SPACE * z) + 0.3 * np.sin(FREE_SPACE * z)
    expected += np.cos(40.0 * z) + 0.6 * np.sin(40.0 * z)
    np.testing.assert_allclose(wave.values[0, :, 0], expected, atol=1e-12)
    np.testing.assert_array_equal(wave.values[0, :, 1:], 0.0)


def test_the_radial_functions_join_at_the_wave_number_of_free_space() -> None:
    k = FREE_SPACE * np.array([1.0 - 1e-9, 1.0, 1.0 + 1e-9])
    zeroth, first = bessel(k, ANGULAR_FREQUENCY, 0.01)
    np.testing.assert_allclose(zeroth, 1.0, atol=1e-8)
    np.testing.assert_allclose(first, 0.005, rtol=1e-8)


def test_end_and_scale() -> None:
    field = empty_map(0.02, 3, 0.3, 0.25, 6)
    assert field.values.shape == (3, 6, 3)
    assert (field.dr, field.dz) == (0.01, 0.05)
    assert field.end == pytest.approx(0.55)
    field.values[:] = 2.0
    assert np.all(field.scaled(-3.0).values == -6.0)
    assert np.all(field.values == 2.0)


def test_the_coefficients_are_there() -> None:
    assert {name: value.shape for name, value in coefficients().items()} == {
        "gun": (20,),
        "gun_length": (),
        "focusing": (20,),
        "matching": (20,),
        "solenoid_length": (),
    }
