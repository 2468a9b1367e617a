"""The probability of feasibility against SciPy and quadrature."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.stats import norm

from mobo_tuner.core.arrays import FloatArray
from mobo_tuner.core.constraints import ProbabilityOfFeasibility, log_probability_between
from tests.core.analytic_model import AnalyticModel

MEANS = np.array([-30.0, -5.0, -1.0, 0.0, 0.3, 2.0, 8.0, 30.0])
STDDEVS = np.array([1.0, 0.5, 2.0, 1.0, 0.1, 3.0, 1.0, 0.7])


def values(lower: float, upper: float) -> FloatArray:
    return log_probability_between(MEANS, STDDEVS, lower, upper)[0]


def test_one_sided() -> None:
    np.testing.assert_allclose(
        values(-math.inf, 0.2), norm.logcdf((0.2 - MEANS) / STDDEVS), rtol=1e-11, atol=1e-15
    )
    np.testing.assert_allclose(
        values(0.2, math.inf), norm.logsf((0.2 - MEANS) / STDDEVS), rtol=1e-11, atol=1e-15
    )


@pytest.mark.parametrize(
    ("lower", "upper"), [(-1.0, 1.0), (0.2, 0.25), (0.0, 1e-4), (-40.0, 3.0), (0.2999, 0.3001)]
)
def test_two_sided(lower: float, upper: float) -> None:
    expected = []
    for mean, stddev in zip(MEANS, STDDEVS, strict=True):
        a, b = (lower - mean) / stddev, (upper - mean) / stddev
        near = min(max(0.0, a), b)  # where the density is largest

        def scaled(z: float, near: float = near) -> float:
            return math.exp(0.5 * (near - z) * (near + z))

        corners = [a, *sorted(min(max(near + k, a), b) for k in (-8, -1, 0, 1, 8)), b]
        pieces = [
            quad(scaled, p, q, epsabs=0.0, epsrel=1e-12)[0]
            for p, q in itertools.pairwise(corners)
            if q > p
        ]
        expected.append(norm.logpdf(near) + math.log(sum(pieces)))
    np.testing.assert_allclose(values(lower, upper), expected, rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize(
    ("lower", "upper"),
    [(-math.inf, 0.2), (0.2, math.inf), (-1.0, 1.0), (0.2, 0.25), (0.0, 1e-7), (-40.0, 3.0)],
)
def test_slopes_agree_with_finite_differences(lower: float, upper: float) -> None:
    _, by_mean, by_stddev = log_probability_between(MEANS, STDDEVS, lower, upper)
    for which, slope in (("mean", by_mean), ("stddev", by_stddev)):
        step = 1e-6 * STDDEVS
        shift_mean, shift_stddev = (step, 0.0) if which == "mean" else (0.0, step)
        up, _, _ = log_probability_between(MEANS + shift_mean, STDDEVS + shift_stddev, lower, upper)
        down, _, _ = log_probability_between(
            MEANS - shift_mean, STDDEVS - shift_stddev, lower, upper
        )
        np.testing.assert_allclose(slope, (up - down) / (2.0 * step), rtol=1e-4, atol=1e-4)


@pytest.mark.parametrize("far", [1e3, 1e6, 1e9, 1e60])
def test_finite_with_the_right_slope_however_far(far: float) -> None:
    mean, stddev = np.array([far, -far]), np.ones(2)
    value, by_mean, by_stddev = log_probability_between(mean, stddev, -1.0, 1.0)
    np.testing.assert_allclose(value, -0.5 * (far - 1.0) ** 2, rtol=0.1)
    np.testing.assert_allclose(by_mean, [-far, far], rtol=1e-2)
    np.testing.assert_allclose(by_stddev, far * far, rtol=1e-2)


def test_certain_predictions() -> None:
    mean = np.array([0.5, 2.0, 1.0, -1.0])
    value, by_mean, by_stddev = log_probability_between(mean, np.zeros(4), 0.0, 1.0)
    np.testing.assert_array_equal(value, [0.0, -np.inf, 0.0, -np.inf])
    np.testing.assert_array_equal(by_mean, 0.0)
    np.testing.assert_array_equal(by_stddev, 0.0)


def test_probability_is_at_most_one() -> None:
    rng = np.random.default_rng(0)
    mean, stddev = 10.0 ** rng.uniform(-9, 9, 1000), 10.0 ** rng.uniform(-9, 9, 1000)
    for lower, upper in ((-math.inf, 1.0), (1.0, math.inf), (1.0, 2.0)):
        value, by_mean, by_stddev = log_probability_between(mean, stddev, lower, upper)
        assert (value <= 1e-15).all()
        assert np.isfinite(value).all()
        assert np.isfinite(by_mean).all()
        assert np.isfinite(by_stddev).all()


def test_factor_is_the_probability_of_its_model() -> None:
    model = AnalyticModel(3, seed=0)
    inputs = np.random.default_rng(1).uniform(-1.0, 1.0, (9, 3))
    mean, stddev = model.predict(inputs)
    factor = ProbabilityOfFeasibility(model, lower=0.5, upper=1.5)
    expected = norm.cdf((1.5 - mean) / stddev) - norm.cdf((0.5 - mean) / stddev)
    np.testing.assert_allclose(np.exp(factor.log_value(inputs)), expected, rtol=1e-9)


def test_wrong_limits() -> None:
    model = AnalyticModel(1, seed=0)
    with pytest.raises(ValueError, match=r"lower must be below upper, not 1.0 and 1.0"):
        ProbabilityOfFeasibility(model, 1.0, 1.0)
    with pytest.raises(ValueError, match="lower must be below upper"):
        ProbabilityOfFeasibility(model, math.nan, 1.0)
    with pytest.raises(ValueError, match="lower or upper must be finite"):
        ProbabilityOfFeasibility(model)
