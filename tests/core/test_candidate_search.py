"""The next candidate: never where it failed, in time, and elsewhere where nothing is promised."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
import pytest

from mobo_tuner.core import Optimizer, Problem
from mobo_tuner.core.merit import Merit
from tests.core.toy_runs import TOY, Machine, toy, tune, with_changes


def test_failed_evaluations_earn_nothing_and_are_not_repeated() -> None:
    def machine(x: Mapping[str, float]) -> dict[str, Any]:
        return toy(x) if x["x1"] < 0.3 else {"f1": math.nan}

    optimizer = Optimizer(Problem.from_dict(TOY), seed=1, initial_evaluations=6)
    tune(optimizer, 22, machine)
    failed = {e.index for e in optimizer.dataset.evaluations if not e.valid}
    assert failed
    assert failed.isdisjoint(p["index"] for p in optimizer.pareto_front())
    inputs = optimizer.dataset.inputs
    for i in failed:
        later = np.abs(inputs[i + 1 :] - inputs[i]).max(axis=1)
        assert (later > 0.02).all()


def test_a_machine_that_was_off_at_first_is_not_kept_from_where_it_was() -> None:
    withheld = Optimizer(Problem.from_dict(TOY), seed=1)
    tune(withheld, 25)
    optimizer = Optimizer(Problem.from_dict(TOY), seed=1)
    tune(optimizer, 15, lambda _: {})
    tune(optimizer, 25)
    assert optimizer.hypervolume > 0.97 * withheld.hypervolume


def test_when_everything_fails_it_explores() -> None:
    optimizer = Optimizer(Problem.from_dict(TOY), initial_evaluations=3)
    asked = tune(optimizer, 8, lambda _: {})
    points = np.array([list(x.values()) for x in asked])
    distances = np.linalg.norm(points[:, None] - points, axis=2) + 10.0 * np.eye(len(points))
    assert distances.min() > 0.5
    assert optimizer.pareto_front() == []
    assert optimizer.hypervolume == 0.0


def test_when_nothing_is_feasible_it_goes_on_asking() -> None:
    optimizer = Optimizer(with_changes(constraints={"g": {"max": -9.0}}), initial_evaluations=4)
    asked = tune(optimizer, 9)
    assert optimizer.pareto_front() == []
    assert optimizer.hypervolume == 0.0
    # g = x1 is least at the lower bound, where the constraint comes nearest to being met.
    assert min(x["x1"] for x in asked[4:]) < -1.9


def test_a_spent_time_budget_still_gives_a_candidate() -> None:
    optimizer = Optimizer(
        Problem.from_dict(TOY), seed=1, initial_evaluations=4, suggestion_seconds=1e-9
    )
    for x in tune(optimizer, 7):
        assert all(-2.0 <= value <= 2.0 for value in x.values())
    assert optimizer.last_source == "model"


def two_wells(x: Mapping[str, float]) -> dict[str, Any]:
    """Two objectives that fall outwards, with a narrow well each, one beside the other."""
    outwards = x["x1"] ** 2 + 0.9 * x["x2"] ** 2
    wells = [(x["x1"] - a) ** 2 + (x["x2"] - 0.3) ** 2 for a in (-0.1, 0.1)]
    return {
        f"f{i + 1}": 4.0 - 0.2 * outwards - 4.0 * math.exp(-w / 0.1) for i, w in enumerate(wells)
    }


def test_what_the_models_do_not_foresee_is_found() -> None:
    optimizer = Optimizer(Problem.from_dict(TOY), seed=3)
    tune(optimizer, 44, two_wells)
    assert optimizer.hypervolume > 14.0  # without the wells it is 3.3


@pytest.mark.parametrize("stddev", [0.0, 0.001])
def test_while_the_front_stands_still_every_second_evaluation_explores(stddev: float) -> None:
    optimizer = Optimizer(Problem.from_dict(TOY), seed=0, initial_evaluations=4)
    tune(optimizer, 4)
    for _ in range(6):  # nothing that is measured is better
        optimizer.tell(optimizer.ask(), {"f1": (4.29, stddev), "f2": (4.29, stddev), "g": 0.0})
    assert len(optimizer.dataset) == 10
    known = optimizer.dataset.inputs
    asked = optimizer.problem.normalize(optimizer.ask())
    points = np.random.default_rng(1).uniform(-1.0, 1.0, (1000, 2))
    gaps = [np.linalg.norm(known - point, axis=1).min() for point in (*points, asked)]
    assert gaps[-1] > np.quantile(gaps, 0.8)


def test_failures_do_not_mean_that_the_front_stands_still() -> None:
    optimizer = Optimizer(Problem.from_dict(TOY), seed=0)
    tune(optimizer, 12)
    for _ in range(4):
        optimizer.tell(optimizer.ask(), {}, failed=True)
    asked = optimizer.problem.normalize(optimizer.ask())
    gain = Merit(optimizer.archive, optimizer.settings, 0).expected_gain(asked)
    assert gain > optimizer.settings.exploration / 16  # 1.6e-6 where it explores


@pytest.mark.parametrize(("missed", "explores"), [(0, True), (2, False)])
def test_while_only_a_constraint_is_missed_nothing_is_explored(missed: int, explores: bool) -> None:
    """What is promised, but misses a constraint, is learned there."""
    optimizer = Optimizer(
        with_changes(constraints={"g": {"max": 0.0}}), seed=0, initial_evaluations=4
    )
    tune(optimizer, 4, lambda x: toy(x) | {"g": -1.0})
    for step in range(6):
        g = 0.05 if step >= 6 - missed else -1.0
        optimizer.tell(optimizer.ask(), {"f1": 4.29, "f2": 4.29, "g": g})
    known = optimizer.dataset.inputs
    asked = optimizer.problem.normalize(optimizer.ask())
    points = np.random.default_rng(1).uniform(-1.0, 1.0, (1000, 2))
    gaps = [np.linalg.norm(known - point, axis=1).min() for point in (*points, asked)]
    assert (gaps[-1] > np.quantile(gaps, 0.8)) == explores


def constant(_: Mapping[str, float]) -> dict[str, Any]:
    return {"f1": 1.0, "f2": 2.0}


def huge_outlier(x: Mapping[str, float]) -> dict[str, Any]:
    return toy(x) | ({"f1": 1e6} if x["x1"] > 1.5 else {})


def tiny(x: Mapping[str, float]) -> dict[str, Any]:
    return {name: 1e-9 * value for name, value in toy(x).items()}


def beyond(x: Mapping[str, float]) -> dict[str, Any]:
    return {name: 1e3 + value for name, value in toy(x).items()}


@pytest.mark.parametrize("machine", [constant, huge_outlier, tiny, beyond])
@pytest.mark.parametrize("preset", ["default", "paper"])
def test_awkward_machines_get_finite_candidates_inside_the_bounds(
    machine: Machine, preset: str
) -> None:
    optimizer = Optimizer(Problem.from_dict(TOY), preset=preset, seed=1, initial_evaluations=4)
    for x in tune(optimizer, 7, machine):
        assert all(-2.0 <= value <= 2.0 for value in x.values())
    assert math.isfinite(optimizer.hypervolume)
