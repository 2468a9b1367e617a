"""References out of reach or left out, and what the optimiser says of a front that stays empty."""

from __future__ import annotations

import json
import math
from typing import Any

import numpy as np
import pytest

from mobo_tuner.core import Optimizer, Problem

Outputs = dict[str, float]


def problem(objectives: dict[str, Any], **parts: Any) -> Problem:
    """Two variables from -2 to 2."""
    variables = {name: {"min": -2.0, "max": 2.0} for name in "xy"}
    return Problem.from_dict({"variables": variables, "objectives": objectives} | parts)


def bowl(x: float, y: float) -> float:
    return (x - 0.3) ** 2 + (y + 0.7) ** 2


@pytest.mark.parametrize(
    ("objective", "settings"),
    [
        ({"reference": -1.0}, {}),
        ({"reference": -1.0}, {"acquisition": "ei"}),
        ({"reference": -1.0}, {"acquisition": "ucb"}),
        ({"reference": -1.0}, {"acquisition": "ucb_hvi"}),
        ({"reference": -1.0, "truncation": [-2.0, -1.0]}, {}),
        ({"reference": -1e6}, {}),
        ({"reference": 100.0, "direction": "maximize"}, {}),
    ],
)
def test_a_reference_out_of_reach_is_approached_and_told(
    objective: dict[str, Any], settings: dict[str, Any]
) -> None:
    sign = -1.0 if "direction" in objective else 1.0
    optimizer = Optimizer(problem({"f": objective}), seed=1, **settings)
    for _ in range(25):
        setpoint = optimizer.ask()
        optimizer.tell(setpoint, {"f": sign * bowl(**setpoint)})
    best = min(sign * e.values["f"] for e in optimizer.dataset.evaluations)
    assert best < 1e-3
    [hint] = optimizer.hints()
    assert f"{objective['reference']:.4g} in f" in hint
    assert f"{sign * best:.4g}" in hint


def two(x: float, y: float) -> Outputs:
    return {"f": math.hypot(x - 1.0, y - 1.0), "g": math.hypot(x + 1.0, y + 1.0)}


def test_one_reference_out_of_reach_does_not_stop_the_other() -> None:
    objectives = {"f": {"reference": -0.5}, "g": {"reference": 3.0}}
    optimizer = Optimizer(problem(objectives), seed=2)
    for _ in range(30):
        setpoint = optimizer.ask()
        optimizer.tell(setpoint, two(**setpoint))
    values = np.array([[e.values["f"], e.values["g"]] for e in optimizer.dataset.evaluations])
    assert values[values[:, 1] < 3.0, 0].min() < 0.1
    assert ["in f" in hint for hint in optimizer.hints()] == [True]


def test_references_that_are_out_of_reach_together_are_told() -> None:
    objectives = {"f": {"reference": 1.0}, "g": {"reference": 1.0}}
    optimizer = Optimizer(problem(objectives), seed=2)
    for _ in range(20):
        setpoint = optimizer.ask()
        optimizer.tell(setpoint, two(**setpoint))
    [hint] = optimizer.hints()
    assert "at once" in hint
    worst = [max(e.values["f"], e.values["g"]) for e in optimizer.dataset.evaluations]
    assert min(worst) < 1.6  # the least is sqrt(2)


def test_a_reference_that_is_found_later_ends_the_hint() -> None:
    optimizer = Optimizer(problem({"f": {"reference": 0.01}}), seed=1)
    for _ in range(20):
        setpoint = optimizer.ask()
        optimizer.tell(setpoint, {"f": bowl(**setpoint)})
    assert optimizer.hypervolume > 0.0
    assert optimizer.hints() == []


def test_failures_constraints_and_constants_are_told() -> None:
    objectives = {"f": {"reference": 3.0}}
    failed = Optimizer(problem(objectives))
    assert failed.hints() == []
    failed.tell({"x": 0.0, "y": 0.0}, {})
    assert ["failed" in hint for hint in failed.hints()] == [True]

    limited = Optimizer(problem(objectives, constraints={"t": {"min": 0.5}}))
    for x in (0.0, 0.5, 1.0):
        limited.tell({"x": x, "y": 0.0}, {"f": x, "t": 0.0})
    never, alike = limited.hints()
    assert "t is at least 0.5" in never
    assert "3 readings of t are 0" in alike

    partly = Optimizer(problem(objectives | {"g": {"reference": 1.0}}))
    partly.tell({"x": 0.0, "y": 0.0}, {"f": 9.0})
    assert any("g was never measured" in hint for hint in partly.hints())


