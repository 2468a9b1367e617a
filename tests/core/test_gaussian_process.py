"""The Gaussian process against scikit-learn, finite differences and its own definition."""

import json

import numpy as np
import pytest
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import RBF, ConstantKernel, Matern

from mobo_tuner.core.gaussian_process import GaussianProcess, GaussianProcessSettings
from tests.core.gaussian_process_data import KERNELS, sample, smooth


def _assert_gradients(model, x, rtol=1e-4):
    prediction = model.predict_with_gradient(x)
    mean, stddev = model.predict(x)
    np.testing.assert_allclose(prediction.mean, mean, rtol=1e-9)
    np.testing.assert_allclose(prediction.stddev, stddev, rtol=1e-5)
    h = 1e-5
    for a in range(x.shape[1]):
        step = h * np.eye(x.shape[1])[a]
        above, below = model.predict(x + step), model.predict(x - step)
        for gradient, high, low in zip(prediction[2:], above, below, strict=True):
            numeric = (high - low) / (2.0 * h)
            atol = rtol * np.abs(numeric).max() + 1e-12 * np.abs(mean).max()
            np.testing.assert_allclose(gradient[:, a], numeric, rtol=rtol, atol=atol)


@pytest.mark.parametrize("name", ["rbf_isotropic", "rbf", "matern52"])
def test_posterior_and_likelihood_are_those_of_scikit_learn(name):
    x, y, new = sample()
    scales = 0.8 if name == "rbf_isotropic" else (0.8, 1.5, 3.0)
    stddev = np.linspace(0.1, 0.5, len(y))
    choice = GaussianProcessSettings(
        kernel=name, mean=38.0, length_scales=scales, variance=30.0, noise=0.2
    )
    model = GaussianProcess(choice).fit(x, y, stddev)
    # What our model adds to the diagonal: least noise, and 1e-10 of the signal variance.
    alpha = stddev**2 + 0.2**2 + 1e-9 * y.var() + 1e-10 * 30.0
    shape = Matern(scales, nu=2.5) if name == "matern52" else RBF(scales)
    oracle = GaussianProcessRegressor(ConstantKernel(30.0) * shape, alpha=alpha, optimizer=None)
    oracle.fit(x, y - 38.0)
    mean, stddev = model.predict(new)
    expected_mean, expected_stddev = oracle.predict(new, return_std=True)
    np.testing.assert_allclose(mean, 38.0 + expected_mean, rtol=1e-9)
    np.testing.assert_allclose(stddev, expected_stddev, rtol=1e-7)
    expected = oracle.log_marginal_likelihood()
    assert model.log_marginal_likelihood == pytest.approx(expected, rel=1e-8)
    assert model.variance == pytest.approx(30.0)
    np.testing.assert_allclose(1.0 / np.sqrt(np.diag(model.precision)), np.full(3, scales))


def test_full_precision_matrix_is_a_rotated_anisotropic_kernel():
    x, y, new = sample(d=2)
    turn = np.array([[np.cos(0.5), -np.sin(0.5)], [np.sin(0.5), np.cos(0.5)]])
    precision = turn @ np.diag([4.0, 0.5]) @ turn.T
    full = GaussianProcess(
        GaussianProcessSettings(
            kernel="rbf_full", precision=tuple(precision.ravel().tolist()), variance=20.0, noise=0.1
        )
    ).fit(x, y)
    plain = GaussianProcess(
        GaussianProcessSettings(
            kernel="rbf", length_scales=(0.5, 0.5**-0.5), variance=20.0, noise=0.1
        )
    ).fit(x @ turn, y)
    np.testing.assert_allclose(full.precision, precision)
    for got, expected in zip(full.predict(new), plain.predict(new @ turn), strict=True):
        np.testing.assert_allclose(got, expected, rtol=1e-7)


def test_toy_problem_with_the_hyperparameters_of_the_paper():
    # lambda = 1 on [-2, 2] is 0.5 on [-1, 1].
    choice = GaussianProcessSettings(
        kernel="rbf_isotropic", mean="reference", length_scales=0.5, variance=0.5, noise=0.0
    )
    rng = np.random.default_rng(0)
    x = rng.uniform(-1, 1, (20, 2))
    y = np.linalg.norm(2.0 * x - 1.0, axis=1)
    model = GaussianProcess(choice, reference=4.3).fit(x, y)
    far, spread = model.predict([[40.0, 40.0]])
    np.testing.assert_allclose([far[0], spread[0]], [4.3, np.sqrt(0.5)])
    np.testing.assert_allclose(model.predict(x)[0], y, atol=1e-4)


