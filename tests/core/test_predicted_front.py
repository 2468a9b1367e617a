"""The front that the models predict, against the analytic one of the toy problem."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import moocore
import numpy as np
import pytest

from mobo_tuner.core import Optimizer, Problem

REFERENCE = 4.3
LENGTH = 2.0 * math.sqrt(2.0)  # of the true front, from (0, LENGTH) to (LENGTH, 0)


def toy(x: Mapping[str, float]) -> dict[str, float]:
    """The paper's toy problem, Eq. (eqn:toy_problem), with its second objective turned round."""
    return {
        "f1": math.hypot(x["x1"] - 1.0, x["x2"] - 1.0),
        "f2": -math.hypot(x["x1"] + 1.0, x["x2"] + 1.0),
        "g": x["x1"],
    }


def tuned(fails_above: float = math.inf, evaluations: int = 16, **sections: Any) -> Optimizer:
    problem = Problem.from_dict(
        {
            "variables": {"x1": {"min": -2.0, "max": 2.0}, "x2": {"min": -2.0, "max": 2.0}},
            "objectives": {
                "f1": {"reference": REFERENCE},
                "f2": {"reference": -REFERENCE, "direction": "maximize"},
            },
            **sections,
        }
    )
    optimizer = Optimizer(problem, seed=2, initial_evaluations=8)
    for _ in range(evaluations):
        x = optimizer.ask()
        optimizer.tell(x, toy(x) if x["x1"] <= fails_above else {})
    return optimizer


def test_the_predicted_front_is_the_true_one_and_closer_than_the_measured() -> None:
    optimizer = tuned(evaluations=24)
    front = optimizer.predicted_front(size=60)
    assert len(front) == 60
    true = np.array([list(toy(p["setpoint"]).values())[:2] for p in front]) * [1.0, -1.0]
    whole = moocore.hypervolume(
        np.column_stack([np.linspace(0, LENGTH, 2001), np.linspace(LENGTH, 0, 2001)]),
        ref=[REFERENCE] * 2,
    )
    missing = whole - moocore.hypervolume(true, ref=[REFERENCE] * 2)
    assert missing < 0.03 * whole
    assert missing < 0.75 * (whole - optimizer.hypervolume)
    # The standard deviations tell how far off the predictions are.
    predicted = np.array([list(p["objectives"].values()) for p in front]) * [1.0, -1.0]
    stddevs = np.array([list(p["stddevs"].values()) for p in front])
    assert (stddevs > 0.0).all()
    assert np.mean(np.abs(predicted - true) < 3.0 * stddevs + 0.02) > 0.9
    assert moocore.is_nondominated(predicted).all()
    assert predicted[:, 0].min() < 0.25
    assert predicted[:, 1].min() < 0.25


def test_it_keeps_within_constraints_and_where_evaluations_succeed() -> None:
    constrained = tuned(constraints={"g": {"max": 0.3}})
    assert max(p["setpoint"]["x1"] for p in constrained.predicted_front()) == pytest.approx(
        0.3, abs=0.02
    )
    failing = tuned(fails_above=0.3)
    front = failing.predicted_front()
    assert max(p["setpoint"]["x1"] for p in front) < 1.0
    assert min(p["setpoint"]["x1"] for p in front) < -0.8


def test_asking_for_it_changes_nothing_and_it_is_the_same_again() -> None:
    optimizer, twin = tuned(), tuned()
    front = optimizer.predicted_front(size=20)
    assert optimizer.ask() == twin.ask()
    assert optimizer.predicted_front(size=20) == front == twin.predicted_front(size=20)


def test_where_nothing_is_known_nothing_is_predicted() -> None:
    optimizer = tuned()
    assert Optimizer(optimizer.problem).predicted_front() == []
    failing = Optimizer(optimizer.problem)
    failing.tell({"x1": 0.0, "x2": 0.0}, {})
    assert failing.predicted_front() == []
    limited = Problem.from_dict(optimizer.problem.to_dict() | {"constraints": {"g": {"max": 1.0}}})
    unmeasured = Optimizer(limited)
    for g in (0.1, 0.2):
        unmeasured.tell({"x1": g, "x2": 0.0}, {"g": g})
    assert unmeasured.predicted_front() == []
    hopeless = tuned(constraints={"g": {"max": -100.0}})
    assert hopeless.predicted_front() == []
