"""The logarithm of the expected hypervolume improvement, near and far."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.stats import norm

from mobo_tuner.core.acquisition import ExpectedHypervolumeImprovement
from mobo_tuner.core.hypervolume import BoxDecomposition
from tests.core.analytic_model import AnalyticModel


@pytest.mark.parametrize("n_objectives", [1, 2, 3, 7])
@pytest.mark.parametrize("floor", [None, -0.1])
def test_it_is_the_logarithm_where_that_can_be_computed(
    n_objectives: int, floor: float | None
) -> None:
    rng = np.random.default_rng(n_objectives)
    boxes = BoxDecomposition(np.full(n_objectives, 1.1), rng.uniform(0.0, 1.0, (40, n_objectives)))
    mean = rng.uniform(-0.2, 2.0, (50, n_objectives))
    stddev = 10.0 ** rng.uniform(-1.0, 0.3, mean.shape)
    lower = None if floor is None else np.full(n_objectives, floor)
    value, by_mean, by_stddev = boxes.expected_improvement_with_gradient(mean, stddev, lower)
    logs = boxes.log_expected_improvement_with_gradient(mean, stddev, lower)
    rows = value > 1e-250
    assert rows.sum() > 30
    np.testing.assert_allclose(logs[0][rows], np.log(value[rows]), atol=1e-7)
    for log_slope, slope in zip(logs[1:], (by_mean, by_stddev), strict=True):
        expected = slope[rows] / value[rows][:, None]
        np.testing.assert_allclose(log_slope[rows], expected, rtol=1e-5, atol=1e-5)


@pytest.mark.parametrize("floor", [None, 0.2])
def test_far_from_any_improvement_it_is_finite_and_has_its_gradient(floor: float | None) -> None:
    rng = np.random.default_rng(0)
    boxes = BoxDecomposition(np.full(3, 1.1), rng.uniform(0.0, 1.0, (30, 3)))
    lower = None if floor is None else np.full(3, floor)
    mean, stddev = rng.uniform(3.0, 5.0, (20, 3)), 10.0 ** rng.uniform(-3.0, -1.5, (20, 3))
    assert not boxes.expected_improvement(mean, stddev, lower).any()
    value, by_mean, by_stddev = boxes.log_expected_improvement_with_gradient(mean, stddev, lower)
    assert np.isfinite(value).all()
    assert (value < -1e3).all()
    for j in range(3):
        step = np.zeros(3)
        step[j] = 1e-6

        def change(m: np.ndarray, s: np.ndarray) -> np.ndarray:
            ends = [
                boxes.log_expected_improvement_with_gradient(
                    mean + sign * m, stddev + sign * s, lower
                )[0]
                for sign in (1.0, -1.0)
            ]
            return np.asarray(ends[0] - ends[1])

        slope = change(step, np.zeros(3)) / 2e-6
        np.testing.assert_allclose(slope, by_mean[:, j], rtol=1e-4)
        slope = change(np.zeros(3), step * stddev[:, [j]]) / (2e-6 * stddev[:, j])
        np.testing.assert_allclose(slope, by_stddev[:, j], rtol=1e-4)


def test_one_truncated_objective_agrees_with_quadrature() -> None:
    boxes = BoxDecomposition([1.0])
    mean, stddev, lower = 1.5, 0.02, 0.9
    # In units of the density at the reference point, which by itself would underflow.
    shift = norm.logpdf(1.0, mean, stddev)
    integral, _ = quad(
        lambda y: (1.0 - y) * np.exp(norm.logpdf(y, mean, stddev) - shift),
        lower,
        1.0,
        points=[0.999],
    )
    [value], *_ = boxes.log_expected_improvement_with_gradient([[mean]], [[stddev]], [lower])
    assert value == pytest.approx(shift + np.log(integral), abs=1e-5)


def test_the_acquisition_function_has_a_slope_at_any_distance() -> None:
    model = AnalyticModel(2, seed=0)
    boxes = BoxDecomposition([-1e3, -1e3])
    far = ExpectedHypervolumeImprovement([model, model], boxes)
    x = np.random.default_rng(0).uniform(-1.0, 1.0, (6, 2))
    value, gradient = far.log_value_with_gradient(x)
    np.testing.assert_array_equal(value, far.log_value(x))
    assert np.isfinite(value).all()
    for j in range(2):
        step = 1e-6 * np.eye(2)[j]
        slope = (far.log_value(x + step) - far.log_value(x - step)) / 2e-6
        np.testing.assert_allclose(gradient[:, j], slope, rtol=1e-3)