@pytest.mark.parametrize("name", KERNELS)
@pytest.mark.parametrize("m", [1, 7, 200])
def test_gradients_of_predictions(name, m):
    x, y, _ = sample(noise=0.1)
    new = np.random.default_rng(1).uniform(-1, 1, (m, 3))
    _assert_gradients(GaussianProcess(GaussianProcessSettings(kernel=name)).fit(x, y), new)


def test_gradients_of_predictions_of_a_logarithm():
    x, y, new = sample()
    model = GaussianProcess(GaussianProcessSettings(transform="log")).fit(x, np.exp(y / 10.0))
    assert model.model == "data log"
    _assert_gradients(model, new)
    _assert_gradients(model, x[:2] + 1e-3, rtol=1e-2)


@pytest.mark.parametrize("with_gradient", [True, False])
def test_gradients_of_predictions_with_a_mean_function(with_gradient):
    def slope(x):
        return np.column_stack([14.0 * np.cos(2.0 * x[:, 0]), 0.0 * x[:, 1], 0.0 * x[:, 2]])

    def prior(x):
        return 38.0 + 7.0 * np.sin(2.0 * x[:, 0])

    x, y, new = sample()
    gradient = slope if with_gradient else None
    model = GaussianProcess(mean=prior, mean_gradient=gradient).fit(x, y)
    assert model.model == "function"
    _assert_gradients(model, new)
    far, _ = model.predict(1e4 * np.ones((1, 3)))
    offset = np.mean(y - prior(x))
    np.testing.assert_allclose(far, prior(1e4 * np.ones((1, 3))) + offset)


@pytest.mark.parametrize("name", KERNELS)
def test_learns_a_smooth_function(name):
    x, y, new = sample(60)
    mean, stddev = GaussianProcess(GaussianProcessSettings(kernel=name)).fit(x, y).predict(new)
    error = np.abs(mean - smooth(new))
    tolerance = 1.5 if name == "rbf_isotropic" else 0.2
    assert error.max() < tolerance
    assert (error < 6.0 * stddev + 1e-6).all()


def test_learns_the_noise():
    x, y, _ = sample(150, noise=0.5)
    assert GaussianProcess().fit(x, y).noise == pytest.approx(0.5, rel=0.25)
    x, y, _ = sample(60)
    assert GaussianProcess(GaussianProcessSettings(kernel="rbf")).fit(x, y).noise < 1e-2


def test_measured_standard_deviations_weigh_the_observations():
    x = np.zeros((2, 1))
    choice = GaussianProcessSettings(length_scales=1.0, variance=100.0, noise=0.0)
    model = GaussianProcess(choice).fit(x, [0.0, 3.0], [1.0, 2.0])
    mean, stddev = model.predict([[0.0]])
    precision = 1.0 + 0.25
    prior = 0.01
    assert mean[0] == pytest.approx((3.0 * 0.25 + 1.5 * prior) / (precision + prior), rel=1e-6)
    assert stddev[0] == pytest.approx((precision + prior) ** -0.5, rel=1e-6)


def test_unknown_standard_deviation_is_none_at_all():
    x, y, new = sample()
    known = GaussianProcess().fit(x, y, np.full(len(y), np.nan))
    np.testing.assert_array_equal(known.predict(new), GaussianProcess().fit(x, y).predict(new))


@pytest.mark.parametrize("name", KERNELS)
@pytest.mark.parametrize("noise", ["learned", 0.0])
def test_add_gives_the_numbers_of_a_rebuild(name, noise):
    x, y, new = sample(30)
    stddev = np.where(np.arange(30) % 3, 0.05, np.nan)
    choice = GaussianProcessSettings(kernel=name, noise=noise)
    added = GaussianProcess(choice).fit(x[:12], y[:12], stddev[:12])
    rebuilt = GaussianProcess.from_state(added.get_state(), x[:12], y[:12], stddev[:12])
    at_once = added.copy().add_all(x[12:], y[12:], stddev[12:])
    for i in range(12, 30):
        added.add(x[i], y[i], stddev[i])
    rebuilt.condition(x, y, stddev)
    expected = rebuilt.predict_with_gradient(new)
    for model in (added, at_once):
        assert model.n == rebuilt.n == 30
        for a, b in zip(model.predict_with_gradient(new), expected, strict=True):
            np.testing.assert_allclose(a, b, rtol=1e-4, atol=1e-5 * np.abs(b).max())
        likelihood = pytest.approx(rebuilt.log_marginal_likelihood, rel=1e-5)
        assert model.log_marginal_likelihood == likelihood


