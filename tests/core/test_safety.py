"""Suggestions that are near what was measured, and believed safe."""

from __future__ import annotations

import numpy as np
import pytest

from experiments.safe import CASES, EVALUATIONS, run
from mobo_tuner.core import Optimizer, Problem, ProblemError
from mobo_tuner.core.safety import trust_distance
from robustness.offline_run import TOY, toy


def test_the_trust_distance_grows_with_safe_evaluations_and_shrinks_after_others() -> None:
    grown = trust_distance(np.array([True] * 5), 0.05)
    assert grown > trust_distance(np.array([True]), 0.05) > 0.1
    assert trust_distance(np.array([True] * 5 + [False]), 0.05) < grown
    assert trust_distance(np.array([True] * 100), 0.05) == 2.0
    assert trust_distance(np.array([False] * 100), 0.05) > 0.0


def test_every_suggestion_is_near_an_evaluation_before() -> None:
    problem = Problem.from_dict({**TOY, "constraints": {}})
    optimizer = Optimizer(problem, seed=1, trust_distance=0.05, initial_evaluations=4)
    with pytest.raises(ProblemError, match="the first one"):
        optimizer.ask()
    assert optimizer.needs_start
    optimizer.catch_up()
    optimizer.tell({"x1": 1.5, "x2": -1.5}, toy({"x1": 1.5, "x2": -1.5}))
    for _ in range(6):
        reach = trust_distance(optimizer.dataset.valid, 0.05)
        setpoint = optimizer.ask()
        assert optimizer.ask() == setpoint
        distances = np.abs(optimizer.dataset.inputs - problem.normalize(setpoint)).max(axis=1)
        assert 0.0 < distances.min() <= reach * (1.0 + 1e-6)
        optimizer.tell(setpoint, toy(setpoint))
    assert optimizer.last_source == "model"


def test_a_batch_is_near_what_was_measured_not_near_what_is_pending() -> None:
    problem = Problem.from_dict({**TOY, "constraints": {}})
    optimizer = Optimizer(problem, seed=1, trust_distance=0.05, initial_evaluations=2)
    for setpoint in ({"x1": 1.5, "x2": -1.5}, {"x1": 1.4, "x2": -1.5}, {"x1": 1.5, "x2": -1.4}):
        optimizer.tell(setpoint, toy(setpoint))
    reach = trust_distance(optimizer.dataset.valid, 0.05)
    batch = np.array([problem.normalize(setpoint) for setpoint in optimizer.ask(6)])
    distances = np.abs(batch[:, None] - optimizer.dataset.inputs).max(axis=2)
    assert (distances.min(axis=1) <= reach * (1.0 + 1e-6)).all()
    assert len(np.unique(batch.round(6), axis=0)) == 6


def test_a_safe_run_violates_nothing_that_a_usual_one_does() -> None:
    [case] = [case for case in CASES if case.name == "bnh"]
    soft, safe = run(case, 0, False, 20), run(case, 0, True, 20)
    assert soft[0] > 0
    assert safe[0] == 0
    assert safe[1] > 0.85 * soft[1]
    assert EVALUATIONS >= 20
