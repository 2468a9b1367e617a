"""The solenoids: Maxwell's equations, focal length and Larmor's rotation."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from scipy.integrate import trapezoid

from awa_sim_node.simulation.constants import CHARGE_OVER_MASS, SPEED_OF_LIGHT
from awa_sim_node.simulation.field_map import FieldMap
from awa_sim_node.simulation.solenoid import (
    FOCUSING_FIELD,
    MATCHING_FIELD,
    solenoid_maps,
    superpose,
)
from tests.awa_sim_node.simulation.charges import beamline, bunch_of
from tests.awa_sim_node.simulation.test_pusher import step

FOCUSING, MATCHING = solenoid_maps()


@pytest.mark.parametrize("field", [FOCUSING, MATCHING])
def test_the_field_has_neither_sources_nor_currents(field: FieldMap) -> None:
    # Within 1 % of the largest slope, which is what differences of the map's grid can show.
    b_z, b_r = field.values[:11, :, 0], field.values[:11, :, 1]  # up to 26 mm
    r = field.dr * np.arange(1, len(b_z))[:, None]
    z_slopes: Any = np.gradient(b_z, field.dr, field.dz, edge_order=2)
    r_slopes: Any = np.gradient(b_r, field.dr, field.dz, edge_order=2)
    (z_r, z_z), (r_r, r_z) = z_slopes, r_slopes
    middle = (slice(1, -1), slice(1, -1))
    divergence = r_r[1:] + b_r[1:] / r + z_z[1:]
    assert np.abs(divergence[:-1, 1:-1]).max() < 0.01 * np.abs(z_z).max()
    assert np.abs((r_z - z_r)[middle]).max() < 0.01 * np.abs(z_z).max()


@pytest.mark.parametrize(
    ("field", "peak"), [(FOCUSING, FOCUSING_FIELD), (MATCHING, MATCHING_FIELD)]
)
def test_its_peak_on_axis_and_none_at_the_cathode(field: FieldMap, peak: float) -> None:
    on_axis = field.values[0, :, 0]
    assert np.abs(on_axis).max() == pytest.approx(peak, rel=0.01)
    assert abs(on_axis[0]) < 1e-12
    assert abs(on_axis[-1]) < 1e-12
    np.testing.assert_array_equal(field.values[0, :, 1], 0.0)


def test_currents_of_the_public_decks() -> None:
    both = superpose(FOCUSING.scaled(550.0), MATCHING.scaled(440.0))
    assert np.abs(FOCUSING.values[0, :, 0]).max() * 550.0 == pytest.approx(0.12017, rel=0.01)
    assert np.abs(MATCHING.values[0, :, 0]).max() * 440.0 == pytest.approx(0.61126, rel=0.01)
    np.testing.assert_allclose(both.values, 550.0 * FOCUSING.values + 440.0 * MATCHING.values)


def test_it_is_a_lens_of_the_focal_length_that_the_textbook_gives() -> None:
    # 1/f = int (e B / 2 p)^2 dz, for a lens much shorter than f: here f is 36 m, the lens 0.2 m.
    field = MATCHING.scaled(230.0)
    p, offset = 120.0, 1e-3
    strength = -CHARGE_OVER_MASS / (2.0 * SPEED_OF_LIGHT * p)
    inverse = trapezoid((strength * field.values[0, :, 0]) ** 2, dx=field.dz)
    bunch = bunch_of(np.array([[offset, 0.0, 0.0]]), p)
    while bunch.phase_space[0, 2] < field.end:
        step(bunch, beamline(solenoids=field), 1e-12)
    x, y, _, px, py, _ = bunch.phase_space[0]
    towards_axis = -(x * px + y * py) / (math.hypot(x, y) * p)
    assert 0.02 < inverse < 0.03
    assert towards_axis == pytest.approx(offset * inverse, rel=0.03)


def test_it_turns_the_beam_by_larmors_angle_and_leaves_no_swirl() -> None:
    # Half the angle of the cyclotron, int e B / 2 p dz; behind it the angular momentum is what it
    # was before (Busch): none.
    field = MATCHING.scaled(230.0)
    p, offset = 120.0, 1e-3
    strength = -CHARGE_OVER_MASS / (2.0 * SPEED_OF_LIGHT * p)
    peak = np.abs(field.values[0, :, 0]).max()
    angle = trapezoid(strength * field.values[0, :, 0], dx=field.dz)
    bunch = bunch_of(np.array([[offset, 0.0, 0.0]]), p)
    largest = 0.0
    while bunch.phase_space[0, 2] < field.end:
        step(bunch, beamline(solenoids=field), 1e-12)
        x, y, z, px, py, _ = bunch.phase_space[0]
        swirl = x * py - y * px
        b_z = np.interp(z, field.dz * np.arange(field.values.shape[1]), field.values[0, :, 0])
        busch = strength * p * b_z * (x * x + y * y)
        assert swirl == pytest.approx(busch, abs=0.01 * strength * p * peak * offset**2)
        largest = max(largest, abs(swirl))
    assert math.atan2(y, x) == pytest.approx(angle, rel=0.01)
    assert abs(angle) > 0.05
    assert abs(swirl) < 0.01 * largest