def sampled(scatter: float) -> Optimizer:
    """An optimiser that was told 40 random evaluations, f with a random part of some standard deviation."""
    rng = np.random.default_rng(0)
    objectives = {"f": {"reference": 99.0}, "g": {"reference": 99.0}}
    optimizer = Optimizer(problem(objectives), seed=1)
    for x, y in rng.uniform(-2.0, 2.0, (40, 2)):
        values = two(x, y)
        optimizer.tell({"x": x, "y": y}, values | {"f": values["f"] + rng.normal(0.0, scatter)})
    optimizer.ask()
    return optimizer


def test_what_the_models_cannot_explain_is_told() -> None:
    assert sampled(0.0).hints() == []
    assert sampled(0.2).hints() == []
    [hint] = sampled(20.0).hints()
    assert "the model predicts f badly" in hint
    assert "shots" in hint


def test_noise_that_is_larger_than_the_gain_is_told_until_it_is_less() -> None:
    rng = np.random.default_rng(1)

    def tune(optimizer: Optimizer, noise: float, count: int = 40) -> list[str]:
        """Hints of a run of two objectives whose best points are close to each other."""
        for _ in range(count):
            setpoint = optimizer.ask()
            x, y = setpoint["x"], setpoint["y"]
            values = {"f": (x - 1.0) ** 2 + y**2, "g": (x - 0.7) ** 2 + y**2}
            optimizer.tell(setpoint, {n: v + rng.normal(0.0, noise) for n, v in values.items()})
        return optimizer.hints()

    near = problem({"f": {"reference": 10.0}, "g": {"reference": 10.0}})
    for noise in (0.0, 0.02):
        assert tune(Optimizer(near, seed=1), noise, count=24) == []
    rng = np.random.default_rng(3)
    noisy = Optimizer(near, seed=3)
    hint, *_ = tune(noisy, 0.25)
    assert "the noise of f is larger than the gain" in hint
    assert "shots" in hint
    assert tune(noisy, 1e-3, count=20) == []  # more shots were taken


def test_a_constraint_that_is_surely_met_is_not_doubted_and_noise_is_told_as_such() -> None:
    """A transmission of 1 nearly everywhere cannot be predicted, and need not be."""
    rng = np.random.default_rng(0)
    limits = {"t": {"min": 0.9}, "u": {"max": 1.0}}
    limited = problem({"f": {"reference": 99.0}}, constraints=limits)

    def told(spread: float, noise: float) -> list[str]:
        optimizer = Optimizer(limited, seed=1)
        for x, y in rng.uniform(-2.0, 2.0, (40, 2)):
            around = 1.0 + rng.normal(0.0, spread, 3)
            values = {"f": x * x + y * y, "t": (around[0], noise), "u": (around[1], noise)}
            optimizer.tell({"x": x, "y": y}, values)
        optimizer.ask()
        return optimizer.hints()

    [hint] = told(0.01, math.nan)  # some readings of u meet its limit
    assert "predicts u badly" in hint
    assert told(0.01, 0.01) == []
    noisy = Optimizer(problem({"f": {"reference": 99.0}, "g": {"reference": 99.0}}), seed=1)
    for x, y in rng.uniform(-2.0, 2.0, (40, 2)):
        noisy.tell({"x": x, "y": y}, {"f": (rng.normal(1.0, 0.1), 0.1), "g": x * x + y * y})
    noisy.ask()
    [hint] = noisy.hints()
    assert "the noise of f is larger than the gain" in hint


def test_a_reference_left_out_is_inferred_once_and_stays() -> None:
    left_out = problem({"f": {}, "g": {"direction": "maximize"}, "h": {"reference": 7.0}})
    optimizer = Optimizer(left_out, seed=3)
    assert not optimizer.problem.has_references
    readings = []
    for i in range(12):
        setpoint = optimizer.ask()
        values = two(**setpoint)
        outputs = {"f": values["f"], "g": -values["g"], "h": setpoint["x"]}
        optimizer.tell(setpoint, outputs)
        readings.append(list(outputs.values()))
        assert optimizer.problem.has_references == (i >= 5)
        assert (optimizer.hypervolume > 0.0) == (i >= 5)
    first = np.array(readings[:6])
    reference = {o.name: o.reference for o in optimizer.problem.objectives}
    assert reference["f"] == pytest.approx(first[:, 0].max() + 0.1 * np.ptp(first[:, 0]))
    assert reference["g"] == pytest.approx(first[:, 1].min() - 0.1 * np.ptp(first[:, 1]))
    assert reference["h"] == 7.0
    assert optimizer.given_problem == left_out
    assert Problem.from_dict(left_out.to_dict()) == left_out

    restored = Optimizer.from_state(json.loads(json.dumps(optimizer.get_state())))
    changed = optimizer.with_problem(left_out)
    assert restored.problem == changed.problem == optimizer.problem
    assert restored.ask() == optimizer.ask()
    assert changed.hypervolume == pytest.approx(optimizer.hypervolume)


