"""The bunch that the laser frees."""

from __future__ import annotations

import math

import numpy as np
import pytest

from awa_sim_node.simulation.bunch import FLYING, LOST, WAITING, Bunch, Laser, emit
from awa_sim_node.simulation.constants import ELECTRON_REST_ENERGY

LASER = Laser()
PARTICLES = 2**14


@pytest.fixture(scope="module")
def bunch() -> Bunch:
    return emit(LASER, 40e-9, PARTICLES, 3)


def test_a_uniform_spot(bunch: Bunch) -> None:
    r = np.hypot(*bunch.phase_space[:, :2].T)
    assert r.max() <= LASER.radius
    # The share within r is (r/R)^2.
    share = np.searchsorted(np.sort(r), LASER.radius * np.sqrt([0.1, 0.25, 0.5, 0.9])) / len(r)
    np.testing.assert_allclose(share, [0.1, 0.25, 0.5, 0.9], atol=1e-3)
    assert np.all(bunch.phase_space[:, 2] == 0.0)
    assert np.all(bunch.state == WAITING)


def test_the_thermal_momenta(bunch: Bunch) -> None:
    # Maxwell's in the plane, and the flux through it across: <p_z^2> is twice <p_x^2>.
    thermal = math.sqrt(LASER.transverse_energy * 1e-6 / ELECTRON_REST_ENERGY)
    squares = (bunch.phase_space[:, 3:] ** 2).mean(axis=0) / thermal**2
    np.testing.assert_allclose(squares, [1.0, 1.0, 2.0], rtol=0.01)
    assert bunch.phase_space[:, 5].min() > 0.0
    correlation = np.corrcoef(
        np.column_stack([bunch.phase_space[:, [0, 1, 3, 4, 5]], bunch.emission]).T
    )
    assert np.abs(correlation - np.eye(6)).max() < 0.02


def test_the_flat_top_in_time(bunch: Bunch) -> None:
    times = np.sort(bunch.emission)
    assert times[0] >= 0.0
    assert times[-1] <= 2.0 * LASER.centre
    assert times.mean() == pytest.approx(LASER.centre, rel=1e-3)
    # Half the power is reached half the duration off the centre; in between all but the edges.
    rate, edges = np.histogram(times, bins=60, range=(0.0, 2.0 * LASER.centre))
    middle = 0.5 * (edges[1:] + edges[:-1])
    above = middle[rate > 0.5 * rate.max()]
    assert above[-1] - above[0] == pytest.approx(LASER.duration, abs=2.0 * (edges[1] - edges[0]))
    sigma = math.sqrt(LASER.duration**2 / 12.0 + (LASER.rise_time / 1.6869) ** 2)
    assert times.std() == pytest.approx(sigma, rel=0.005)


def test_it_is_as_wide_as_high(bunch: Bunch) -> None:
    squares = (bunch.phase_space**2).sum(axis=0)
    assert squares[0] == pytest.approx(squares[1], rel=1e-12)
    assert squares[3] == pytest.approx(squares[4], rel=1e-12)


@pytest.mark.parametrize("particles", [1, 2, 99, 1000])
def test_any_number_of_particles_shares_the_charge(particles: int) -> None:
    bunch = emit(LASER, 40e-9, particles, 0)
    assert bunch.phase_space.shape == (particles, 6)
    assert bunch.emission.shape == bunch.state.shape == (particles,)
    assert particles * bunch.particle_charge == pytest.approx(-40e-9)


def test_the_seed_decides() -> None:
    first, same, other = (emit(LASER, 1e-9, 100, seed) for seed in (5, 5, 6))
    np.testing.assert_array_equal(first.phase_space, same.phase_space)
    np.testing.assert_array_equal(first.emission, same.emission)
    assert not np.array_equal(first.phase_space, other.phase_space)
    with pytest.raises(ValueError, match=r"^seed = -1 .* 0 "):
        emit(LASER, 1e-9, 100, -1)


def test_only_some_are_flying() -> None:
    bunch = emit(LASER, 1e-9, 3, 0)
    bunch.state[:] = WAITING, FLYING, LOST
    np.testing.assert_array_equal(bunch.flying, bunch.phase_space[1:2])
