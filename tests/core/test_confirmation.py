"""Set-points that show whether a reading is right: beside a suspected one, and where one was measured before."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest

from mobo_tuner.core import Optimizer, Problem


def test_a_reading_that_is_too_good_is_confirmed_beside_it() -> None:
    problem = Problem.from_dict(
        {
            "variables": {name: {"min": 0.0, "max": 1.0} for name in "xy"},
            "objectives": {"f": {"reference": 3.0}},
        }
    )

    def slope(x: float, y: float) -> float:
        """A slope with a narrow well."""
        return x + y - 3.0 * math.exp(-(((x - 0.8) / 0.12) ** 2) - ((y - 0.7) / 0.12) ** 2)

    rng = np.random.default_rng(3)
    for deep in (True, False):
        optimizer = Optimizer(problem, seed=0)
        for x, y in [*rng.uniform(0.0, 0.5, (14, 2)), (0.8, 0.7)]:
            value = slope(x, y) if deep or (x, y) != (0.8, 0.7) else -1.5
            optimizer.tell({"x": x, "y": y}, {"f": value})
        beside = optimizer.ask()
        assert optimizer.suspected == [(14, "f")]
        assert [beside["x"], beside["y"]] == pytest.approx([0.79, 0.69])
        optimizer.tell(beside, {"f": slope(**beside) if deep else sum(beside.values())})
        assert optimizer.ask() != beside
        assert (optimizer.suspected == []) == deep


def test_a_reading_that_nearly_meets_a_limit_is_confirmed_beside_it_while_none_does() -> None:
    problem = Problem.from_dict(
        {
            "variables": {name: {"min": 0.0, "max": 1.0} for name in "xy"},
            "objectives": {"f": {"reference": 3.0}},
            "constraints": {"g": {"max": -1.0}},
        }
    )
    rng = np.random.default_rng(3)
    for wild, confirmed in ((-0.5, True), (4.0, False)):  # nearer to the limit, and farther
        optimizer = Optimizer(problem, seed=0)
        for x, y in [*rng.uniform(0.0, 0.5, (14, 2)), (0.8, 0.7)]:
            g = x + y if x < 0.6 else wild
            optimizer.tell({"x": x, "y": y}, {"f": x, "g": g})
        beside = optimizer.ask()
        assert optimizer.suspected == [(14, "g")]
        assert (list(beside.values()) == pytest.approx([0.79, 0.69])) == confirmed


def steep(setpoint: dict[str, float]) -> dict[str, float]:
    """A step and two kinks."""
    a, b, c = setpoint.values()
    return {
        "f": math.tanh(8.0 * (a - 0.2)) + b**2,
        "g": abs(a + 0.3) + 0.5 * abs(b) + 0.2 * c,
    }


def test_a_machine_that_may_be_noisy_is_measured_again_once() -> None:
    problem = Problem.from_dict(
        {
            "variables": {name: {"min": -1.0, "max": 1.0} for name in "abc"},
            "objectives": {name: {"reference": 3.0} for name in "fg"},
        }
    )
    optimizer = Optimizer(problem, seed=2)
    for _ in range(10):
        asked = optimizer.ask()
        optimizer.tell(asked, steep(asked))
    optimizer.ask()
    state = json.loads(json.dumps(optimizer.get_state()))
    state["models"]["may_be_noisy"] = True

    def doubtful() -> Optimizer:
        return Optimizer.from_state(json.loads(json.dumps(state)))

    front = [point["setpoint"] for point in optimizer.pareto_front()]
    again = doubtful().ask()
    assert any(again == pytest.approx(setpoint, abs=1e-9) for setpoint in front)
    first, second = doubtful().ask(2)
    assert first == again
    assert second != pytest.approx(again, abs=1e-6)
    narrow = problem.to_dict() | {"variables": {n: {"min": 0.98, "max": 1.0} for n in "abc"}}
    moved = doubtful().with_problem(Problem.from_dict(narrow)).ask()
    assert all(0.98 <= value <= 1.0 for value in moved.values())

    quiet, noisy = doubtful(), doubtful()
    quiet.tell(again, steep(again))
    noisy.tell(again, {name: value + 0.05 for name, value in steep(again).items()})
    for each, trusted in ((quiet, True), (noisy, False)):
        following = each.ask()
        assert following != pytest.approx(again, abs=1e-6)
        each.tell(following, steep(following))
        assert each.archive.models.trusts_readings(each.dataset) == trusted
    assert quiet.hypervolume == quiet.hypervolume_measured
    assert noisy.hypervolume != noisy.hypervolume_measured
