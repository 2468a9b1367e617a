"""Sizes, emittances and energy of bunches that are known."""

from __future__ import annotations

import math
from dataclasses import astuple

import numpy as np
import pytest

from awa_sim_node.simulation.bunch import LOST
from awa_sim_node.simulation.constants import ELECTRON_REST_ENERGY
from awa_sim_node.simulation.moments import emittance, moments
from tests.awa_sim_node.simulation.charges import bunch_of


def test_four_particles_by_hand() -> None:
    # At (+-1 mm, +-1 mc) the covariance is diag(1e-6, 1): an emittance of 1000 mm mrad.
    positions = np.array([[1.0, 2.0, 3.0], [1.0, -2.0, 3.0], [-1.0, 2.0, -3.0], [-1.0, -2.0, -3.0]])
    momenta = np.array([[1.0, 0.5, 4.0], [-1.0, -0.5, 2.0], [1.0, 0.5, 2.0], [-1.0, -0.5, 4.0]])
    beam = moments(bunch_of(1e-3 * positions, momenta))
    assert (beam.sigma_x, beam.sigma_y, beam.sigma_z) == pytest.approx((1.0, 2.0, 3.0))
    assert beam.eps_x == pytest.approx(1000.0)
    assert beam.eps_y == pytest.approx(0.0, abs=1e-3)  # y and p_y go together
    assert beam.eps_z == pytest.approx(3000.0)
    gamma = np.sqrt(1.0 + np.array([1.25 + 16.0, 1.25 + 4.0, 1.25 + 4.0, 1.25 + 16.0]))
    energies = ELECTRON_REST_ENERGY * (gamma - 1.0)
    assert beam.energy == pytest.approx(energies.mean())
    assert beam.dE == pytest.approx(energies.std())
    assert beam.transmission == 1.0


def test_the_emittance_does_not_change_in_drifts_and_lenses() -> None:
    rng = np.random.default_rng(0)
    x, p = rng.normal(size=(2, 1000)) * [[1e-3], [0.05]]
    before = emittance(x, p)
    assert before == pytest.approx(50.0, rel=0.1)
    drifted = x + 0.7 * p
    assert emittance(drifted, p) == pytest.approx(before, rel=1e-9)
    assert emittance(drifted + 3.0, p - 40.0 * drifted - 1.0) == pytest.approx(before, rel=1e-9)


def test_the_lost_do_not_count() -> None:
    rng = np.random.default_rng(1)
    bunch = bunch_of(rng.normal(size=(10, 3)), rng.normal(size=(10, 3)))
    bunch.state[4:] = LOST
    left = bunch_of(bunch.phase_space[:4, :3], bunch.phase_space[:4, 3:])
    assert astuple(moments(bunch))[:-1] == astuple(moments(left))[:-1]
    assert moments(bunch).transmission == 0.4


def test_a_lost_bunch_has_no_moments() -> None:
    bunch = bunch_of(np.zeros((4, 3)), 1.0)
    bunch.state[1:] = LOST
    *values, transmission = astuple(moments(bunch))
    assert all(math.isnan(value) for value in values)
    assert transmission == 0.25
