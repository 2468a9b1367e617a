"""The quadrupole kick of the coupler."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import trapezoid

from awa_sim_node.simulation.constants import CHARGE_OVER_MASS, SPEED_OF_LIGHT
from awa_sim_node.simulation.coupler_kick import CENTRE, HALF_LENGTH, gradient
from tests.awa_sim_node.simulation.charges import beamline, bunch_of
from tests.awa_sim_node.simulation.test_pusher import step


def test_it_adds_up_to_its_strength() -> None:
    z = np.linspace(CENTRE - HALF_LENGTH, CENTRE + HALF_LENGTH, 2001)
    values = np.array([gradient(position, 1.7e-3) for position in z])
    assert trapezoid(values, z) == pytest.approx(1.7e-3, rel=1e-6)
    assert gradient(CENTRE + 1.0001 * HALF_LENGTH, 1.7e-3) == 0.0
    assert gradient(CENTRE - 1.0001 * HALF_LENGTH, 1.7e-3) == 0.0


def test_it_spreads_in_x_what_it_gathers_in_y() -> None:
    # A fast electron gets p = e x times the strength, to 1e-3 that of a thin lens.
    strength, x, y = 1.2e-3, 2e-3, 3e-3
    bunch = bunch_of(np.array([[x, y, CENTRE - 0.15]]), 100.0)
    line = beamline(coupler_kick=strength)
    while bunch.phase_space[0, 2] < CENTRE + 0.15:
        step(bunch, line, 5e-12)
    kick = -CHARGE_OVER_MASS / SPEED_OF_LIGHT * strength
    np.testing.assert_allclose(bunch.phase_space[0, 3:5], [kick * x, -kick * y], rtol=2e-3)
