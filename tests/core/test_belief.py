"""What a run believes: incomplete evaluations count for what they measured, and the models say the rest."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping
from typing import Any

import moocore
import numpy as np
import pytest

from mobo_tuner.core import Optimizer, Problem
from mobo_tuner.core.belief import (
    believe,
    is_certain,
    measured,
    probability_nondominated,
)
from mobo_tuner.core.dataset import Dataset
from mobo_tuner.core.models import Models
from mobo_tuner.core.settings import OptimizerSettings

REFERENCE = 3.0
Machine = Callable[[int, dict[str, float]], Mapping[str, Any]]


def problem(*objectives: str, **more: Any) -> Problem:
    return Problem.from_dict(
        {
            "variables": {name: {"min": -2.0, "max": 2.0} for name in "xy"},
            "objectives": {name: {"reference": REFERENCE} for name in objectives},
            **more,
        }
    )


def truth(x: float, y: float) -> dict[str, float]:
    """Distances to two points, and to the line x = 0."""
    return {
        "f": math.hypot(x - 1.0, y - 1.0),
        "g": math.hypot(x + 1.0, y + 1.0),
        "h": abs(x),
    }


def whole(_: int, outputs: dict[str, float]) -> Mapping[str, Any]:
    return outputs


def every_second_g(i: int, outputs: dict[str, float]) -> Mapping[str, Any]:
    return {name: value for name, value in outputs.items() if name != "g" or i % 2 == 0}


def tune(optimizer: Optimizer, evaluations: int, machine: Machine = whole) -> Optimizer:
    for _ in range(evaluations):
        setpoint = optimizer.ask()
        optimizer.tell(setpoint, machine(len(optimizer.dataset), truth(**setpoint)))
    return optimizer


def true_hypervolume(optimizer: Optimizer) -> float:
    """Hypervolume of the true values at the reported front."""
    names = optimizer.problem.objective_names
    values = [[truth(**p["setpoint"])[n] for n in names] for p in optimizer.pareto_front()]
    return float(moocore.hypervolume(np.array(values), ref=[REFERENCE] * len(names)))


def test_what_was_not_measured_is_predicted_and_the_front_says_so() -> None:
    optimizer = tune(Optimizer(problem("f", "g"), seed=2), 20, every_second_g)
    assert not optimizer.dataset.failed.any()
    front = optimizer.pareto_front()
    for point in front:
        missing = ["g"] if point["index"] % 2 else []
        assert point["predicted"] == missing
        assert [n for n, s in point["stddevs"].items() if s > 0.0] == missing
        exact = truth(**point["setpoint"])
        assert point["objectives"]["f"] == exact["f"]
        assert point["objectives"]["g"] == pytest.approx(exact["g"], abs=0.1)
    assert any(point["predicted"] for point in front)
    assert all(p["index"] % 2 == 0 for p in optimizer.pareto_front(measured=True))
    assert optimizer.hypervolume_measured < optimizer.hypervolume
    assert optimizer.hypervolume == pytest.approx(true_hypervolume(optimizer), rel=0.01)


@pytest.mark.parametrize("seed", [0, 1])
def test_half_measured_evaluations_are_worth_half_as_many_whole_ones(seed: int) -> None:
    full = tune(Optimizer(problem("f", "g"), seed=seed), 16)
    half = tune(Optimizer(problem("f", "g"), seed=seed), 32, every_second_g)
    assert true_hypervolume(half) >= 0.99 * full.hypervolume


# With eight readings in 32 evaluations, which seed it is counts for more than what failures teach.
@pytest.mark.parametrize(("rate", "share"), [(0.5, 0.97), (0.75, 0.8)])
def test_failures_by_chance_cost_little_more_than_the_evaluations_lost(
    rate: float, share: float
) -> None:
    def mean_hypervolume(told: bool) -> float:
        reached = []
        for seed in range(3):
            optimizer, rng = Optimizer(problem("f", "g"), seed=seed), np.random.default_rng(seed)
            for _ in range(32):
                setpoint = optimizer.ask()
                if rng.random() >= rate:
                    optimizer.tell(setpoint, truth(**setpoint))
                elif told:
                    optimizer.tell(setpoint, {}, failed=True)
            reached.append(optimizer.hypervolume)
        return float(np.mean(reached))

    assert mean_hypervolume(told=True) >= share * mean_hypervolume(told=False)


@pytest.fixture(scope="module")
def before_it_gained() -> Optimizer:
    def without_h(_: int, outputs: dict[str, float]) -> Mapping[str, Any]:
        return {"f": outputs["f"], "g": outputs["g"]}

    return tune(Optimizer(problem("f", "g"), seed=1), 14, without_h)


@pytest.mark.parametrize(
    "gained", [problem("f", "g", "h"), problem("f", "g", constraints={"h": {"max": 0.5}})]
)
def test_a_problem_that_gains_a_quantity_continues_from_what_there_is(
    before_it_gained: Optimizer, gained: Problem
) -> None:
    grown = before_it_gained.with_problem(gained)
    assert not grown.dataset.failed.any()
    assert grown.hypervolume == 0.0  # nothing is known of h yet
    tune(grown, 10)
    fresh = tune(Optimizer(gained, seed=1), 10)
    assert true_hypervolume(grown) > true_hypervolume(fresh)


def test_an_output_that_is_never_measured_does_not_end_the_search() -> None:
    optimizer = tune(Optimizer(problem("f", "g", "lost"), initial_evaluations=4), 12)
    assert optimizer.pareto_front() == []
    values = np.array([[e.values[n] for n in "fg"] for e in optimizer.dataset.evaluations])
    assert moocore.hypervolume(values, ref=[REFERENCE] * 2) > 4.0


def test_a_restored_optimizer_believes_and_asks_the_same() -> None:
    original = tune(Optimizer(problem("f", "g"), seed=3), 15, every_second_g)
    original.forget(2)
    original.forget(4, "f")
    for _ in range(2):  # with the withdrawal still to be learned, and afterwards
        restored = Optimizer.from_state(json.loads(json.dumps(original.get_state())))
        assert restored.hypervolume == original.hypervolume
        assert restored.pareto_front() == original.pareto_front()
        assert restored.ask() == original.ask()


def test_with_every_reading_there_the_belief_is_what_was_measured() -> None:
    data = Dataset(problem("f", "g"))
    for x in np.linspace(-1.5, 1.5, 5):
        data.add({"x": x, "y": x}, truth(x, x))
    data.add({"x": 0.0, "y": 1.0}, {}, failed=True)
    models = Models(data.problem, OptimizerSettings(), 0)
    models.update(data)
    assert is_certain(data, models)
    believed, read = believe(data, models), measured(data)
    np.testing.assert_array_equal(believed.objectives, read.objectives)
    np.testing.assert_array_equal(believed.feasible, read.feasible)
    np.testing.assert_array_equal(believed.front_rows(), read.front_rows())


def test_extended_models_leave_the_original_as_it_was() -> None:
    data = Dataset(problem("f", "g"))
    settings = OptimizerSettings(refit_every=100)
    models, continued = (Models(data.problem, settings, 0) for _ in range(2))
    points = np.random.default_rng(0).uniform(-2.0, 2.0, (8, 2))
    for i, (x, y) in enumerate(points):
        data.add({"x": x, "y": y}, truth(x, y))
        if i == 4:
            models.update(data)
            continued.update(data)
    before = [model.predict(np.zeros((1, 2))) for model in models.objectives]
    extended = models.extended(data)
    assert [model.predict(np.zeros((1, 2))) for model in models.objectives] == before
    assert [model.n for model in models.objectives] == [5, 5]
    continued.update(data)
    for mine, other in zip(extended.objectives, continued.objectives, strict=True):
        assert mine.n == other.n == 8
        np.testing.assert_array_equal(mine.predict(points)[0], other.predict(points)[0])


def noisy(stddev: float, seed: int, told: bool) -> Machine:
    rng = np.random.default_rng(seed)

    def machine(_: int, outputs: dict[str, float]) -> Mapping[str, Any]:
        readings = {name: value + stddev * rng.normal() for name, value in outputs.items()}
        return {n: (v, stddev) for n, v in readings.items()} if told else readings

    return machine


@pytest.mark.parametrize("told", [False, True])
@pytest.mark.parametrize(("stddev", "error"), [(0.1, 0.04), (0.3, 0.1)])
def test_where_readings_are_noisy_the_front_is_that_of_the_models(
    stddev: float, error: float, told: bool
) -> None:
    optimizer = tune(Optimizer(problem("f", "g"), seed=1), 24, noisy(stddev, 5, told))
    true = true_hypervolume(optimizer)
    assert optimizer.hypervolume == pytest.approx(true, rel=error)
    assert optimizer.hypervolume_measured > true
    assert optimizer.hypervolume_measured == pytest.approx(
        moocore.hypervolume(
            np.array([list(p["objectives"].values()) for p in optimizer.pareto_front(True)]),
            ref=[REFERENCE] * 2,
        )
    )
    front = optimizer.pareto_front()
    assert all(0.0 < s < stddev for p in front for s in p["stddevs"].values())
    assert all(0.0 <= p["probability"] <= 1.0 for p in front)
    errors = [
        (p["objectives"][n] - truth(**p["setpoint"])[n]) / p["stddevs"][n]
        for p in front
        for n in "fg"
    ]
    assert np.sqrt(np.mean(np.square(errors))) < 2.0
    restored = Optimizer.from_state(json.loads(json.dumps(optimizer.get_state())))
    assert restored.hypervolume == optimizer.hypervolume
    assert restored.ask() == optimizer.ask()


def test_looking_at_what_is_believed_changes_no_suggestion() -> None:
    seen, unseen = (Optimizer(problem("f", "g"), seed=2) for _ in range(2))
    tune(unseen, 14, noisy(0.2, 3, told=True))
    machine = noisy(0.2, 3, told=True)
    for i, evaluation in enumerate(unseen.dataset.evaluations):
        setpoint = seen.ask()
        assert setpoint == evaluation.setpoint
        seen.tell(setpoint, machine(i, truth(**setpoint)))
        assert 0.0 <= seen.hypervolume <= REFERENCE**2
        assert len(seen.pareto_front()) == len(seen.pareto_front(probability=False))
    assert seen.hypervolume == unseen.hypervolume


def test_probabilities_are_left_out_on_request() -> None:
    optimizer = tune(Optimizer(problem("f", "g"), seed=1), 10, noisy(0.2, 1, told=True))
    front = optimizer.pareto_front()
    for point in front:
        del point["probability"]
    assert optimizer.pareto_front(probability=False) == front


def test_one_point_measured_often_does_not_climb() -> None:
    optimizer, machine = Optimizer(problem("f", "g")), noisy(0.5, 2, told=False)
    for _ in range(60):
        optimizer.tell({"x": 0.3, "y": 0.3}, machine(0, truth(0.3, 0.3)))
    values = truth(0.3, 0.3)
    assert optimizer.hypervolume == pytest.approx(
        (REFERENCE - values["f"]) * (REFERENCE - values["g"]), rel=0.15
    )
    assert optimizer.hypervolume_measured > 1.3 * optimizer.hypervolume


def test_the_settings_may_say_whether_the_machine_is_noisy() -> None:
    said = tune(Optimizer(problem("f", "g"), noise=0.2), 10)
    assert all(s > 0.0 for p in said.pareto_front() for s in p["stddevs"].values())
    denied = tune(Optimizer(problem("f", "g"), noise=0.0), 20, noisy(0.3, 1, told=False))
    assert denied.hypervolume == denied.hypervolume_measured


def test_the_probability_of_being_nondominated_agrees_with_independent_draws() -> None:
    data = Dataset(problem("f", "g"))
    far = [(-1.9, 1.9), (1.9, -1.9), (0.0, 0.0), (1.0, 1.0), (-1.0, -1.0)]
    for x, y in far:
        data.add({"x": x, "y": y}, {n: (v, 0.4) for n, v in truth(x, y).items() if n != "h"})
    models = Models(data.problem, OptimizerSettings(length_scales=0.2, mean="data"), 0)
    models.update(data)
    belief = believe(data, models)
    rng = np.random.default_rng(0)
    probability = probability_nondominated(data, models, belief, rng)
    draws = belief.objectives + belief.stddevs * rng.standard_normal((4000, *belief.stddevs.shape))
    expected = np.mean([moocore.is_nondominated(draw) for draw in draws], axis=0)
    np.testing.assert_allclose(probability, expected, atol=0.2)


def test_a_point_that_was_measured_again_does_not_share_its_probability() -> None:
    optimizer, rng = Optimizer(problem("f", "g"), seed=0), np.random.default_rng(0)
    for _ in range(30):
        values = {name: value + 0.2 * rng.normal() for name, value in truth(0.5, 0.5).items()}
        optimizer.tell({"x": 0.5, "y": 0.5}, values)
    [point] = optimizer.pareto_front()
    assert point["probability"] == 1.0
