"""A machine that depends on what nobody sets, time or a temperature: what is said of it is true now."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from typing import Any

import moocore
import numpy as np
import pytest

from mobo_tuner.core import Optimizer, Problem, ProblemError
from mobo_tuner.core.context_kernel import Contextual
from mobo_tuner.core.dataset import Dataset
from mobo_tuner.core.gaussian_process import GaussianProcess
from mobo_tuner.core.gaussian_process_settings import GaussianProcessSettings
from mobo_tuner.core.kernels import KERNELS

REFERENCE = 4.3
PROBLEM = Problem.from_dict(
    {
        "variables": {name: {"min": -2.0, "max": 2.0} for name in "xy"},
        "objectives": {name: {"reference": REFERENCE} for name in "fg"},
    }
)
Drift = Callable[[int], float]


def moving(i: int) -> float:
    return -0.8 + 0.04 * i


def steady(_: int) -> float:
    return 0.0


def truth(setpoint: dict[str, float], shift: float) -> dict[str, float]:
    """Distances to two points that move along x together."""
    x, y = setpoint["x"] - shift, setpoint["y"]
    return {"f": math.hypot(x - 1.0, y - 1.0), "g": math.hypot(x + 1.0, y + 1.0)}


def tune(optimizer: Optimizer, evaluations: int, drift: Drift) -> Optimizer:
    for _ in range(evaluations):
        i = len(optimizer.dataset)
        setpoint = optimizer.ask()
        optimizer.tell(setpoint, truth(setpoint, drift(i)), time=1e9 + 20.0 * i + i % 3)
    return optimizer


def error_of_hypervolume(optimizer: Optimizer, shift: float) -> float:
    """Return by which share the reported hypervolume exceeds that of the true values now."""
    front = [truth(p["setpoint"], shift) for p in optimizer.pareto_front(probability=False)]
    values = np.array([[each["f"], each["g"]] for each in front])
    return float(optimizer.hypervolume / moocore.hypervolume(values, ref=[REFERENCE] * 2) - 1.0)


@pytest.mark.parametrize("contexts", [1, 2])
@pytest.mark.parametrize("name", list(KERNELS))
def test_the_gradient_of_a_kernel_with_contexts_by_finite_differences(
    name: str, contexts: int
) -> None:
    rng = np.random.default_rng(0)
    kernel = Contextual(KERNELS.find(name)(2), contexts)
    parameters = kernel.default_parameters() + 0.2 * rng.standard_normal(kernel.size)
    x, c = rng.uniform(-1.0, 1.0, (6, 2 + contexts)), rng.standard_normal((6, 6))
    c = c + c.T

    def profile(p: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        scaled = x @ kernel.factor(p)
        return kernel.profile(np.square(scaled[:, None] - scaled).sum(axis=2))

    weights = profile(parameters)[1] * c
    np.fill_diagonal(weights, 0.0)
    for i, step in enumerate(1e-6 * np.eye(kernel.size)):
        up, down = (float((c * profile(parameters + s)[0]).sum()) for s in (step, -step))
        slope = kernel.gradient(parameters, x, weights)[i]
        assert slope == pytest.approx((up - down) / 2e-6, rel=1e-5, abs=1e-7)


def test_a_model_with_time_predicts_for_now() -> None:
    rng = np.random.default_rng(1)
    x = np.column_stack([rng.uniform(-1.0, 1.0, (20, 2)), np.linspace(-1.0, 0.0, 20)])
    model = GaussianProcess(GaussianProcessSettings(), contexts=1)
    model.fit(x, np.sin(x[:, 0] + 2.0 * x[:, 2]) + x[:, 1] ** 2)
    model.now = np.array([-0.25])
    here = np.array([[0.3, -0.2], [0.0, 0.9]])
    then = np.column_stack([here, [-0.25, -0.25]])
    np.testing.assert_array_equal(model.predict(here), model.predict(then))
    now, whole = model.predict_with_gradient(here), model.predict_with_gradient(then)
    np.testing.assert_array_equal(now.mean_gradient, whole.mean_gradient[:, :2])
    np.testing.assert_array_equal(now.stddev_gradient, whole.stddev_gradient[:, :2])
    assert model.precision.shape == (2, 2)
    restored = GaussianProcess.from_state(
        json.loads(json.dumps(model.get_state())), x, np.sin(x[:, 0] + 2.0 * x[:, 2]) + x[:, 1] ** 2
    )
    restored.now = np.array([-0.25])
    np.testing.assert_array_equal(restored.predict(here), model.predict(here))


def test_the_front_of_a_drifting_machine_is_that_of_now() -> None:
    evaluations = 40
    last = moving(evaluations - 1)
    as_measured = tune(Optimizer(PROBLEM, seed=0), evaluations, moving)
    assert error_of_hypervolume(as_measured, last) > 0.1
    for setting in ("on", "auto"):
        optimizer = tune(Optimizer(PROBLEM, seed=0, drift=setting), evaluations, moving)
        assert abs(error_of_hypervolume(optimizer, last)) < 0.04
        front = optimizer.pareto_front(probability=False)
        off = [
            abs(p["objectives"][n] - truth(p["setpoint"], last)[n]) / p["stddevs"][n]
            for p in front
            for n in "fg"
        ]
        assert np.mean(np.array(off) < 3.0) > 0.75


def test_a_steady_machine_is_left_as_it_is() -> None:
    plain, watched = (
        tune(Optimizer(PROBLEM, seed=1, drift=drift), 20, steady) for drift in ("none", "auto")
    )
    assert [e.setpoint for e in watched.dataset.evaluations] == [
        e.setpoint for e in plain.dataset.evaluations
    ]
    assert watched.hypervolume == plain.hypervolume


@pytest.mark.parametrize("drift", ["on", "auto"])
def test_a_restored_optimizer_knows_the_time(drift: str) -> None:
    optimizer = tune(Optimizer(PROBLEM, seed=2, drift=drift, drift_time=900.0), 22, moving)
    restored = Optimizer.from_state(json.loads(json.dumps(optimizer.get_state())))
    assert restored.models.drifts == optimizer.models.drifts
    assert restored.hypervolume == optimizer.hypervolume
    for each in (optimizer, restored):
        tune(each, 3, moving)
    assert [e.setpoint for e in restored.dataset.evaluations] == [
        e.setpoint for e in optimizer.dataset.evaluations
    ]
    assert [e.time for e in restored.dataset.evaluations] == [
        e.time for e in optimizer.dataset.evaluations
    ]


def test_time_counts_evaluations_where_none_is_told_and_must_be_finite() -> None:
    optimizer = Optimizer(PROBLEM)
    here = {"x": 0.0, "y": 0.0}
    times = [
        optimizer.tell(here, {"f": 1.0, "g": 1.0}, time=t).time for t in (None, None, 7.5, None)
    ]
    assert times == [0.0, 1.0, 7.5, 8.5]
    with pytest.raises(ProblemError, match="time must be a finite number"):
        optimizer.tell(here, {"f": 1.0, "g": 1.0}, time=math.nan)
    assert len(optimizer.dataset) == 4


WITH_TEMPERATURE = Problem.from_dict(
    PROBLEM.to_dict() | {"context": {"temperature": {"unit": "C"}}}
)


def temperature(i: int) -> float:
    return 20.0 + math.sin(i / 6.0)


def tune_by_temperature(problem: Problem, evaluations: int, **settings: Any) -> Optimizer:
    """Tune a machine whose optima move with a temperature, by 0.8 for a degree."""
    optimizer = Optimizer(problem, seed=0, **settings)
    for i in range(evaluations):
        setpoint, degrees = optimizer.ask(), temperature(i)
        outputs = truth(setpoint, 0.8 * (degrees - 20.0)) | {"temperature": degrees}
        optimizer.tell(setpoint, outputs)
    return optimizer


def errors_of_front(optimizer: Optimizer, shift: float) -> np.ndarray:
    return np.array(
        [
            abs(p["objectives"][n] - truth(p["setpoint"], shift)[n])
            for p in optimizer.pareto_front(probability=False)
            for n in "fg"
        ]
    )


def test_with_a_context_the_front_is_that_of_the_last_reading() -> None:
    evaluations = 36
    shift = 0.8 * (temperature(evaluations - 1) - 20.0)
    without, known = (
        tune_by_temperature(problem, evaluations) for problem in (PROBLEM, WITH_TEMPERATURE)
    )
    assert errors_of_front(without, shift).mean() > 0.2
    assert errors_of_front(known, shift).mean() < 0.05
    restored = Optimizer.from_state(json.loads(json.dumps(known.get_state())))
    assert restored.hypervolume == known.hypervolume
    assert restored.ask() == known.ask()
    # The last reading says where predictions are for, even of an evaluation that failed.
    here = {"x": 0.0, "y": 0.0}

    def assert_predicted(degrees: float) -> None:
        predicted = known.models.predicted(PROBLEM.normalize(here)[None], np.empty((1, 0)))
        means = {name: float(mean[0]) for name, mean in predicted.items()}
        assert means == pytest.approx(truth(here, 0.8 * (degrees - 20.0)), abs=0.15)

    for degrees in (19.4, 20.6):
        known.tell(here, {"temperature": degrees}, failed=True)
        assert_predicted(degrees)
    known.forget(len(known.dataset) - 1, "temperature")
    assert_predicted(19.4)


def test_a_context_is_observed_and_may_drift_beside_time() -> None:
    assert [o.name for o in WITH_TEMPERATURE.observables] == ["temperature"]
    assert WITH_TEMPERATURE.units["temperature"] == "C"
    assert Problem.from_dict(WITH_TEMPERATURE.to_dict()) == WITH_TEMPERATURE
    for drift in ("on", "auto"):
        optimizer = tune_by_temperature(WITH_TEMPERATURE, 14, drift=drift)
        restored = Optimizer.from_state(json.loads(json.dumps(optimizer.get_state())))
        assert restored.ask() == optimizer.ask()
        assert optimizer.models.objectives[0].contexts == 1 + optimizer.models.drifts


def test_a_reading_of_a_context_lasts_until_the_next_one() -> None:
    data = Dataset(WITH_TEMPERATURE)
    here = {"x": 0.0, "y": 0.0}
    for reading in (None, 21.0, math.nan, 23.0):
        data.add(here, {"f": 1.0, "g": 1.0, "temperature": reading})
    assert data.lasting("temperature").tolist() == [21.0, 21.0, 21.0, 23.0]
    data.forget(1)
    assert data.lasting("temperature").tolist() == [23.0] * 4
    assert np.isnan(data.lasting("humidity")).all()


def test_evidence_of_drift_is_saved_where_all_was_measured_at_one_time() -> None:
    bounds = {name: {"min": 0.0, "max": 1.0} for name in "xy"}
    objectives = {name: {"reference": 2.0} for name in "fg"}
    problem = Problem.from_dict({"variables": bounds, "objectives": objectives})
    optimizer = Optimizer(problem, drift="auto")
    for _ in range(12):
        at = optimizer.ask()
        x, y = at["x"], at["y"]
        optimizer.tell(at, {"f": x + 0.1 * y, "g": 1.0 - x + 0.1 * y}, time=5.0)
    restored = Optimizer.from_state(json.loads(json.dumps(optimizer.get_state())))
    assert restored.ask() == optimizer.ask()
