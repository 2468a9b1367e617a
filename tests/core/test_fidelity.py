"""Fidelities of a simulation: their definition, what is learned from them, and what counts."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from typing import Any

import numpy as np
import pytest

from mobo_tuner.core import Optimizer, Problem, ProblemError

LIMIT = {"min": 0.0, "max": 1.0}
DEFINITION: dict[str, Any] = {
    "variables": {"x": LIMIT, "y": LIMIT},
    "objectives": {"f": {"reference": 2.0}, "g": {"reference": 2.0}},
    "fidelity": {
        "particles": {"choices": [100.0, 1000.0, 10000.0], "scale": "log"},
        "cell": {"min": 0.5, "max": 2.0, "step": 0.5, "target": 0.5, "unit": "mm"},
        "cost": "particles / cell",
    },
}
SIMPLE = {**DEFINITION, "fidelity": {"s": {"choices": [0.0, 1.0]}, "cost": "0.1 + 0.9 * s"}}


def simulate(setpoint: Mapping[str, float], bias: float = 0.2) -> dict[str, float]:
    x, y = setpoint["x"], setpoint["y"]
    lack = bias * (1.0 - setpoint.get("s", 1.0))
    return {"f": x + (y - 0.4 - lack) ** 2, "g": 1.0 - math.sqrt(x) + (y - 0.4) ** 2 + lack * x}


def run(optimizer: Optimizer, count: int, bias: float = 0.2) -> None:
    for _ in range(count):
        setpoint = optimizer.ask()
        optimizer.tell(setpoint, simulate(setpoint, bias))


def changed(section: Mapping[str, Any]) -> dict[str, Any]:
    return {**DEFINITION, "fidelity": section}


def test_levels_are_all_combinations_from_the_cheapest_to_the_highest() -> None:
    fidelity = Problem.from_dict(DEFINITION).fidelity
    assert fidelity is not None
    assert fidelity.highest == {"particles": 10000.0, "cell": 0.5}
    assert fidelity.levels[-1] == fidelity.highest
    assert fidelity.levels[0] == {"particles": 100.0, "cell": 2.0}
    assert len(fidelity.levels) == 12
    assert np.all(np.diff(fidelity.shares[:-1]) >= 0.0)
    assert fidelity.share({"particles": 1000.0, "cell": 1.0}) == pytest.approx(0.05)
    assert fidelity.lack({"particles": 100.0, "cell": 0.5}) == pytest.approx([1.0, 0.0])
    assert fidelity.lack({"particles": 1000.0, "cell": 2.0}) == pytest.approx([0.5, 1.0])
    assert fidelity.of({"x": 0.3, "cell": 1.0}) == {"particles": 10000.0, "cell": 1.0}


def test_a_range_is_chosen_from_at_a_few_places() -> None:
    problem = Problem.from_dict(
        changed({"s": {"min": 1.0, "max": 16.0, "scale": "log"}, "cost": "s"})
    )
    assert problem.fidelity is not None
    assert [level["s"] for level in problem.fidelity.levels] == pytest.approx([1, 2, 4, 8, 16])


def test_a_definition_is_read_as_it_was_written() -> None:
    problem = Problem.from_dict(DEFINITION)
    assert Problem.from_dict(json.loads(json.dumps(problem.to_dict()))) == problem
    assert "fidelity" not in Problem.from_dict({**DEFINITION, "fidelity": None}).to_dict()


@pytest.mark.parametrize(
    ("section", "words"),
    [
        ([1.0], "'fidelity'"),
        ({"cost": "1"}, "'fidelity'"),
        ({"s": LIMIT}, "fidelity.cost"),
        ({"s": LIMIT, "cost": "s + t"}, "'t'"),
        ({"s": LIMIT, "cost": "s"}, "fidelity.cost is 0 at s = 0"),
        ({"s": LIMIT, "cost": "1 / s"}, "fidelity.cost"),
        ({"s": LIMIT, "cost": "2 - s"}, "fidelity.cost is 1.25 at s = 0.75"),
        ({"s": LIMIT, "cost": "open(s)"}, "fidelity.cost"),
        ({"s": {**LIMIT, "target": 0.5}, "cost": "1 + s"}, "fidelity.s.target is 0.5"),
        ({"s": {**LIMIT, "fixed": 0.5}, "cost": "1 + s"}, "fixed"),
        ({"s": {"choices": ["coarse", "fine"]}, "cost": "1 + s"}, "fidelity.s"),
        ({"x": LIMIT, "cost": "1 + x"}, "fidelity.x"),
        ({"s": {"max": 1.0}, "cost": "1 + s"}, "fidelity.s.min"),
        (dict.fromkeys("abc", LIMIT) | {"cost": "1 + a"}, "125 levels"),
    ],
)
def test_what_is_no_fidelity_is_refused_by_name(section: Any, words: str) -> None:
    with pytest.raises(ProblemError) as refused:
        Problem.from_dict(changed(section))
    assert words in str(refused.value)


def test_a_safe_constraint_is_a_machine_s() -> None:
    with pytest.raises(ProblemError, match="safe"):
        Problem.from_dict({**SIMPLE, "constraints": {"f": {"max": 1.0, "safe": 0.9}}})


def test_a_fidelity_outside_its_range_is_refused_and_nothing_is_learned() -> None:
    optimizer = Optimizer(Problem.from_dict(SIMPLE))
    for wrong in (2.0, math.nan):
        with pytest.raises(ProblemError, match="set-point s"):
            optimizer.tell({"x": 0.1, "y": 0.1, "s": wrong}, {"f": 1.0})
        with pytest.raises(ProblemError, match="set-point s"):
            optimizer.expected_gain({"x": 0.1, "y": 0.1, "s": wrong})
    assert len(optimizer.dataset) == 0


def test_only_what_was_measured_at_the_highest_fidelity_is_on_the_front() -> None:
    optimizer = Optimizer(Problem.from_dict(SIMPLE))
    cheap = optimizer.tell({"x": 0.1, "y": 0.4, "s": 0.0}, {"f": 0.0, "g": 0.0})
    assert (cheap.complete, cheap.feasible) == (True, False)
    assert optimizer.hypervolume == optimizer.hypervolume_measured == 0.0
    assert optimizer.pareto_front() == []
    told = optimizer.tell(
        {"x": 0.1, "y": 0.4}, {"f": 1.0, "g": 1.0}
    )  # the highest, if nothing is said
    assert told.setpoint["s"] == 1.0
    assert optimizer.hypervolume == pytest.approx(1.0)
    assert [point["index"] for point in optimizer.pareto_front()] == [1]
    assert optimizer.hypervolume_measured == pytest.approx(1.0)


def test_the_initial_design_is_cheap_and_models_predict_the_highest_fidelity() -> None:
    optimizer = Optimizer(Problem.from_dict(SIMPLE), seed=2)
    run(optimizer, optimizer.initial_evaluations)
    assert [e.setpoint["s"] for e in optimizer.dataset.evaluations] == [0.0] * 6
    run(optimizer, 14)
    levels = [e.setpoint["s"] for e in optimizer.dataset.evaluations[6:]]
    assert {*levels} == {0.0, 1.0}
    assert all(p["setpoint"]["s"] == 1.0 for p in optimizer.pareto_front())
    assert all(p["setpoint"]["s"] == 1.0 for p in optimizer.predicted_front(5))
    where = {"x": 0.5, "y": 0.5}
    mean, _ = optimizer.models.objectives[0].predict(optimizer.problem.normalize(where)[None])
    assert mean[0] == pytest.approx(simulate(where)["f"], abs=0.03)


def test_it_is_saved_and_restored_bit_for_bit_with_what_is_pending() -> None:
    optimizer = Optimizer(Problem.from_dict(SIMPLE), seed=3)
    run(optimizer, 12)
    optimizer.tell({"x": 0.9, "y": 0.9, "s": 0.0}, {}, failed=True)
    first, *_ = optimizer.ask(3)
    restored = Optimizer.from_state(json.loads(json.dumps(optimizer.get_state())))
    assert restored.pending == optimizer.pending
    assert restored.ask() == optimizer.ask()
    for each in (optimizer, restored):
        each.tell(first, simulate(first))
        assert len(each.pending) == 2
    assert restored.ask() == optimizer.ask()


def test_a_pending_point_is_told_apart_by_its_fidelity() -> None:
    optimizer = Optimizer(Problem.from_dict(SIMPLE), seed=3)
    [cheap] = optimizer.ask(1)
    optimizer.tell({**cheap, "s": 1.0}, simulate(cheap))
    assert optimizer.pending == [cheap]
    optimizer.cancel(cheap)
    assert optimizer.pending == []


def test_readings_of_two_fidelities_at_one_place_are_no_noise() -> None:
    optimizer = Optimizer(Problem.from_dict(SIMPLE), seed=1)
    for x in (0.2, 0.4, 0.8):
        for s in (0.0, 1.0):
            setpoint = {"x": x, "y": 0.4, "s": s}
            optimizer.tell(setpoint, simulate(setpoint))
    assert optimizer.models.trusts_readings(optimizer.dataset)


def test_a_cheap_failure_says_less_of_the_highest_fidelity_than_one_there() -> None:
    probabilities = []
    for s in (0.0, 1.0):
        optimizer = Optimizer(Problem.from_dict(SIMPLE), seed=1)
        for x in np.linspace(0.0, 1.0, 8):
            setpoint = {"x": x, "y": 0.5, "s": s if x > 0.6 else 1.0}
            optimizer.tell(setpoint, simulate(setpoint), failed=bool(x > 0.6))
        optimizer.ask()
        place = optimizer.problem.normalize({"x": 0.9, "y": 0.5})[None]
        validity = optimizer.archive.models.validity
        probabilities.append(float(validity.predict_log_probability(place)[0]))
        value, gradient = validity.log_weight_with_gradient(place)
        assert (value.shape, gradient.shape) == ((1,), (1, 2))
    assert probabilities[1] < probabilities[0] < 0.0
