"""Exploration, and readings that are all alike: no beam yet, a plateau, a clipped camera."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from mobo_tuner.core import Optimizer, Problem
from mobo_tuner.core.exploration import explore, spread_out
from mobo_tuner.core.gaussian_process import GaussianProcess
from mobo_tuner.core.resolution import Taken

NOTHING = Taken(np.empty((0, 2)), np.empty((0, 2)))


def square(**parts: Any) -> Problem:
    """Two variables from -2 to 2."""
    variables = {name: {"min": -2.0, "max": 2.0} for name in "xy"}
    return Problem.from_dict({"variables": variables} | parts)


def evaluations_until_beam(optimizer: Optimizer, centre: np.ndarray, noise: float) -> int:
    """Ask until the beam is found on an island of 7 % of the square; no set-point twice."""
    rng = np.random.default_rng(0)
    asked = set()
    for i in range(60):
        setpoint = optimizer.ask()
        where = tuple(setpoint.values())
        assert where not in asked
        asked.add(where)
        beam = float(np.linalg.norm(where - centre) < 0.6) + noise * rng.normal()
        outputs = {"f": abs(setpoint["x"]), "transmission": beam}
        if optimizer.tell(setpoint, outputs).feasible:
            return i + 1
    return 60


@pytest.mark.parametrize("noise", [0.0, 0.05])
def test_the_beam_is_found_as_fast_as_by_chance(noise: float) -> None:
    problem = square(
        objectives={"f": {"reference": 3.0}}, constraints={"transmission": {"min": 0.5}}
    )
    rng = np.random.default_rng(3)
    counts = [
        evaluations_until_beam(Optimizer(problem, seed=seed), rng.uniform(-1.4, 1.4, 2), noise)
        for seed in range(8)
    ]
    assert np.median(counts) <= 12


def test_a_plateau_is_searched_all_over() -> None:
    optimizer = Optimizer(square(objectives={"f": {"reference": 6.0}}), seed=1)
    for _ in range(30):
        setpoint = optimizer.ask()
        distance = math.hypot(setpoint["x"] + 0.9, setpoint["y"] - 1.1)
        optimizer.tell(setpoint, {"f": min(5.0, 10.0 * distance)})
    assert min(e.values["f"] for e in optimizer.dataset.evaluations) < 0.5


def test_where_all_readings_are_alike_what_was_not_visited_is_uncertain() -> None:
    x = np.random.default_rng(1).uniform(-1.0, 1.0, (10, 2))
    process = GaussianProcess(reference=1.0).fit(x, np.full(10, 3.0))
    visited, unvisited = process.predict(x)[1], process.predict([[1.0, 1.0], [-1.0, -1.0]])[1]
    assert process.is_constant
    assert unvisited.min() > 30.0 * visited.max()


def test_exploration_fills_the_inside_of_the_space_first() -> None:
    points = np.empty((0, 2))
    for seed in range(16):
        points = np.vstack([points, explore(points, NOTHING, np.random.default_rng(seed))])
    cells = np.floor(2.0 * (points + 1.0)).astype(int)
    assert len(np.unique(cells, axis=0)) >= 10
    assert np.abs(points).max() < 0.97
    distances = np.linalg.norm(points[:, None] - points, axis=2) + 9.0 * np.eye(len(points))
    assert distances.min() > 0.3


def test_exploration_keeps_to_what_is_free_and_likely() -> None:
    left = Taken(np.array([[-1.0, 0.0]]), np.array([[1.0, 2.0]]))
    rng = np.random.default_rng(0)
    for _ in range(5):
        assert explore(np.zeros((1, 2)), left, rng)[0] > 0.0
        upper = explore(np.zeros((1, 2)), NOTHING, rng, lambda x: np.where(x[:, 1] > 0.5, 0, -99))
        assert upper[1] > 0.5


def test_rows_are_spread_out_and_the_preferred_ones_come_first() -> None:
    inputs = np.random.default_rng(0).uniform(-1.0, 1.0, (400, 2))
    rows, preferred = np.arange(100, 400), np.arange(300, 310)
    chosen = spread_out(inputs, rows, [preferred], 40)
    assert len(set(chosen)) == 40
    assert sorted(chosen) == list(chosen)
    assert chosen.min() >= 100
    assert set(preferred) <= set(chosen)
    others = inputs[np.setdiff1d(chosen, preferred)]
    distances = np.linalg.norm(others[:, None] - others, axis=2) + 9.0 * np.eye(len(others))
    assert distances.min() > 0.1
    assert len(spread_out(inputs, rows, [rows], 40)) == 40
