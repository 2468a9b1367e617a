"""Acquisition functions against SciPy, Monte Carlo and finite differences."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.stats import norm

from mobo_tuner.core.acquisition import (
    AcquisitionFunction,
    Average,
    ExpectedHypervolumeImprovement,
    ExpectedImprovement,
    Predictions,
    Product,
    UpperConfidenceBound,
    UpperConfidenceBoundHypervolumeImprovement,
    beta_schedule,
)
from mobo_tuner.core.arrays import FloatArray
from mobo_tuner.core.constraints import ProbabilityOfFeasibility
from mobo_tuner.core.hypervolume import BoxDecomposition
from mobo_tuner.core.proximal import ProximalBiasing
from tests.core.analytic_model import AnalyticModel


class FixedModel:
    """Given moments, whatever the input; the first variable shifts the mean."""

    def __init__(self, mean: FloatArray, stddev: FloatArray) -> None:
        self.mean = np.asarray(mean, dtype=float)
        self.stddev = np.asarray(stddev, dtype=float)

    def predict(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        return self.mean + x[:, 0], self.stddev

    def predict_with_gradient(
        self, x: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        mean_gradient = np.zeros_like(x)
        mean_gradient[:, 0] = 1.0
        return self.mean + x[:, 0], self.stddev, mean_gradient, np.zeros_like(x)


def models(n_objectives: int, n_variables: int, **options: float) -> list[AnalyticModel]:
    return [AnalyticModel(n_variables, seed, **options) for seed in range(n_objectives)]


def front(n_objectives: int, scale: float = 1.0) -> BoxDecomposition:
    points = np.random.default_rng(3).uniform(0.1, 2.0, (15, n_objectives))
    return BoxDecomposition(np.full(n_objectives, 2.2 * scale), scale * points)


def box(n_objectives: int) -> tuple[FloatArray, FloatArray]:
    return np.full(n_objectives, -0.3), np.full(n_objectives, 2.2)


def every_function(n_variables: int) -> dict[str, AcquisitionFunction]:
    objectives = models(3, n_variables)
    decomposition = front(3)
    center = np.full(n_variables, 0.1)
    rng = np.random.default_rng(0)
    root = rng.standard_normal((n_variables, n_variables))
    ehvi = ExpectedHypervolumeImprovement(objectives, decomposition)
    ucb = UpperConfidenceBoundHypervolumeImprovement(objectives, decomposition, beta=2.0)
    feasible = ProbabilityOfFeasibility(objectives[0], upper=0.3)
    near = ProximalBiasing(center, root @ root.T)
    return {
        "ei": ExpectedImprovement(objectives[0], 0.2),
        "ucb": UpperConfidenceBound(objectives[0], 4.0, 1.5),
        "ehvi": ehvi,
        "tehvi": ExpectedHypervolumeImprovement(objectives, decomposition, box(3)),
        "ucb_hvi": ucb,
        "tucb_hvi": UpperConfidenceBoundHypervolumeImprovement(
            objectives, decomposition, 2.0, box(3)
        ),
        "average": Average([ehvi, ucb, UpperConfidenceBound(objectives[0], 4.0, 0.5)]),
        "at most": feasible,
        "at least": ProbabilityOfFeasibility(objectives[1], lower=3.0),
        "between": ProbabilityOfFeasibility(objectives[2], 0.0, 0.1),
        "proximal": near,
        "all": ehvi * feasible * ProbabilityOfFeasibility(objectives[1], 0.1, 0.5) * near,
        "ucb, all": ucb * near * feasible,
        "no objective": feasible * ProbabilityOfFeasibility(objectives[1], lower=3.0),
    }


@pytest.mark.parametrize("n_variables", [1, 6])
@pytest.mark.parametrize("name", list(every_function(1)))
def test_gradients_agree_with_finite_differences(name: str, n_variables: int) -> None:
    function = every_function(n_variables)[name]
    inputs = np.random.default_rng(1).uniform(-1.0, 1.0, (40, n_variables))
    value, gradient = function.log_value_with_gradient(inputs)
    assert value.shape == (40,)
    assert gradient.shape == inputs.shape
    np.testing.assert_allclose(function.log_value(inputs), value, rtol=1e-9)
    assert np.isfinite(value).sum() >= 3
    assert not gradient[~np.isfinite(value)].any()
    step = 1e-6
    for j in range(n_variables):
        up, down = inputs.copy(), inputs.copy()
        up[:, j] += step
        down[:, j] -= step
        up_value, down_value = function.log_value(up), function.log_value(down)
        smooth = np.isfinite(up_value) & np.isfinite(down_value) & np.isfinite(value)
        numeric = (up_value[smooth] - down_value[smooth]) / (2.0 * step)
        np.testing.assert_allclose(gradient[smooth, j], numeric, rtol=2e-5, atol=2e-5)


def test_expected_improvement_formula() -> None:
    mean, stddev = np.array([0.0, 1.0, 3.0, -2.0]), np.array([1.0, 0.5, 2.0, 0.1])
    function = ExpectedImprovement(FixedModel(mean, stddev), best=0.7)
    z = (0.7 - mean) / stddev
    expected = (0.7 - mean) * norm.cdf(z) + stddev * norm.pdf(z)
    np.testing.assert_allclose(function.log_value(np.zeros((4, 1))), np.log(expected), rtol=1e-12)


@pytest.mark.parametrize("far", [1.0, 7.0, 35.0, 99.0, 101.0, 1e4, 1e8])
def test_expected_improvement_far_in_the_tail(far: float) -> None:
    function = ExpectedImprovement(FixedModel(np.array([far]), np.array([1.0])), best=0.0)
    value, gradient = function.log_value_with_gradient(np.zeros((1, 2)))
    # E = phi(far) integral_0^inf s exp(-far s - s^2/2) ds; here with t = far s
    integral = quad(lambda t: t * math.exp(-t - 0.5 * (t / far) ** 2), 0.0, 60.0, epsrel=1e-12)[0]
    expected = norm.logpdf(far) + math.log(integral) - 2.0 * math.log(far)
    assert value[0] == pytest.approx(expected, rel=1e-11)
    assert gradient[0, 0] == pytest.approx(-far, rel=2.5 / far**2 + 1e-12)
    assert gradient[0, 1] == 0.0


def test_expected_improvement_of_a_certain_prediction() -> None:
    mean = np.array([-1.0, 1.0, 0.0])
    function = ExpectedImprovement(FixedModel(mean, np.zeros(3)), best=0.0)
    value, gradient = function.log_value_with_gradient(np.zeros((3, 1)))
    np.testing.assert_array_equal(value, [0.0, -np.inf, -np.inf])
    np.testing.assert_array_equal(gradient, [[-1.0], [0.0], [0.0]])


def test_upper_confidence_bound_formula() -> None:
    mean, stddev = np.array([0.0, 1.0, 5.0]), np.array([1.0, 0.5, 0.1])
    function = UpperConfidenceBound(FixedModel(mean, stddev), beta=4.0, reference=2.0)
    value = function.log_value(np.zeros((3, 1)))
    np.testing.assert_allclose(np.exp(value), [4.0, 2.0, 0.0])
    assert value[2] == -np.inf


def test_hypervolume_functions_are_those_of_the_decomposition() -> None:
    objectives, decomposition = models(4, 2), front(4)
    inputs = np.random.default_rng(5).uniform(-1.0, 1.0, (50, 2))
    mean = np.stack([m.predict(inputs)[0] for m in objectives], axis=1)
    stddev = np.stack([m.predict(inputs)[1] for m in objectives], axis=1)
    lower = box(4)[0]
    ehvi = ExpectedHypervolumeImprovement(objectives, decomposition)
    ucb = UpperConfidenceBoundHypervolumeImprovement(objectives, decomposition, beta=0.25)
    boxed = UpperConfidenceBoundHypervolumeImprovement(objectives, decomposition, 0.25, box(4))
    boxed_ehvi = ExpectedHypervolumeImprovement(objectives, decomposition, box(4))
    point = mean - 0.5 * stddev
    for function, expected in (
        (ehvi, decomposition.expected_improvement(mean, stddev)),
        (boxed_ehvi, decomposition.expected_improvement(mean, stddev, lower)),
        (ucb, decomposition.improvement(point)),
        (boxed, np.where((point >= lower).all(1), decomposition.improvement(point), 0.0)),
    ):
        np.testing.assert_allclose(np.exp(function.log_value(inputs)), expected, rtol=1e-10)
    assert (point < lower).any()


def test_points_added_to_the_decomposition_count() -> None:
    objectives, decomposition = models(2, 2), BoxDecomposition([2.0, 2.0])
    function = ExpectedHypervolumeImprovement(objectives, decomposition)
    before = function.log_value([[0.0, 0.0]])
    decomposition.add([0.0, 0.0])
    assert function.log_value([[0.0, 0.0]]) < before


def test_zero_is_minus_infinity_with_a_zero_gradient() -> None:
    objectives = models(2, 3, stddev=1e-3)
    decomposition = BoxDecomposition([1.0, 1.0], [[-5.0, -5.0]])
    near = ProximalBiasing(np.zeros(3), 1.0)
    for function in (
        UpperConfidenceBoundHypervolumeImprovement(objectives, decomposition, 0.01),
        UpperConfidenceBound(objectives[0], 0.01, -9.0),
    ):
        for each in (function, function * near, near * function):
            value, gradient = each.log_value_with_gradient(np.full((4, 3), 0.5))
            np.testing.assert_array_equal(value, -np.inf)
            np.testing.assert_array_equal(gradient, 0.0)
            np.testing.assert_array_equal(each.log_value(np.full((4, 3), 0.5)), -np.inf)


def test_product_of_tiny_probabilities_does_not_underflow() -> None:
    factors = [
        ProbabilityOfFeasibility(FixedModel(np.array([20.0 + i]), np.array([1.0])), upper=0.0)
        for i in range(10)
    ]
    value, gradient = Product(factors).log_value_with_gradient(np.zeros((1, 2)))
    expected = norm.logcdf(-20.0 - np.arange(10)).sum()
    assert value[0] == pytest.approx(expected, rel=1e-12)
    assert value[0] < -2000.0
    assert gradient[0, 0] == pytest.approx(-(24.5 * 10), rel=1e-2)


@pytest.mark.parametrize("scale", [1e-9, 1.0, 1e9])
def test_scaling_the_objectives_only_adds_a_constant(scale: float) -> None:
    plain = ExpectedHypervolumeImprovement(models(4, 3), front(4))
    scaled = ExpectedHypervolumeImprovement(models(4, 3, scale=scale), front(4, scale))
    inputs = np.random.default_rng(9).uniform(-1.0, 1.0, (20, 3))
    value, gradient = plain.log_value_with_gradient(inputs)
    scaled_value, scaled_gradient = scaled.log_value_with_gradient(inputs)
    np.testing.assert_allclose(scaled_value, value + 4.0 * math.log(scale), rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(scaled_gradient, gradient, rtol=1e-7, atol=1e-9)


def test_an_average_is_the_mean_of_the_values() -> None:
    functions = [every_function(2)[name] for name in ("ehvi", "ucb_hvi", "proximal")]
    inputs = np.random.default_rng(4).uniform(-1.0, 1.0, (30, 2))
    values = np.exp([function.log_value(inputs) for function in functions])
    average = np.exp(Average(functions).log_value(inputs))
    np.testing.assert_allclose(average, values.mean(axis=0), rtol=1e-9)
    with pytest.raises(ValueError, match="at least one"):
        Average([])


def test_each_model_is_asked_once() -> None:
    objectives = models(3, 2)
    function: AcquisitionFunction = ExpectedHypervolumeImprovement(objectives, front(3))
    for model in objectives:
        function = function * ProbabilityOfFeasibility(model, upper=1.0)
    function.log_value_with_gradient(np.zeros((5, 2)))
    assert [model.calls for model in objectives] == [1, 1, 1]
    function.log_value(np.zeros((5, 2)))
    assert [model.calls for model in objectives] == [2, 2, 2]


def test_product_does_not_depend_on_the_order() -> None:
    objectives = models(2, 2)
    a = ExpectedHypervolumeImprovement(objectives, front(2))
    b = ProbabilityOfFeasibility(objectives[0], upper=0.5)
    c = ProximalBiasing([0.0, 0.0], [1.0, 2.0])
    inputs = np.random.default_rng(2).uniform(-1.0, 1.0, (10, 2))
    np.testing.assert_allclose((a * b * c).log_value(inputs), (c * (b * a)).log_value(inputs))


def test_no_candidates() -> None:
    function = ExpectedHypervolumeImprovement(models(2, 2), front(2))
    assert function.log_value(np.empty((0, 2))).shape == (0,)
    value, gradient = function.log_value_with_gradient(np.empty((0, 2)))
    assert value.shape == (0,)
    assert gradient.shape == (0, 2)


def test_beta_schedule_grows() -> None:
    values = [beta_schedule(n, 6) for n in (1, 10, 100)]
    assert values == sorted(values)
    assert values[0] == pytest.approx(2.0 * math.log(6 * math.pi**2 / 0.6))
    with pytest.raises(ValueError, match="n_evaluations"):
        beta_schedule(0, 6)


def test_wrong_arguments() -> None:
    two, decomposition = models(2, 2), front(2)
    with pytest.raises(ValueError, match="models must be one for each of 2 objectives, not 1"):
        ExpectedHypervolumeImprovement(two[:1], decomposition)
    with pytest.raises(ValueError, match="beta must be finite and at least 0, not -1"):
        UpperConfidenceBoundHypervolumeImprovement(two, decomposition, -1.0)
    with pytest.raises(ValueError, match="beta must be finite"):
        UpperConfidenceBound(two[0], math.nan, 0.0)
    with pytest.raises(ValueError, match="best must be finite"):
        ExpectedImprovement(two[0], math.nan)
    with pytest.raises(ValueError, match="reference must be finite"):
        UpperConfidenceBound(two[0], 1.0, math.inf)
    with pytest.raises(ValueError, match="truncation must end at B"):
        ExpectedHypervolumeImprovement(two, decomposition, ([0.0, 0.0], [1.0, 2.2]))
    with pytest.raises(ValueError, match="truncation must have A < B"):
        ExpectedHypervolumeImprovement(two, decomposition, ([0.0, 2.2], [2.2, 2.2]))
    with pytest.raises(ValueError, match="at least one acquisition function"):
        Product([])
    with pytest.raises(ValueError, match="inputs must have shape"):
        Predictions([0.0, 0.0])
