"""The gun's field, and the energy it gives."""

from __future__ import annotations

import math

import numpy as np
import pytest

from awa_sim_node.simulation.constants import ELECTRON_REST_ENERGY
from awa_sim_node.simulation.gun import ANGULAR_FREQUENCY, gun_map
from awa_sim_node.simulation.phasing import gun_crest
from tests.awa_sim_node.simulation.charges import beamline, bunch_of
from tests.awa_sim_node.simulation.test_pusher import step

GUN = gun_map()


def energy_on_crest(gradient: float) -> float:
    """Kinetic energy [MeV] behind the gun of an electron on axis."""
    field = GUN.scaled(1e6 * gradient)
    phase = math.radians(gun_crest(field))
    bunch = bunch_of(np.zeros((1, 3)), 0.0)
    time, dt = 0.0, 5e-13
    while bunch.phase_space[0, 2] < field.end:
        angle = phase + ANGULAR_FREQUENCY * (time + 0.5 * dt)
        step(bunch, beamline(gun=field), dt, time, gun_angle=angle)
        time += dt
    return ELECTRON_REST_ENERGY * (math.hypot(1.0, bunch.phase_space[0, 5]) - 1.0)


@pytest.mark.parametrize(
    ("gradient", "energy"), [(60.0, 6.28), (70.0, 7.34), (75.0, 7.86), (80.0, 8.39)]
)
def test_energy_on_crest(gradient: float, energy: float) -> None:
    # The prototype's table, to its last digit; OPAL has 6.272 MeV at 60 MV/m.
    assert energy_on_crest(gradient) == pytest.approx(energy, abs=0.006)


def test_the_cathode_is_a_conductor_in_the_greatest_field() -> None:
    on_axis = GUN.values[0, :, 0]
    assert abs(on_axis[0]) == pytest.approx(1.0, rel=0.01)
    assert np.abs(on_axis).max() < 1.01
    np.testing.assert_allclose(GUN.values[:, 0, 1], 0.0, atol=1e-12)


def test_one_and_a_half_cells() -> None:
    on_axis = GUN.values[0, :, 0]
    turns = np.flatnonzero(on_axis[1:] * on_axis[:-1] < 0.0)
    strong = turns[np.abs(on_axis[turns] - on_axis[turns + 1]) > 0.01]
    assert len(strong) == 1  # between the half cell and the full one
    assert abs(on_axis[-1]) < 0.01
