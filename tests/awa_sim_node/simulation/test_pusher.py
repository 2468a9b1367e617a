"""Moving particles: motions that can be written down, apertures and emission."""

from __future__ import annotations

import math

import numpy as np
import pytest

from awa_sim_node.simulation.bunch import FLYING, LOST, WAITING, Bunch
from awa_sim_node.simulation.constants import CHARGE_OVER_MASS, SPEED_OF_LIGHT
from awa_sim_node.simulation.pusher import GUN_APERTURE, GUN_END, PIPE_APERTURE, Beamline, push
from awa_sim_node.simulation.space_charge import BunchField
from tests.awa_sim_node.simulation.charges import beamline, bunch_of, constant_map

NO_FIELD = BunchField(np.zeros((1, 1, 1, 5)), 0.0, 0.0, 0.0, 1.0, 1.0, 1.0, 0.0)


def step(
    bunch: Bunch,
    line: Beamline,
    dt: float,
    time: float = 0.0,
    own: BunchField = NO_FIELD,
    gun_angle: float = 0.0,
) -> tuple[int, float, float, float]:
    return push(
        bunch.phase_space,
        bunch.state,
        bunch.emission,
        time,
        dt,
        line,
        gun_angle,
        0.0,
        own is not NO_FIELD,
        own,
    )


def test_a_constant_electric_field_gives_momentum_in_proportion_to_time() -> None:
    field, steps, dt = 20e6, 100, 1e-12
    bunch = bunch_of(np.array([[0.0, 0.0, 0.1]]), 0.5)
    line = beamline(gun=constant_map(field, 0.0, 0.0))
    for _ in range(steps):
        count, position, momentum, force = step(bunch, line, dt)
    rate = -CHARGE_OVER_MASS * field / SPEED_OF_LIGHT
    later = 0.5 + rate * steps * dt
    assert count == 1
    assert momentum == pytest.approx(later, rel=1e-12)
    assert force == pytest.approx(rate, rel=1e-9)
    # The path follows from the gain of energy over the field.
    gained = math.hypot(1.0, later) - math.hypot(1.0, 0.5)
    assert position - 0.1 == pytest.approx(SPEED_OF_LIGHT * gained / rate, rel=1e-5)


def test_the_gun_accelerates_at_crest_and_brakes_opposite() -> None:
    line = beamline(gun=constant_map(20e6, 0.0, 0.0))
    for angle, sign in ((0.0, 1.0), (math.pi, -1.0)):
        bunch = bunch_of(np.array([[0.0, 0.0, 0.1]]), 3.0)
        step(bunch, line, 1e-12, gun_angle=angle)
        assert sign * (bunch.phase_space[0, 5] - 3.0) > 0.01


def circle_error(steps: int) -> tuple[float, float]:
    """Error of position over the radius after a quarter turn, and the change of momentum."""
    b, p = 1.0, 2.0
    bunch = bunch_of(np.array([[1e-3, 0.0, 0.2]]), np.array([[p, 0.0, 0.0]]))
    turn = -CHARGE_OVER_MASS * b / math.hypot(1.0, p)  # of the velocity, counter-clockwise
    dt = 0.5 * math.pi / turn / steps
    line = beamline(solenoids=constant_map(b, 0.0))
    for _ in range(steps):
        step(bunch, line, dt)
    radius = p * SPEED_OF_LIGHT / (-CHARGE_OVER_MASS * b)
    expected = np.array([1e-3 + radius, radius])
    momentum = bunch.phase_space[0, 3:]
    error = np.abs(bunch.phase_space[0, :2] - expected).max() / radius
    return float(error), abs(float(np.linalg.norm(momentum)) - p)


def test_circles_in_a_magnetic_field_at_second_order() -> None:
    (coarse, _), (fine, change) = circle_error(20), circle_error(40)
    assert coarse < 1e-3
    assert coarse / fine == pytest.approx(4.0, rel=0.05)
    assert change < 1e-12


def test_the_field_of_the_bunch_is_interpolated() -> None:
    # Linear in x, y and z, which the interpolation between nodes takes exactly.
    nodes = np.stack(np.meshgrid(*[np.arange(4.0)] * 3, indexing="ij"), axis=-1)
    values = np.zeros((4, 4, 4, 5))
    values[..., 0] = 1e6 * (1.0 + nodes @ [1.0, 2.0, 3.0])
    own = BunchField(values, -1e-3, -2e-3, 0.1, 1e-3, 2e-3, 3e-3, 0.0)
    points = np.array([[1.1e-3, 1.5e-3, 0.104], [-5e-3, 0.0, 0.101]])  # the second is outside
    bunch = bunch_of(points, 0.0)
    dt = 1e-15
    step(bunch, beamline(), dt, own=own)
    field = 1e6 * (1.0 + 2.1 + 2.0 * 1.75 + 3.0 * 4.0 / 3.0)
    expected = CHARGE_OVER_MASS * field * dt / SPEED_OF_LIGHT
    assert bunch.phase_space[0, 3] == pytest.approx(expected, rel=1e-6)
    assert np.all(bunch.phase_space[1, 3:] == 0.0)


def test_the_beam_loses_what_hits_the_aperture_or_the_cathode() -> None:
    margin = 1e-4
    points = [
        [GUN_APERTURE - margin, 0.0, GUN_END - 1e-3],
        [0.0, -GUN_APERTURE - margin, GUN_END - 1e-3],
        [GUN_APERTURE + margin, 0.0, GUN_END + 1e-3],
        [0.0, PIPE_APERTURE - margin, GUN_END + 1e-3],
        [PIPE_APERTURE, PIPE_APERTURE, 2.0],
        [0.0, 0.0, 1e-9],
    ]
    momenta = np.zeros((6, 3))
    momenta[5, 2] = -0.1
    bunch = bunch_of(np.array(points), momenta)
    count, *_ = step(bunch, beamline(), 1e-12)
    assert bunch.state.tolist() == [FLYING, LOST, FLYING, FLYING, LOST, LOST]
    assert count == 3
    before = bunch.phase_space.copy()
    step(bunch, beamline(), 1e-12)
    np.testing.assert_array_equal(bunch.phase_space[5], before[5])  # the lost stay where they are


def test_a_particle_flies_from_the_time_of_its_emission() -> None:
    momenta = np.full((3, 3), [0.0, 0.0, 1.0])
    bunch = bunch_of(np.zeros((3, 3)), momenta)
    bunch.state[:] = WAITING
    bunch.emission[:] = [0.5e-12, 1.5e-12, 2.5e-12]
    counts = [step(bunch, beamline(), 1e-12, time=k * 1e-12)[0] for k in range(2)]
    assert counts == [1, 2]
    assert bunch.state.tolist() == [FLYING, FLYING, WAITING]
    speed = SPEED_OF_LIGHT / math.sqrt(2.0)
    np.testing.assert_allclose(bunch.phase_space[:, 2], [1.5e-12 * speed, 0.5e-12 * speed, 0.0])


def test_an_empty_bunch() -> None:
    bunch = bunch_of(np.zeros((2, 3)), 1.0)
    bunch.state[:] = LOST
    assert step(bunch, beamline(), 1e-12) == (0, 0.0, 0.0, 0.0)
