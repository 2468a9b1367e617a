"""Where the next candidate is searched for: feasible, valid, near, inside a box, and in time."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import moocore
import numpy as np
import pytest

from mobo_tuner.core import Optimizer, Problem
from mobo_tuner.core.candidate_search import CandidateSearch
from mobo_tuner.core.constraints import ProbabilityOfFeasibility
from tests.core.toy_runs import TOY, Machine, toy, tune, with_changes


def test_feasibility_is_sought_before_anything_else() -> None:
    def machine(x: Mapping[str, float]) -> dict[str, Any]:
        return toy(x) | {"g": math.hypot(x["x1"] - 1.6, x["x2"] + 1.7)}

    optimizer = Optimizer(with_changes(constraints={"g": {"max": 0.15}}), seed=3)
    tune(optimizer, 25, machine)
    feasible = optimizer.dataset.feasible
    assert not feasible[: optimizer.initial_evaluations].any()
    assert feasible.any()


def test_where_feasibility_seems_hopeless_half_of_what_is_lacking_is_sought() -> None:
    def machine(x: Mapping[str, float]) -> dict[str, Any]:
        return toy(x) | {"g": 3.0 + math.tanh(x["x1"]) + 0.2 * x["x2"]}

    optimizer = Optimizer(
        with_changes(constraints={"g": {"max": 1.0}}), seed=2, initial_evaluations=8
    )
    tune(optimizer, 9, machine)
    optimizer.ask()  # the models learn all that was told
    readings = optimizer.dataset.column("g")
    [(model, _, _)] = optimizer.archive.models.constraints
    upper = 0.5 * (1.0 + model.predict(optimizer.dataset.inputs)[0].min())
    assert upper == pytest.approx(0.5 * (1.0 + readings.min()), abs=0.05)
    points = np.random.default_rng(0).uniform(-1.0, 1.0, (50, 2))
    search = CandidateSearch(optimizer.archive, optimizer.settings, 2)
    sought = search.acquisition_function(nearest=True)
    assert sought is not None
    expected = ProbabilityOfFeasibility(model, upper=upper).log_value(points)
    np.testing.assert_allclose(sought.log_value(points), expected)


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


def test_an_island_of_what_works_is_not_left_for_good() -> None:
    problem = Problem.from_dict(
        {
            "variables": {name: {"min": -2.0, "max": 2.0} for name in "xyzw"},
            "objectives": {name: {"reference": 5.0} for name in "fg"},
        }
    )

    def machine(x: Mapping[str, float]) -> dict[str, Any]:
        point = np.array(list(x.values()))
        outputs = {
            "f": float(np.linalg.norm(point - 1.0)),
            "g": float(np.linalg.norm(point - [-1.0, -1.0, 0.5, 0.0])),
        }
        return outputs if math.hypot(x["x"] - 0.3, x["y"] + 0.2) < 1.0 else {}

    optimizer = Optimizer(problem, seed=4)
    tune(optimizer, 30, machine)
    # As many as by chance, a fifth, at the least.
    assert optimizer.dataset.valid.sum() >= 6


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
    tune(optimizer, 60, two_wells)
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


def test_what_is_uncertain_of_a_measured_point_is_no_reason_to_measure_it_again() -> None:
    optimizer = Optimizer(Problem.from_dict(TOY), seed=0, noise=1.0)
    rng = np.random.default_rng(0)
    for _ in range(24):
        setpoint = optimizer.ask()
        outputs = {k: v + rng.normal() for k, v in toy(setpoint).items()}
        optimizer.tell(setpoint, outputs)
    inputs = optimizer.dataset.inputs
    gaps = [np.abs(inputs[:i] - inputs[i]).max(axis=1).min() for i in range(8, 24)]
    assert np.median(gaps) > 0.2  # 0.11 against the front of the means


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


def test_proximal_biasing_shortens_the_steps() -> None:
    lengths = []
    for proximal in (None, 4.0):
        optimizer = Optimizer(
            Problem.from_dict(TOY), seed=1, initial_evaluations=5, proximal=proximal
        )
        tune(optimizer, 25)
        steps = np.diff(optimizer.dataset.inputs[5:], axis=0)
        lengths.append(np.linalg.norm(steps, axis=1).mean())
    assert lengths[1] < 0.6 * lengths[0]


def test_a_truncation_box_confines_the_front() -> None:
    box = {"reference": 1.5, "truncation": [0.5, 1.5]}
    optimizer = Optimizer(with_changes(objectives={"f1": box, "f2": {"reference": 4.3}}), seed=2)
    tune(optimizer, 22)
    values = np.array([e.values["f1"] for e in optimizer.dataset.evaluations[8:]])
    assert np.mean((values > 0.4) & (values < 1.5)) > 0.8


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
    for x in tune(optimizer, 9, machine):
        assert all(-2.0 <= value <= 2.0 for value in x.values())
    assert math.isfinite(optimizer.hypervolume)


@pytest.mark.parametrize("acquisition", ["ehvi", "ei"])
def test_the_expected_gain_is_that_of_many_draws_of_the_models(acquisition: str) -> None:
    """The gain of each draw is counted by moocore."""
    optimizer = Optimizer(
        with_changes(constraints={"g": {"max": 0.5}}),
        initial_evaluations=6,
        acquisition=acquisition,
        weights=(1.0, 1.0) if acquisition == "ei" else None,
    )
    assert math.isnan(optimizer.expected_gain({"x1": 0.0, "x2": 0.0}))
    tune(optimizer, 7)
    optimizer.ask()
    point = {"x1": 0.4, "x2": -1.5}
    x = optimizer.problem.normalize(point)[None]
    rng = np.random.default_rng(1)
    models = optimizer.archive.models
    draws = [rng.normal(*m.predict(x), 20_000) for m in models.objectives]
    [(limit, lower, upper)] = models.constraints
    limited = rng.normal(*limit.predict(x), 20_000)
    feasible = (lower <= limited) & (limited <= upper)
    front = np.array([list(p["objectives"].values()) for p in optimizer.pareto_front()])
    reference = optimizer.problem.reference_point
    volume = moocore.hypervolume(front, ref=reference)
    gains = [
        moocore.hypervolume(np.vstack([front, values]), ref=reference) - volume
        for values in np.column_stack(draws)[:3000]
    ]
    expected = np.mean(gains) * np.mean(feasible) / volume
    error = np.std(gains) / math.sqrt(len(gains)) / volume
    assert optimizer.expected_gain(point) == pytest.approx(expected, abs=4.0 * error)
    assert optimizer.expected_gain(point) > 0.0


def test_what_is_expected_falls_while_a_problem_is_solved() -> None:
    optimizer = Optimizer(Problem.from_dict(TOY), initial_evaluations=6)
    gains = []
    for _ in range(22):
        asked = optimizer.ask()
        gains.append(optimizer.expected_gain(asked))
        optimizer.tell(asked, toy(asked))
    assert all(math.isnan(gain) for gain in gains[:6])
    assert max(gains[6:9]) > 5.0 * gains[-1] > 0.0


def test_asking_what_is_expected_changes_nothing() -> None:
    curious, plain = (Optimizer(Problem.from_dict(TOY), initial_evaluations=4) for _ in range(2))
    for _ in range(9):
        asked = curious.ask()
        curious.expected_gain(asked)
        curious.tell(asked, toy(asked))
    assert tune(plain, 9)[-1] == asked
    assert plain.get_state() == curious.get_state()
