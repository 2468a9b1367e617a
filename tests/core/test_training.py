import time
import warnings
from typing import Any

import numpy as np
import pytest
from scipy.optimize import approx_fprime
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import RBF, ConstantKernel, Matern, WhiteKernel

from mobo_tuner.core.context_kernel import Contextual
from mobo_tuner.core.gaussian_process_settings import GaussianProcessSettings
from mobo_tuner.core.kernels import KERNELS
from mobo_tuner.core.training import (
    CLEAR_EVIDENCE,
    NegativeLogPosterior,
    Task,
    held_parameters,
    train,
    train_adam,
    train_lbfgs,
    train_optional,
)

NAMES = ["rbf_isotropic", "rbf", "rbf_full", "matern52", "matern52_full"]


def _data(n=12, d=3, seed=0):
    rng = np.random.default_rng(seed)
    x = rng.uniform(-1, 1, (n, d))
    return x, np.sin(2.0 * x[:, 0]) + x[:, 1] ** 2 + 0.01 * rng.normal(size=n), rng


@pytest.mark.parametrize("weak_prior", [True, False])
@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("n", [12, 150])
def test_gradient_by_finite_differences(name, weak_prior, n):
    x, z, rng = _data(n)
    kernel = KERNELS.find(name)(3)
    extra = rng.uniform(0.0, 0.1, len(z))
    objective = NegativeLogPosterior(kernel, x, z, extra, weak_prior)
    for _ in range(3):
        parameters = objective.default_parameters() + 0.5 * rng.normal(size=kernel.size + 2)
        numeric = approx_fprime(parameters, lambda p: objective(p)[0], 1e-6)
        np.testing.assert_allclose(objective(parameters)[1], numeric, rtol=1e-4, atol=1e-5)


@pytest.mark.parametrize("name", ["rbf_isotropic", "rbf", "matern52"])
def test_likelihood_and_gradient_are_those_of_scikit_learn(name):
    x, z, _ = _data()
    kernel = KERNELS.find(name)(3)
    scales = np.array([0.7]) if name == "rbf_isotropic" else np.array([0.7, 1.1, 2.0])
    shape = Matern(scales, nu=2.5) if name == "matern52" else RBF(scales)
    oracle = GaussianProcessRegressor(ConstantKernel(2.0) * shape + WhiteKernel(1e-3), alpha=0.0)
    oracle.optimizer = None
    oracle.fit(x, z)
    theta = np.log(np.concatenate([[2.0], scales, [1e-3]]))
    value, gradient = oracle.log_marginal_likelihood(theta, eval_gradient=True)

    objective = NegativeLogPosterior(kernel, x, z, np.zeros_like(z), weak_prior=False)
    ours, ours_gradient = objective(np.log(np.concatenate([scales, [2.0, 1e-3]])))
    assert -len(z) * ours == pytest.approx(value, rel=1e-6)
    expected = np.concatenate([gradient[1:-1], gradient[[0, -1]]])
    np.testing.assert_allclose(-len(z) * ours_gradient, expected, rtol=1e-5, atol=1e-6)


def test_lbfgs_is_at_least_as_good_as_scikit_learn():
    x, z, _ = _data(25)
    objective = NegativeLogPosterior(KERNELS.find("rbf")(3), x, z, np.zeros_like(z), False)
    bounds = objective.bounds(1e-9)
    free = np.ones(len(bounds), dtype=bool)
    start = objective.default_parameters()
    rng = np.random.default_rng(0)
    starts = start + np.vstack([np.zeros(len(start)), 0.7 * rng.normal(size=(3, len(start)))])
    _, value = train_lbfgs(objective, starts, bounds, free, 1e-8)
    kernel = ConstantKernel(1.0) * RBF(np.full(3, 2.0), (0.05, 100.0)) + WhiteKernel(1e-4)
    oracle = GaussianProcessRegressor(kernel, alpha=0.0, n_restarts_optimizer=2, random_state=0)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # a length-scale at its bound
        oracle.fit(x, z)
    assert -len(z) * value > oracle.log_marginal_likelihood_value_ - 0.01


