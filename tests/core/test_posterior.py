import numpy as np
import pytest

from mobo_tuner.core.kernels import KERNELS
from mobo_tuner.core.posterior import Posterior


def _posterior(n, noise, length_scale):
    x = np.linspace(-1, 1, n)[:, None]
    shape = np.array([np.log(length_scale)])
    return Posterior(
        KERNELS.find("rbf")(1), shape, 4.0, x, np.sin(3.0 * x[:, 0]), np.full(n, noise)
    )


def test_prediction_is_that_of_the_equations():
    posterior = _posterior(8, 0.1, 0.5)
    x, new = posterior.x[:, 0], np.array([0.13, 2.0])

    def kernel(a, b):
        return 4.0 * np.exp(-0.5 * ((a[:, None] - b) / 0.5) ** 2)

    inverse = np.linalg.inv(kernel(x, x) + (0.1 + 4e-10) * np.eye(8))
    mean, stddev = posterior.predict(new[:, None])
    np.testing.assert_allclose(mean, kernel(new, x) @ inverse @ posterior.z, rtol=1e-9)
    variance = 4.0 - np.einsum("mi,ij,mj->m", kernel(new, x), inverse, kernel(new, x))
    np.testing.assert_allclose(stddev, np.sqrt(variance), rtol=1e-9)


def test_add_extends_the_factor():
    posterior = _posterior(8, 0.1, 0.5)
    posterior.add(np.array([[0.3]]), np.array([1.0]), np.array([0.2]))
    assert posterior.factorised == 8
    whole = Posterior(
        posterior.kernel, posterior.shape, 4.0, posterior.x, posterior.z, posterior.noise
    )
    assert whole.factorised == 9
    np.testing.assert_allclose(posterior.inverse, whole.inverse, atol=1e-12)
    np.testing.assert_allclose(posterior.weights, whole.weights, atol=1e-12)
    np.testing.assert_allclose(posterior.leave_one_out(), whole.leave_one_out())


def test_row_lost_to_rounding_makes_a_new_factorisation():
    posterior = _posterior(200, 0.0, 20.0)
    # As if rounding had been unlucky: a row that explains more than all of the variance.
    posterior.inverse *= 1.01
    posterior.add(np.array([[0.3]]), np.array([0.0]), np.array([0.0]))
    assert posterior.factorised == 201
    mean, stddev = posterior.predict(np.array([[0.3], [5.0]]))
    assert np.isfinite(mean).all()
    assert (stddev > 0.0).all()


@pytest.mark.parametrize("m", [0, 1, 127, 128, 129, 300])
def test_many_candidates_are_predicted_as_one_by_one(m):
    posterior = _posterior(20, 0.01, 0.5)
    new = np.random.default_rng(0).uniform(-1, 1, (m, 1))
    mean, stddev, gradients = posterior.predict_with_gradient(new)
    np.testing.assert_allclose(posterior.predict(new), [mean, stddev], rtol=1e-9)
    for i in range(0, m, 41):
        one = posterior.predict_with_gradient(new[i : i + 1])
        np.testing.assert_allclose([one[0][0], one[1][0]], [mean[i], stddev[i]], rtol=1e-9)
        np.testing.assert_allclose(one[2].mean[0], gradients.mean[i], rtol=1e-8)
        np.testing.assert_allclose(one[2].stddev[0], gradients.stddev[i], rtol=1e-8)


def test_a_draw_is_known_at_the_observations_and_draws_are_those_of_the_posterior():
    posterior = _posterior(8, 0.5, 0.5)
    normals = np.random.default_rng(0).standard_normal((4000, 8))
    drawn = posterior.drawn(normals)
    assert len(drawn) == 4000
    values, stddev = drawn[0].predict(posterior.x)
    np.testing.assert_allclose(values, drawn[0].z, atol=0.01)
    assert (stddev < 0.01).all()
    # Far from and between the observations: the law of total expectation and variance.
    new = np.array([[0.13], [1.5]])
    mean, stddev = posterior.predict(new)
    means, stddevs = np.array([each.predict(new) for each in drawn]).transpose(1, 0, 2)
    np.testing.assert_allclose(means.mean(axis=0), mean, atol=0.05)
    np.testing.assert_allclose(np.hypot(means.std(axis=0), stddevs[0]), stddev, rtol=0.05)
    assert (stddevs == stddevs[0]).all()
    np.testing.assert_array_equal(posterior.predict(new)[0], mean)  # it stays as it is
