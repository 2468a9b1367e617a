"""The weighted sum against sampling and finite differences."""

from __future__ import annotations

import numpy as np
import pytest

from mobo_tuner.core.acquisition import ExpectedImprovement
from mobo_tuner.core.scalarisation import WeightedSum
from tests.core.analytic_model import AnalyticModel

WEIGHTS = np.array([0.5, 2.0, 0.0])


def test_moments_are_those_of_the_sum() -> None:
    models = [AnalyticModel(2, seed) for seed in range(3)]
    inputs = np.array([[0.1, -0.4]])
    rng = np.random.default_rng(0)
    samples = np.zeros(200_000)
    for weight, model in zip(WEIGHTS, models, strict=True):
        mean, stddev = model.predict(inputs)
        samples += weight * (mean + stddev * rng.standard_normal(len(samples)))
    mean, stddev = WeightedSum(models, WEIGHTS).predict(inputs)
    assert abs(samples.mean() - mean[0]) < 4.0 * stddev[0] / np.sqrt(len(samples))
    assert stddev[0] == pytest.approx(samples.std(), rel=0.01)


def test_gradients_agree_with_finite_differences() -> None:
    model = WeightedSum([AnalyticModel(3, seed) for seed in range(3)], WEIGHTS)
    inputs = np.random.default_rng(1).uniform(-1.0, 1.0, (5, 3))
    mean, stddev, mean_gradient, stddev_gradient = model.predict_with_gradient(inputs)
    np.testing.assert_allclose(model.predict(inputs), (mean, stddev))
    step = 1e-6
    for j in range(3):
        shift = step * np.eye(3)[j]
        up, down = model.predict(inputs + shift), model.predict(inputs - shift)
        np.testing.assert_allclose(mean_gradient[:, j], (up[0] - down[0]) / (2 * step), rtol=1e-6)
        np.testing.assert_allclose(stddev_gradient[:, j], (up[1] - down[1]) / (2 * step), rtol=1e-5)


def test_it_serves_single_objective_functions() -> None:
    model = WeightedSum([AnalyticModel(2, seed) for seed in range(3)], WEIGHTS)
    assert np.isfinite(ExpectedImprovement(model, 0.0).log_value([[0.0, 0.0]]))


def test_certain_objectives() -> None:
    model = WeightedSum([AnalyticModel(2, seed, stddev=0.0) for seed in range(2)], [1.0, 1.0])
    _, stddev, _, stddev_gradient = model.predict_with_gradient(np.zeros((1, 2)))
    assert stddev[0] == 0.0
    np.testing.assert_array_equal(stddev_gradient, 0.0)


@pytest.mark.parametrize("weights", [[-1.0, 1.0], [0.0, 0.0], [np.nan, 1.0]])
def test_wrong_weights(weights: list[float]) -> None:
    with pytest.raises(ValueError, match="at least 0 and not all 0"):
        WeightedSum([AnalyticModel(2, 0), AnalyticModel(2, 1)], weights)


def test_wrong_number_of_weights() -> None:
    with pytest.raises(ValueError, match=r"weights must have shape \(1,\), not \(2,\)"):
        WeightedSum([AnalyticModel(2, 0)], [1.0, 1.0])