def test_where_all_readings_are_alike_a_reference_is_still_inferred() -> None:
    optimizer = Optimizer(problem({"f": {}, "g": {}}), initial_evaluations=2)
    for _ in range(5):
        optimizer.tell(optimizer.ask(), {"f": 0.0, "g": -4.0})
    assert optimizer.problem.has_references
    assert 0.0 < optimizer.hypervolume < math.inf


@pytest.mark.parametrize("wild", [30.0, 1e6, -1e6])
def test_no_reference_is_inferred_from_a_reading_far_from_all_others(wild: float) -> None:
    optimizer = Optimizer(problem({"f": {}, "g": {"direction": "maximize"}}), seed=1)
    rest: dict[str, list[float]] = {"f": [], "g": []}
    for i in range(6):
        setpoint = optimizer.ask()
        values = two(**setpoint)
        outputs = {"f": values["f"], "g": -values["g"]}
        for name, wrong in (("f", 2), ("g", 4)):
            if i == wrong:
                outputs[name] = wild
            else:
                rest[name].append(outputs[name])
        optimizer.tell(setpoint, outputs)
    f, g = (objective.reference for objective in optimizer.problem.objectives)
    assert f == pytest.approx(max(rest["f"]) + 0.1 * np.ptp(rest["f"]))
    assert g == pytest.approx(min(rest["g"]) - 0.1 * np.ptp(rest["g"]))


@pytest.mark.parametrize("direction", ["minimize", "maximize"])
def test_a_reference_that_was_inferred_from_a_wild_reading_is_told(direction: str) -> None:
    sign = 1.0 if direction == "minimize" else -1.0
    optimizer = Optimizer(problem({"f": {"direction": direction}, "g": {}}), seed=1)
    for i in range(14):
        setpoint = optimizer.ask()
        outputs = two(**setpoint)
        optimizer.tell(setpoint, outputs | {"f": sign * (15.0 if i == 2 else outputs["f"])})
    [hint] = optimizer.hints()
    assert "evaluation 2" in hint
    assert "objectives.f.reference" in hint
    optimizer.forget(2, "f")
    assert optimizer.hints() == []
    assert abs(optimizer.problem.reference_point[0]) < 10.0


def test_withdrawn_readings_are_not_said_to_be_unmeasured() -> None:
    optimizer = Optimizer(problem({"f": {"reference": 3.0}}), seed=0)
    for _ in range(3):
        optimizer.tell(optimizer.ask(), {"f": 4.0})
        optimizer.forget(len(optimizer.dataset) - 1, "f")
    assert optimizer.hints() == ["all readings of f are withdrawn"]
    for index in range(3):
        optimizer.forget(index)
    assert optimizer.hints() == ["all 3 evaluations are withdrawn"]
    optimizer.tell(optimizer.ask(), {})
    assert optimizer.hints() == [
        "all 4 evaluations failed or are withdrawn: see why the last one did"
    ]


@pytest.mark.parametrize(("goal", "size"), [(5.0, 0.0), (1e9, 1e-9), (-1e20, 1.0)])
def test_a_reference_is_inferred_where_a_goal_is_far_from_all_readings(
    goal: float, size: float
) -> None:
    direction = "minimize" if goal > 0.0 else "maximize"
    optimizer = Optimizer(problem({"f": {"goal": goal, "direction": direction}, "g": {}}), seed=0)
    for _ in range(8):
        setpoint = optimizer.ask()
        optimizer.tell(setpoint, {"f": size * bowl(**setpoint), "g": setpoint["x"]})
    reference = optimizer.problem.objectives[0].reference
    assert abs(reference) < 1.2 * abs(goal)
    assert reference > goal if direction == "minimize" else reference < goal
    assert optimizer.pareto_front()
