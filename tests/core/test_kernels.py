import numpy as np
import pytest
from scipy import stats
from scipy.optimize import approx_fprime, check_grad

from mobo_tuner.core.kernels import (
    KERNELS,
    Matern52Full,
    RBFFull,
    as_inputs,
    precision_from_hessian,
    squared_distances,
)

NAMES = tuple(KERNELS)


def _parameters(kernel, rng):
    return kernel.default_parameters() + 0.4 * rng.normal(size=kernel.size)


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("d", [1, 3])
def test_profile_slope_is_the_derivative(name, d):
    kernel = KERNELS.find(name)(d)
    r2 = np.array([1e-3, 0.1, 1.0, 4.0, 30.0])
    h = 1e-6
    derivative = (kernel.profile(r2 + h)[0] - kernel.profile(r2 - h)[0]) / (2.0 * h)
    np.testing.assert_allclose(kernel.profile(r2)[1], -2.0 * derivative, rtol=1e-5, atol=1e-9)
    at_zero, _ = kernel.profile(np.zeros(1))
    assert at_zero[0] == 1.0


@pytest.mark.parametrize("name", NAMES)
def test_factor_makes_the_equation_of_the_docstring(name):
    rng = np.random.default_rng(1)
    kernel = KERNELS.find(name)(3)
    parameters = _parameters(kernel, rng)
    x = rng.uniform(-1, 1, (4, 3))
    if isinstance(kernel, RBFFull):
        triangle = np.zeros((3, 3))
        triangle[np.triu_indices(3)] = parameters[:6]
        precision = triangle @ triangle.T + np.diag(np.exp(parameters[6:]))
    elif isinstance(kernel, Matern52Full):
        a, b, c = parameters[3:]
        factor = np.diag(np.exp(-parameters[:3])) @ [[1, a, b], [a, 1, c], [b, c, 1]]
        precision = factor @ factor.T
    else:
        precision = np.diag(np.broadcast_to(np.exp(-2.0 * parameters), 3))
    scaled = x @ kernel.factor(parameters)
    difference = x[:, None] - x[None]
    expected = np.einsum("ija,ab,ijb->ij", difference, precision, difference)
    np.testing.assert_allclose(squared_distances(scaled, scaled), expected, atol=1e-12)


@pytest.mark.parametrize("name", NAMES)
def test_gradient_in_the_parameters_by_finite_differences(name):
    rng = np.random.default_rng(2)
    kernel = KERNELS.find(name)(3)
    x = rng.uniform(-1, 1, (6, 3))
    weights = rng.normal(size=(6, 6))
    weights += weights.T
    np.fill_diagonal(weights, 0.0)

    def loss(parameters):
        scaled = x @ kernel.factor(parameters)
        return float((weights * kernel.profile(squared_distances(scaled, scaled))[0]).sum())

    def gradient(parameters):
        scaled = x @ kernel.factor(parameters)
        slope = kernel.profile(squared_distances(scaled, scaled))[1]
        full = kernel.gradient(parameters, x, slope * weights)
        folded = kernel.gradient(parameters, x, 2.0 * np.tril(slope * weights))
        np.testing.assert_allclose(full, folded, atol=1e-12)
        return full

    parameters = _parameters(kernel, rng)
    scale = np.abs(approx_fprime(parameters, loss)).max()
    assert check_grad(loss, gradient, parameters) < 1e-5 * scale


@pytest.mark.parametrize("name", NAMES)
def test_bounds_and_prior_hold_the_defaults(name):
    kernel = KERNELS.find(name)(5)
    bounds, prior = kernel.bounds(), kernel.prior()
    default = kernel.default_parameters()
    assert bounds.shape == (kernel.size, 2)
    assert default.shape == prior.location.shape == prior.scale.shape == (kernel.size,)
    assert ((bounds[:, 0] < default) & (default < bounds[:, 1])).all()


@pytest.mark.parametrize("name", NAMES)
def test_the_penalty_is_that_of_students_t(name):
    prior = KERNELS.find(name)(3).prior()
    rng = np.random.default_rng(6)
    oracle = stats.t(3.0, prior.location, prior.scale)
    most = oracle.logpdf(prior.location).sum()
    for width in (0.1, 1.0, 10.0):
        parameters = prior.location + width * rng.normal(size=len(prior.location))
        value, gradient = prior.penalty(parameters)
        assert value == pytest.approx(most - oracle.logpdf(parameters).sum())
        numeric = approx_fprime(parameters, lambda p: prior.penalty(p)[0], 1e-7)
        np.testing.assert_allclose(gradient, numeric, rtol=1e-4, atol=1e-5)


@pytest.mark.parametrize("name", ["rbf", "matern52", "matern52_full", "rbf_full"])
@pytest.mark.parametrize("d", [1, 6, 20])
def test_random_points_are_as_alike_in_any_number_of_variables(name, d):
    kernel = KERNELS.find(name)(d)
    x = np.random.default_rng(7).uniform(-1.0, 1.0, (200, d))
    scaled = x @ kernel.factor(kernel.default_parameters())
    squares = squared_distances(scaled, scaled)[np.triu_indices(len(x), 1)]
    assert np.mean(squares) == pytest.approx(2.0 / 3.0, rel=0.1)


def test_full_precision_from_a_given_matrix():
    rng = np.random.default_rng(3)
    factor = rng.normal(size=(4, 4))
    precision = factor @ factor.T + 0.1 * np.eye(4)
    kernel = RBFFull(4)
    np.testing.assert_allclose(kernel.precision(kernel.from_precision(precision)), precision)


def test_squared_distances_between_two_sets():
    rng = np.random.default_rng(4)
    a, b = rng.normal(size=(5, 2)), rng.normal(size=(7, 2))
    expected = ((a[:, None] - b[None]) ** 2).sum(axis=-1)
    np.testing.assert_allclose(squared_distances(a, b), expected)


def test_precision_from_the_hessian_of_a_gaussian_peak():
    precision = np.array([[4.0, 1.0], [1.0, 2.0]])
    hessian = -3.0 * precision
    np.testing.assert_allclose(precision_from_hessian(hessian, 3.0), precision)


def test_precision_from_a_flat_or_indefinite_hessian_is_still_positive_definite():
    precision = precision_from_hessian(np.diag([0.0, -1e9, 4.0]), 1.0)
    np.testing.assert_allclose(np.diag(precision), [1e-4, 400.0, 4.0])


@pytest.mark.parametrize(
    ("hessian", "amplitude", "message"),
    [
        (np.ones(3), 1.0, "square"),
        (np.array([[1.0, 2.0], [0.0, 1.0]]), 1.0, "symmetric"),
        (np.full((2, 2), np.nan), 1.0, "finite"),
        (np.eye(2), 0.0, "amplitude"),
    ],
)
def test_precision_from_hessian_refuses(hessian, amplitude, message):
    with pytest.raises(ValueError, match=message):
        precision_from_hessian(hessian, amplitude)


@pytest.mark.parametrize("x", [np.ones(3), np.ones((2, 0)), [[np.nan]], [[np.inf]]])
def test_inputs_refused(x):
    with pytest.raises(ValueError, match="x must"):
        as_inputs(x)
