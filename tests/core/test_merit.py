"""What a set-point is worth: feasible, valid, near, inside a box, and in spite of noise."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import moocore
import numpy as np
import pytest

from mobo_tuner.core import Optimizer, Problem
from mobo_tuner.core.constraints import ProbabilityOfFeasibility
from mobo_tuner.core.merit import Merit
from tests.core.toy_runs import TOY, toy, tune, with_changes


def test_feasibility_is_sought_before_anything_else() -> None:
    def machine(x: Mapping[str, float]) -> dict[str, Any]:
        return toy(x) | {"g": math.hypot(x["x1"] - 1.6, x["x2"] + 1.7)}

    optimizer = Optimizer(with_changes(constraints={"g": {"max": 0.15}}), seed=3)
    tune(optimizer, 25, machine)
    feasible = optimizer.dataset.feasible
    assert not feasible[: optimizer.initial_evaluations].any()
    assert feasible.any()


def test_where_feasibility_seems_hopeless_a_part_of_what_is_lacking_is_sought() -> None:
    def machine(x: Mapping[str, float]) -> dict[str, Any]:
        return toy(x) | {"g": 3.0 + math.tanh(x["x1"]) + 0.2 * x["x2"]}

    optimizer = Optimizer(
        with_changes(constraints={"g": {"max": 1.0}}), seed=2, initial_evaluations=8
    )
    tune(optimizer, 9, machine)
    optimizer.ask()  # the models learn all that was told
    readings = optimizer.dataset.column("g")
    [(model, _, _)] = optimizer.archive.models.constraints
    best = model.predict(optimizer.dataset.inputs)[0].min()
    assert best == pytest.approx(readings.min(), abs=0.1)
    upper = max(0.5 * (1.0 + best), best - 0.3 * model.spread)
    points = np.random.default_rng(0).uniform(-1.0, 1.0, (50, 2))
    merit = Merit(optimizer.archive, optimizer.settings, 2)
    sought = merit.acquisition_function(nearest=True)
    assert sought is not None
    expected = ProbabilityOfFeasibility(model, upper=upper).log_value(points)
    np.testing.assert_allclose(sought.log_value(points), expected)


def test_a_limit_far_out_of_reach_is_approached() -> None:
    optimizer = Optimizer(with_changes(constraints={"g": {"max": -10.0}}), seed=0)
    tune(optimizer, 14, lambda x: toy(x) | {"g": (x["x1"] - 0.3) ** 2 + (x["x2"] - 0.4) ** 2})
    assert optimizer.dataset.column("g").min() < 0.05


@pytest.mark.parametrize("seed", [0, 1, 2, 3])
def test_an_island_of_what_works_is_not_left_for_good(seed: int) -> None:
    problem = Problem.from_dict(
        {
            "variables": {name: {"min": -2.0, "max": 2.0} for name in "xy"},
            "objectives": {name: {"reference": 5.0} for name in "fg"},
        }
    )

    def machine(x: Mapping[str, float]) -> dict[str, Any]:
        outputs = {
            "f": math.hypot(x["x"] - 1.0, x["y"] - 1.0),
            "g": math.hypot(x["x"] + 1.0, x["y"] + 1.0),
        }
        return outputs if math.hypot(x["x"] - 0.3, x["y"] + 0.2) < 0.7 else {}

    optimizer = Optimizer(problem, seed=seed)
    tune(optimizer, 30, machine)
    assert optimizer.dataset.valid.sum() >= 3  # one or two, if nothing leads back


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


def test_with_noise_the_merit_is_the_mean_gain_over_all_that_the_evaluations_may_be(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Evaluations and candidate are drawn together; the gain of each draw is counted by moocore."""
    noise = np.random.default_rng(5)

    def machine(x: Mapping[str, float]) -> dict[str, Any]:
        read = toy(x) | {"g": x["x1"] + x["x2"]}
        return {name: value + 0.3 * noise.normal() for name, value in read.items()}

    optimizer = Optimizer(
        with_changes(constraints={"g": {"max": 0.0}}), initial_evaluations=8, noise=0.3
    )
    tune(optimizer, 9, machine)
    optimizer.ask()
    archive, reference = optimizer.archive, optimizer.problem.reference_point
    monkeypatch.setattr("mobo_tuner.core.merit._DRAWS", 512)
    merit = Merit(archive, optimizer.settings, 0).acquisition_function()
    assert merit is not None
    x = np.array([[-0.4, 0.1], [0.3, -0.2]])
    inputs = np.vstack([archive.dataset.inputs, x])
    rng = np.random.default_rng(1)
    f1, f2, g = (
        model.sample(inputs, rng.standard_normal((3000, len(inputs))))
        for model in (*archive.models.objectives, archive.models.constraints[0][0])
    )
    gains = np.zeros((3000, 2))
    for draw in range(3000):
        values, feasible = np.column_stack([f1[draw], f2[draw]]), g[draw] <= 0.0
        front = values[:-2][feasible[:-2]]
        volume = moocore.hypervolume(front, ref=reference) if len(front) else 0.0
        for k in np.flatnonzero(feasible[-2:]):
            more = np.vstack([front, values[len(values) - 2 + k]])
            gains[draw, k] = moocore.hypervolume(more, ref=reference) - volume
    expected = gains.mean(axis=0)
    error = gains.std(axis=0) * math.sqrt(1.0 / 3000.0 + 1.0 / 512.0)
    assert (error < 0.15 * expected).all()
    assert (np.abs(np.exp(merit.log_value(x)) - expected) < 4.0 * error).all()