def test_add_of_duplicates():
    x, y, new = sample(10)
    model = GaussianProcess(GaussianProcessSettings(noise=0.0, minimum_noise=1e-14)).fit(x, y)
    at_once = model.copy().add_all(x[[3] * 30], y[[3] * 30])
    for _ in range(30):
        model.add(x[3], y[3])
    np.testing.assert_allclose(at_once.predict(new)[0], model.predict(new)[0], rtol=1e-3)
    assert np.isfinite(model.predict_with_gradient(new)[2]).all()
    np.testing.assert_allclose(model.predict(x[3:4])[0], y[3], rtol=1e-6)


def test_add_of_what_has_no_logarithm_fits_anew():
    x, y, new = sample()
    model = GaussianProcess(GaussianProcessSettings(transform="log")).fit(x, y)
    model.add(new[0], -3.0)
    assert model.model == "data"
    assert model.n == len(y) + 1
    model = GaussianProcess(GaussianProcessSettings(transform="log")).fit(x, y).condition(x, -y)
    assert model.model == "data"


def test_leave_one_out_leaves_one_out():
    x, y, _ = sample(12, noise=0.3)
    model = GaussianProcess().fit(x, y)
    left = model.leave_one_out()
    np.testing.assert_allclose(left.residual, y - left.mean)
    state = model.get_state()
    for i in range(len(y)):
        others = np.arange(len(y)) != i
        model = GaussianProcess.from_state(state, x, y).condition(x[others], y[others])
        mean, stddev = model.predict(x[i : i + 1])
        spread = np.hypot(stddev[0], model.noise)
        assert left.mean[i] == pytest.approx(mean[0], rel=1e-6)
        assert left.stddev[i] == pytest.approx(spread, rel=1e-6)
        density = -0.5 * ((y[i] - mean[0]) / spread) ** 2 - np.log(spread * np.sqrt(2.0 * np.pi))
        assert left.log_density[i] == pytest.approx(density, rel=1e-5)


def test_mean_far_away_is_the_prior_mean():
    x, y, _ = sample(8)
    far = 1e6 * np.ones((1, 3))
    for mean, expected in (("data", y.mean()), ("reference", 70.0), (12.5, 12.5)):
        model = GaussianProcess(GaussianProcessSettings(mean=mean), reference=70.0).fit(x, y)
        assert model.predict(far)[0][0] == pytest.approx(expected)


def test_automatic_mean_takes_what_predicts_better():
    rng = np.random.default_rng(2)
    x = rng.uniform(-1, 1, (25, 2))
    # A dip in a plain at the reference point.
    y = 10.0 - 8.0 * np.exp(-8.0 * ((x - 0.3) ** 2).sum(axis=1))
    choice = GaussianProcessSettings(mean="auto")
    model = GaussianProcess(choice, reference=10.0).fit(x, y)
    assert model.model == "reference"
    assert GaussianProcess(choice, reference=500.0).fit(x, y).model == "data"
    assert GaussianProcess(choice).fit(x, y).model == "data"


def test_in_noise_the_reference_point_is_not_the_mean_if_it_is_a_little_better():
    rng = np.random.default_rng(0)
    x = rng.uniform(-1, 1, (24, 2))
    y = np.hypot(x[:, 0], x[:, 1] - 0.3)
    model = GaussianProcess(reference=float(y.max()))
    assert model.fit(x, y).model == "reference"
    assert model.untrained().fit(x, y, noisy=True).model == "data"
    assert model.untrained().fit(x, y, np.full(24, 0.15)).model == "data"


def test_automatic_transform_takes_the_logarithm_where_it_is_clearly_better():
    rng = np.random.default_rng(0)
    x = rng.uniform(-1, 1, (30, 2))
    choice = GaussianProcessSettings(transform="auto")
    assert GaussianProcess(choice).fit(x, np.exp(4.0 * x[:, 0] + np.sin(3 * x[:, 1]))).model == (
        "data log"
    )
    assert GaussianProcess(choice).fit(x, 5.0 + x[:, 0] + np.sin(3 * x[:, 1])).model == "data"
    assert GaussianProcess(choice).fit(x, x[:, 0]).model == "data"
    negative = GaussianProcessSettings(transform="log", mean="reference")
    assert GaussianProcess(negative, reference=-1.0).fit(x, 1.0 + x[:, 0] ** 2).model == "reference"