def test_held_hyperparameters_do_not_move():
    x, z, _ = _data()
    objective = NegativeLogPosterior(KERNELS.find("rbf")(3), x, z, np.zeros_like(z), True)
    start = objective.default_parameters()
    free = np.array([True, False, True, True, False])
    bounds = objective.bounds(1e-9)
    for best in (
        train_lbfgs(objective, start[None], bounds, free, 1e-8)[0],
        train_adam(objective, start, bounds, free, 0.01, 50)[0],
    ):
        np.testing.assert_array_equal(best[~free], start[~free])
        assert (best[free] != start[free]).all()


def test_nothing_free_keeps_the_start():
    x, z, _ = _data()
    objective = NegativeLogPosterior(KERNELS.find("rbf")(3), x, z, np.zeros_like(z), True)
    start = objective.default_parameters()
    best, value = train_lbfgs(
        objective, start[None], objective.bounds(1e-9), np.zeros(5, dtype=bool), 1e-8
    )
    np.testing.assert_array_equal(best, start)
    assert value == objective(start)[0]


def test_adam_reaches_what_lbfgs_reaches():
    x, z, _ = _data(20)
    objective = NegativeLogPosterior(KERNELS.find("matern52")(3), x, z, np.zeros_like(z), True)
    bounds, free = objective.bounds(1e-9), np.ones(5, dtype=bool)
    start = objective.default_parameters()
    _, reached = train_adam(objective, start, bounds, free, 0.02, 1500)
    _, best = train_lbfgs(objective, start[None], bounds, free, 1e-8)
    assert len(z) * (reached - best) < 0.02


def test_adam_agrees_with_a_plain_implementation_by_torch():
    """The likelihood by automatic differentiation, and torch's Adam with the paper's rate."""
    torch = pytest.importorskip("torch")
    x, z, _ = _data(20)
    objective = NegativeLogPosterior(KERNELS.find("rbf")(3), x, z, np.zeros_like(z), False)
    start, steps = objective.default_parameters(), 200
    inputs, outputs = torch.from_numpy(x), torch.from_numpy(z)
    parameters = torch.from_numpy(start.copy()).requires_grad_()
    adam = torch.optim.Adam([parameters], lr=1e-3)
    for _ in range(steps):
        adam.zero_grad()
        scaled = inputs / parameters[:3].exp()
        squared = (scaled[:, None] - scaled[None]).square().sum(dim=2)
        noise = parameters[4].exp() + 1e-10 * parameters[3].exp()
        covariance = parameters[3].exp() * (-0.5 * squared).exp() + noise * torch.eye(len(z))
        normal = torch.distributions.MultivariateNormal(torch.zeros_like(outputs), covariance)
        (-normal.log_prob(outputs) / len(z)).backward()
        adam.step()
    free = np.ones(len(start), dtype=bool)
    ours, _ = train_adam(objective, start, objective.bounds(1e-9), free, 1e-3, steps)
    assert np.abs(ours - start).min() > 0.01
    np.testing.assert_allclose(ours, parameters.detach().numpy(), atol=1e-7)


def test_adam_first_steps_have_the_length_of_the_rate():
    x, z, _ = _data()
    objective = NegativeLogPosterior(KERNELS.find("rbf")(3), x, z, np.zeros_like(z), True)
    start = objective.default_parameters()
    moved, _ = train_adam(objective, start, objective.bounds(1e-9), np.ones(5, bool), 1e-3, 1)
    np.testing.assert_allclose(np.abs(moved - start), 1e-3, rtol=1e-3)


def test_held_parameters_of_the_settings():
    settings = GaussianProcessSettings(kernel="rbf", length_scales=0.5, variance=8.0, noise=0.1)
    held, free = held_parameters(settings, KERNELS.find("rbf")(2), scale=2.0)
    assert not free.any()
    np.testing.assert_allclose(np.exp(held), [0.5, 0.5, 2.0, 1e-9])

    settings = GaussianProcessSettings(kernel="rbf_full", length_scales=(0.5, 2.0))
    kernel: Any = KERNELS.find("rbf_full")(2)
    held, free = held_parameters(settings, kernel, scale=1.0)
    np.testing.assert_allclose(kernel.precision(held[:-2]), np.diag([4.0, 0.25]), atol=1e-12)
    assert free.tolist() == [False] * 5 + [True] * 2


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        (GaussianProcessSettings(length_scales=(1.0, 2.0)), "length_scales must be one number"),
        (
            GaussianProcessSettings(kernel="rbf_full", precision=(1.0, 0.0, 0.0, 1.0)),
            "precision must be a 3 by 3",
        ),
    ],
)
def test_held_shape_of_another_dimension_is_refused(settings, message):
    with pytest.raises(ValueError, match=message):
        held_parameters(settings, KERNELS.find(settings.kernel)(3), 1.0)


