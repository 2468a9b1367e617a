import numpy as np
import pytest
from scipy.stats import norm

from mobo_tuner.core.output_scaling import OutputScaling, has_heavy_tail
from mobo_tuner.core.output_transform import Logarithm, SignedLogarithm


def test_standardised_residuals_have_no_mean_and_unit_spread():
    rng = np.random.default_rng(0)
    x, y = rng.uniform(-1, 1, (20, 2)), 50.0 + 3.0 * rng.normal(size=20)
    scaling = OutputScaling.of(x, y)
    z = scaling.standardise(x, y)
    assert z.mean() == pytest.approx(0.0, abs=1e-12)
    assert z.std() == pytest.approx(1.0)
    mean, stddev = scaling.unstandardise(x, z, np.ones(20))
    np.testing.assert_allclose(mean, y)
    np.testing.assert_allclose(stddev, y.std())


def test_given_mean_and_spread_of_the_data():
    x, y = np.zeros((3, 1)), np.array([1.0, 2.0, 3.0])
    scaling = OutputScaling.of(x, y, offset=10.0)
    np.testing.assert_allclose(scaling.standardise(x, y), (y - 10.0) / y.std())


@pytest.mark.parametrize(
    ("y", "offset", "scale"),
    [
        ([5.0], None, 5.0),  # nothing known but a magnitude
        ([5.0, 5.0], None, 2.5),
        ([5.0] * 10, None, 0.5),
        ([5.0, 5.0], 8.0, 3.0),  # the distance from the prior mean
        ([0.0, 0.0], None, 0.5),
        ([5.0, 5.0 + 1e-14], None, 2.5),  # equal to rounding
        ([1e9, 1e9 + 1.0], None, 0.5),
    ],
)
def test_scale_of_equal_outputs(y, offset, scale):
    x = np.zeros((len(y), 1))
    assert OutputScaling.of(x, np.array(y), offset=offset).scale == pytest.approx(scale)


def test_mean_function_and_its_gradients():
    def mean(x):
        return np.sin(x[:, 0]) * x[:, 1]

    x = np.random.default_rng(0).uniform(-1, 1, (6, 2))
    scaling = OutputScaling.of(x, mean(x) + x[:, 0], mean=mean)
    residuals = scaling.standardise(x, mean(x) + x[:, 0]) * scaling.scale
    np.testing.assert_allclose(residuals, x[:, 0] - x[:, 0].mean())
    expected = np.column_stack([np.cos(x[:, 0]) * x[:, 1], np.sin(x[:, 0])])
    np.testing.assert_allclose(scaling.prior_mean_gradient(x), expected, rtol=1e-8)
    given = OutputScaling(None, 0.0, 1.0, mean, lambda x: 2.0 * x)
    np.testing.assert_array_equal(given.prior_mean_gradient(x), 2.0 * x)


def test_perfect_mean_function():
    x, y = np.array([[0.0], [1.0]]), np.array([2.0, 4.0])
    scaling = OutputScaling.of(x, y, mean=lambda x: 2.0 + 2.0 * x[:, 0])
    assert scaling.scale == pytest.approx(2.0)
    assert (scaling.standardise(x, y) == 0.0).all()


def test_noise_of_a_logarithm_is_relative():
    scaling = OutputScaling(Logarithm(), 0.0, 0.5)
    variances = scaling.noise_variances(np.array([2.0, 10.0]), np.array([0.2, 0.2]))
    np.testing.assert_allclose(variances, [0.2**2, 0.04**2])


@pytest.mark.parametrize("transform", [None, Logarithm(), SignedLogarithm(3.0, 2.0)])
def test_log_slope_is_that_of_standardise(transform):
    x, y, h = np.zeros((3, 1)), np.array([0.5, 2.0, 30.0]), 1e-6
    scaling = OutputScaling(transform, 1.0, 4.0)
    slope = (scaling.standardise(x, y + h) - scaling.standardise(x, y - h)) / (2.0 * h)
    np.testing.assert_allclose(scaling.log_slope(y), np.log(slope), rtol=1e-6)


def test_log_normal_shares_median_and_lower_quantile():
    scaling = OutputScaling(Logarithm(), 0.0, 1.0)
    mean, stddev = scaling.to_output(np.array([0.3]), np.array([0.7]))
    draws = np.exp(np.random.default_rng(0).normal(0.3, 0.7, 200_000))
    assert mean[0] == pytest.approx(np.median(draws), rel=0.01)
    assert mean[0] - stddev[0] == pytest.approx(np.quantile(draws, norm.cdf(-1.0)), rel=0.01)


@pytest.mark.parametrize("s", [0.05, 0.2, 0.6])
@pytest.mark.parametrize("q", [-0.5, 0.0, 0.5])
def test_expected_improvement_under_a_logarithm(s, q):
    target = np.exp(q * s)
    exact = target * norm.cdf(q) - np.exp(0.5 * s * s) * norm.cdf(q - s)
    mean, stddev = (
        part[0] for part in OutputScaling(Logarithm(), 0.0, 1.0).to_output(*np.array([[0.0], [s]]))
    )
    z = (target - mean) / stddev
    assert stddev * (z * norm.cdf(z) + norm.pdf(z)) == pytest.approx(exact, rel=0.3)


@pytest.mark.parametrize("mean", [3.0, 5.0, 6.4])
def test_far_above_what_is_sought_a_low_value_is_as_improbable_as_it_is(mean):
    low, s = np.log(20.0), 0.7
    scaling = OutputScaling(Logarithm(low), 0.0, 1.0)
    median, stddev = (part[0] for part in scaling.to_output(np.array([mean]), np.array([s])))
    assert median == pytest.approx(np.exp(mean))
    depth = max((mean - low) / s, 1.0)  # at least one standard deviation
    quantile = np.exp(mean - depth * s)
    assert norm.logcdf((quantile - median) / stddev) == pytest.approx(norm.logcdf(-depth))


@pytest.mark.parametrize("low", [-1.0, 0.5, np.inf])
def test_gradients_of_the_log_normal_are_those_of_its_moments(low):
    scaling, h = OutputScaling(Logarithm(low), 0.0, 1.0), 1e-6
    mean, stddev = np.linspace(-2.0, 3.0, 17), np.linspace(0.1, 2.0, 17)
    for step in ((h, 0.0), (0.0, h)):
        slopes = [np.full((17, 1), part / h) for part in step]
        gradients = scaling.gradients_to_output(mean, stddev, *slopes)
        above = scaling.to_output(mean + step[0], stddev + step[1])
        below = scaling.to_output(mean - step[0], stddev - step[1])
        for gradient, a, b in zip(gradients, above, below, strict=True):
            np.testing.assert_allclose(gradient[:, 0], (a - b) / (2.0 * h), rtol=1e-6, atol=1e-6)


def test_heavy_tails_are_those_of_two_decades_and_more():
    for decades, heavy in ((1.0, False), (1.7, False), (2.5, True), (4.0, True)):
        y = 10.0 ** np.linspace(0.0, decades, 21)
        assert has_heavy_tail(y) == heavy
        assert not has_heavy_tail(-y)
    assert not has_heavy_tail(np.full(5, 2.0))


def test_log_normal_of_huge_numbers_is_finite():
    scaling = OutputScaling(Logarithm(), 0.0, 1.0)
    for part in scaling.to_output(np.array([1e5, -1e5]), np.array([1e5, 1e5])):
        assert np.isfinite(part).all()
