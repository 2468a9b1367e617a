"""Working points: what holding one is good for, on a machine that has drifted."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
import pytest

from mobo_tuner.core import Optimizer, Problem

RADIUS = 0.1  # of the variables' range of 4, so that the search reaches 0.4 to every side


def toy(x: Mapping[str, float], drift: float) -> dict[str, float]:
    """The paper's toy problem, Eq. (eqn:toy_problem), its minima moved along the diagonal."""
    return {
        "f1": math.hypot(x["x1"] - 1.0 - drift, x["x2"] - 1.0 - drift),
        "f2": math.hypot(x["x1"] + 1.0 - drift, x["x2"] + 1.0 - drift),
    }


@pytest.mark.parametrize("drift", [0.0, 0.2])
def test_holding_a_point_finds_the_best_around_it_also_after_a_drift(drift: float) -> None:
    problem = Problem.from_dict(
        {
            "variables": {name: {"min": -2.0, "max": 2.0} for name in ("x1", "x2")},
            "objectives": {name: {"reference": 4.3} for name in ("f1", "f2")},
        }
    )
    gained, possible = 0.0, 0.0
    for seed in (1, 2, 3):
        start, reached, best = _held(problem, seed, drift)
        gained, possible = gained + start - reached, possible + start - best
    assert gained > 0.75 * possible


def test_holding_stays_inside_the_bounds_and_limits_of_now() -> None:
    mapping: dict[str, Any] = {
        "variables": {name: {"min": -2.0, "max": 2.0} for name in ("x1", "x2", "x3")},
        "limits": {"total": {"x1": 1.0, "x2": 1.0, "max": 4.0}},
        "objectives": {name: {"reference": 9.0} for name in ("f1", "f2")},
    }
    optimizer = Optimizer(Problem.from_dict(mapping), seed=1)
    point = {"x1": 0.5, "x2": 0.25, "x3": 0.125}
    optimizer.tell(point, toy(point, 0.0))
    mapping["variables"]["x1"]["max"] = 0.6
    mapping["variables"]["x3"]["fixed"] = 1.0
    mapping["limits"] = {"total": {"x1": 1.0, "x2": 1.0, "max": 0.8}}
    now = Problem.from_dict(mapping)
    focused = optimizer.focus(index=0, radius=0.5, bounds=now)
    for _ in range(12):
        x = focused.ask()
        assert x["x1"] <= 0.6
        assert x["x1"] + x["x2"] <= 0.8 + 1e-9
        assert x["x3"] == point["x3"]
        focused.tell(x, toy(x, 0.0))


def _held(problem: Problem, seed: int, drift: float) -> tuple[float, float, float]:
    """Return the weighted sum at a point of the front, the best that holding found, and the best there is."""
    optimizer = Optimizer(problem, seed=seed, initial_evaluations=8)
    for _ in range(20):
        x = optimizer.ask()
        optimizer.tell(x, toy(x, 0.0))
    point = optimizer.pareto_front()[0]
    weights = {name: 1.0 / (4.3 - value) for name, value in point["objectives"].items()}

    def total(x: Mapping[str, float]) -> float:
        return sum(weights[name] * value for name, value in toy(x, drift).items())

    focused = optimizer.focus(index=point["index"], radius=RADIUS)
    measured = [point["setpoint"]]  # first the point itself, as it is now
    focused.tell(measured[0], toy(measured[0], drift))
    for _ in range(9):
        measured.append(focused.ask())
        focused.tell(measured[-1], toy(measured[-1], drift))
    x1, x2 = point["setpoint"]["x1"], point["setpoint"]["x2"]
    steps = np.linspace(-4.0 * RADIUS, 4.0 * RADIUS, 41)
    reachable = [
        {"x1": min(max(x1 + a, -2.0), 2.0), "x2": min(max(x2 + b, -2.0), 2.0)}
        for a in steps
        for b in steps
    ]
    best = min(total(x) for x in reachable)
    assert all(abs(x["x1"] - x1) <= 4.0 * RADIUS + 1e-9 for x in measured)
    return total(measured[0]), min(total(x) for x in measured), best