def test_one_observation_teaches_nothing():
    settings = GaussianProcessSettings()
    kernel = KERNELS.find("matern52")(2)
    x, z = np.zeros((1, 2)), np.ones(1)
    task = Task(settings, kernel, 1.0, x, z, 0.0 * z)
    parameters = train(task, None, np.random.default_rng(0), 2)
    np.testing.assert_allclose(np.exp(parameters), [np.sqrt(2.0), np.sqrt(2.0), 1.0, 1e-4])


@pytest.mark.parametrize("n", [40, 160])
@pytest.mark.parametrize("together", [True, False])
def test_variables_that_act_together_are_found_and_others_are_left_alone(n, together):
    rng = np.random.default_rng(1)
    x = rng.uniform(-1, 1, (n, 3))
    a, b, c = x.T
    z = np.sin(3.0 * (a - b)) + 0.3 * c if together else np.sin(3.0 * a) + np.cos(2.0 * b) + 0.3 * c
    settings, kernel = GaussianProcessSettings(), KERNELS.find("matern52_full")(3)
    task = Task(settings, kernel, 1.0, x, z, 0.0 * z)
    plain = train(task, None, rng, 1)
    assert not plain[3:6].any()
    found = train_optional(task, plain, None)
    if not together:
        assert found is plain
        return
    factor = kernel.factor(found[:-2])
    precision = factor @ factor.T
    assert precision[0, 1] < -0.6 * np.sqrt(precision[0, 0] * precision[1, 1])
    objective = NegativeLogPosterior(kernel, x, z, 0.0 * z, weak_prior=True)
    assert n * (objective(plain)[0] - objective(found)[0]) > CLEAR_EVIDENCE
    again = train_optional(task, plain, found)
    np.testing.assert_allclose(again[3:6], found[3:6], atol=0.1)
    assert train_optional(task, plain, None, deadline=0.0) is plain


def test_variables_that_act_together_elsewhere_only_do_not_count() -> None:
    rng = np.random.default_rng(1)
    x = np.column_stack([rng.uniform(-1, 1, (60, 2)), rng.random(60) < 0.75])
    a, b, cheap = x.T
    z = np.where(cheap, np.sin(3.0 * (a - b)), np.sin(3.0 * a) + np.cos(2.0 * b))
    kernel = Contextual(KERNELS.find("matern52_full")(2), 1)
    task = Task(GaussianProcessSettings(), kernel, 1.0, x, z, 0.0 * z)
    plain = train(task, None, rng, 1)
    assert train_optional(task, plain, None) is not plain
    assert train_optional(task._replace(decisive=cheap == 0.0), plain, None) is plain
    assert train_optional(task._replace(decisive=cheap == 1.0), plain, None) is not plain


def test_many_variables_do_not_seem_to_act_together() -> None:
    rng = np.random.default_rng(1)
    x = rng.uniform(-1, 1, (60, 20))
    z = np.linalg.norm(x - 0.5, axis=1)
    z -= z.mean()
    kernel = KERNELS.find("matern52_full")(20)
    task = Task(GaussianProcessSettings(), kernel, 1.0, x, z, 0.0 * z)
    plain = train(task, None, rng, 1)
    assert train_optional(task, plain, None) is plain


def test_a_training_stops_at_its_deadline_with_the_best_so_far() -> None:
    calls: list[float] = []

    def bowl(parameters: np.ndarray) -> tuple[float, np.ndarray]:
        calls.append(float(parameters @ parameters))
        time.sleep(0.01)  # an evaluation takes time, which is what runs out
        return calls[-1], 2.0 * parameters * np.array([1.0, 1.3, 0.2])

    start = np.array([[3.0, -2.0, 1.0]])
    bounds = np.array([[-5.0, 5.0]] * 3)
    free = np.ones(3, dtype=np.bool_)
    best, value = train_lbfgs(bowl, start, bounds, free, 1e-12, deadline=time.monotonic() + 0.035)
    assert len(calls) <= 5
    assert value == pytest.approx(min(calls))
    assert value == pytest.approx(float(best @ best))
    best, value = train_lbfgs(bowl, start, bounds, free, 1e-12, deadline=time.monotonic() - 1.0)
    assert best.tolist() == start[0].tolist()