def test_adam_trains():
    x, y, new = sample(30)
    choice = GaussianProcessSettings(
        kernel="rbf", training="adam", adam_rate=0.02, adam_steps=300, adam_retraining_steps=20
    )
    model = GaussianProcess(choice).fit(x, y)
    np.testing.assert_allclose(model.predict(new)[0], smooth(new), atol=1.0)
    before = model.precision
    model.fit(x, y)
    assert 0.0 < np.abs(np.log(np.diag(model.precision) / np.diag(before))).max() < 2.0


def test_state_through_json_gives_bitwise_the_same_numbers():
    x, y, new = sample(25)
    choice = GaussianProcessSettings(mean="auto", transform="auto", kernel="rbf_full")
    model = GaussianProcess(choice, reference=60.0).fit(x[:15], y[:15])
    for i in range(15, 20):
        model.add(x[i], y[i])
    state = json.loads(json.dumps(model.get_state()))
    restored = GaussianProcess.from_state(state, x[:20], y[:20])
    for i in range(20, 25):
        model.add(x[i], y[i])
        restored.add(x[i], y[i])
    assert restored.model == model.model
    for got, expected in zip(
        restored.predict_with_gradient(new), model.predict_with_gradient(new), strict=True
    ):
        np.testing.assert_array_equal(got, expected)
    for each in (model, restored):
        each.fit(x, y, rng=np.random.default_rng(7))
    np.testing.assert_array_equal(restored.predict(new), model.predict(new))
    assert restored.get_state() == model.get_state()


def test_state_before_the_first_fit():
    model = GaussianProcess(GaussianProcessSettings(mean="reference"), reference=3.0)
    restored = GaussianProcess.from_state(json.loads(json.dumps(model.get_state())))
    assert restored.n == 0
    assert restored.reference == 3.0


def test_state_with_a_mean_function_needs_it_again():
    x, y, new = sample()
    model = GaussianProcess(mean=smooth).fit(x, y + x[:, 2])
    state = json.loads(json.dumps(model.get_state()))
    restored = GaussianProcess.from_state(state, x, y + x[:, 2], mean=smooth)
    np.testing.assert_array_equal(restored.predict(new), model.predict(new))
    with pytest.raises(ValueError, match="mean must be given"):
        GaussianProcess.from_state(state, x, y)
    with pytest.raises(ValueError, match="mean must be given"):
        GaussianProcess.from_state(GaussianProcess().get_state(), mean=smooth)
    with pytest.raises(ValueError, match="mean_gradient needs a mean"):
        GaussianProcess(mean_gradient=smooth)


def test_state_refuses_too_few_observations():
    x, y, _ = sample()
    state = GaussianProcess().fit(x, y).get_state()
    with pytest.raises(ValueError, match="15 observations"):
        GaussianProcess.from_state(state, x[:10], y[:10])


@pytest.mark.parametrize("seed", range(4))
def test_few_observations_in_many_variables_call_none_of_them_irrelevant(seed):
    rng = np.random.default_rng(seed)
    x, centre = rng.uniform(-1.0, 1.0, (24, 20)), rng.uniform(-0.5, 0.5, 20)
    model = GaussianProcess().fit(x, np.linalg.norm(x - centre, axis=1))
    length_scales = 1.0 / np.sqrt(np.diagonal(model.precision))
    # All variables matter alike. A normal prior of standard deviation sqrt(3) gives 18 to 71 here.
    assert length_scales.max() < 12.0 * length_scales.min()


@pytest.mark.parametrize("seed", range(2))
def test_enough_observations_find_the_few_variables_that_matter(seed):
    rng = np.random.default_rng(seed)
    x, centre = rng.uniform(-1.0, 1.0, (60, 20)), rng.uniform(-0.5, 0.5, 3)
    matter = rng.permutation(20)[:3]
    model = GaussianProcess().fit(x, np.linalg.norm(x[:, matter] - centre, axis=1))
    length_scales = 1.0 / np.sqrt(np.diagonal(model.precision))
    others = np.delete(length_scales, matter)
    assert others.min() > 3.0 * length_scales[matter].max()
