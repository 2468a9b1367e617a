"""A machine that drifts: what is said of it is true now, and one that does not is left as it is."""

from __future__ import annotations

import json
import math
from collections.abc import Callable

import moocore
import numpy as np
import pytest

from mobo_tuner.core import Optimizer, Problem, ProblemError
from mobo_tuner.core.gaussian_process import GaussianProcess
from mobo_tuner.core.gaussian_process_settings import GaussianProcessSettings
from mobo_tuner.core.kernels import KERNELS, Timed

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


@pytest.mark.parametrize("name", list(KERNELS))
def test_the_gradient_of_a_kernel_with_time_by_finite_differences(name: str) -> None:
    rng = np.random.default_rng(0)
    kernel = Timed(KERNELS.find(name)(2))
    parameters = kernel.default_parameters() + 0.2 * rng.standard_normal(kernel.size)
    x, c = rng.uniform(-1.0, 1.0, (6, 3)), rng.standard_normal((6, 6))
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
    model = GaussianProcess(GaussianProcessSettings(), timed=True)
    model.fit(x, np.sin(x[:, 0] + 2.0 * x[:, 2]) + x[:, 1] ** 2)
    model.now = -0.25
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
    restored.now = -0.25
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
    with pytest.raises(ProblemError, match="time is nan"):
        optimizer.tell(here, {"f": 1.0, "g": 1.0}, time=math.nan)
    assert len(optimizer.dataset) == 4
