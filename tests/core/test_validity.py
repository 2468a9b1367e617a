"""The validity model against numerical integration, finite differences and a failing half."""

import json

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import trapezoid
from scipy.optimize import approx_fprime
from scipy.stats import norm
from sklearn.gaussian_process import GaussianProcessClassifier
from sklearn.gaussian_process.kernels import ConstantKernel, Matern

from mobo_tuner.core.gaussian_process import GaussianProcess
from mobo_tuner.core.hypervolume import BoxDecomposition
from mobo_tuner.core.kernels import Matern52
from mobo_tuner.core.validity import (
    ValidityModel,
    _LaplaceLikelihood,
    _LaplacePosterior,
    _log_evidence_of_bursts,
)


def _data(n=25, d=2, seed=0):
    rng = np.random.default_rng(seed)
    x = rng.uniform(-1, 1, (n, d))
    valid = x[:, 0] < 0.2
    valid[:2] = ~valid[:2]
    return x, valid, rng


@pytest.mark.parametrize("n_failed", [0, 1, 10, 25])
def test_gradient_of_the_evidence_by_finite_differences(n_failed):
    x, _, rng = _data()
    likelihood = _LaplaceLikelihood(Matern52(2), x, np.arange(25) >= n_failed)
    for _ in range(3):
        parameters = likelihood.prior_mean + 0.5 * rng.normal(size=3)
        numeric = approx_fprime(parameters, lambda p: likelihood(p)[0], 1e-6)
        np.testing.assert_allclose(likelihood(parameters)[1], numeric, rtol=1e-3, atol=1e-3)


def test_evidence_and_mode_of_one_evaluation_by_integration():
    x, valid = np.zeros((1, 1)), np.array([False])
    parameters = np.array([0.0, np.log(2.0)])
    posterior = _LaplacePosterior(Matern52(1), parameters, x, valid)
    f = np.linspace(-12, 12, 4001)
    density = norm.pdf(f, posterior.offset, np.sqrt(2.0)) * norm.cdf(-f)
    evidence = trapezoid(density, f)
    likelihood = _LaplaceLikelihood(Matern52(1), x, valid)
    deviation = (parameters - likelihood.prior_mean) / likelihood._prior_stddev
    value = likelihood(parameters)[0] - 0.5 * deviation @ deviation
    # Laplace's approximation itself is good to a few percent here.
    assert -value == pytest.approx(np.log(evidence), abs=0.05)
    mode = f[density.argmax()]
    assert posterior.offset + posterior.predict(x)[0][0] == pytest.approx(mode, abs=0.01)


def test_agrees_with_scikit_learn_on_what_is_likely():
    x, valid, rng = _data(60)
    new = rng.uniform(-1, 1, (200, 2))
    ours = ValidityModel().fit(x, valid)
    assert ours._parameters is not None
    shape = ConstantKernel(float(np.exp(ours._parameters[-1]))) * Matern(
        np.exp(ours._parameters[:-1]), nu=2.5
    )
    # Its likelihood is the logistic function, near the Gaussian one stretched by 1.6.
    oracle = GaussianProcessClassifier(2.7 * shape, optimizer=None).fit(x, valid)
    expected = oracle.predict_proba(new)[:, 1]
    got = np.exp(ours.predict_log_probability(new))
    assert np.abs(got - expected).max() < 0.2
    assert ((got > 0.5) == (expected > 0.5)).mean() > 0.95


@pytest.mark.parametrize("m", [1, 6])
def test_gradients_of_predictions(m):
    x, valid, rng = _data()
    model = ValidityModel().fit(x, valid)
    new = rng.uniform(-1, 1, (m, 2))
    for value, with_gradient in (
        (model.predict_log_probability, model.predict_log_probability_with_gradient),
        (model.log_weight, model.log_weight_with_gradient),
    ):
        got, gradient = with_gradient(new)
        np.testing.assert_allclose(got, value(new), rtol=1e-10)
        for point, row in zip(new, gradient, strict=True):
            numeric = approx_fprime(point, lambda p, value=value: value(p[None])[0], 1e-7)
            np.testing.assert_allclose(row, numeric, rtol=1e-3, atol=1e-4)


def test_nothing_failed():
    x, _, _ = _data()
    model = ValidityModel().fit(x, np.ones(25, dtype=bool))
    for log_probability, gradient in (
        model.predict_log_probability_with_gradient(x),
        model.log_weight_with_gradient(x),
    ):
        assert (log_probability == 0.0).all()
        assert (gradient == 0.0).all()
        assert gradient.shape == x.shape
    assert (model.predict_log_probability(x) == 0.0).all()


@pytest.mark.parametrize("n", [1, 2, 10, 100])
def test_all_failed_drives_away_from_the_failures(n):
    x, _, _ = _data(n)
    x *= 0.3
    model = ValidityModel().fit(x, np.zeros(n, dtype=bool))
    there = model.predict_log_probability(x)
    away = model.predict_log_probability(3.0 * np.array([[1.0, 1.0], [-1.0, 1.0]]))
    assert np.isfinite(there).all()
    assert (there < np.log(0.5)).all()
    assert away.min() > there.max()
    assert (model.log_weight(x) < model.log_weight([[3.0, 3.0]])).all()


def test_one_failure_among_many_is_local():
    x, _, _ = _data(60)
    valid = np.ones(60, dtype=bool)
    valid[7] = False
    model = ValidityModel().fit(x, valid)
    probability = np.exp(model.predict_log_probability(x))
    distance = np.linalg.norm(x - x[7], axis=1)
    assert probability[distance < 0.3].mean() < probability[distance > 1.0].mean() - 0.01
    assert np.median(probability) > 0.9


def test_failures_all_over_the_place_leave_the_weight_nearly_alone():
    rng = np.random.default_rng(3)
    x = rng.uniform(-1, 1, (80, 2))
    model = ValidityModel().fit(x, rng.random(80) > 0.3)
    weight = model.log_weight(rng.uniform(-1, 1, (200, 2)))
    assert weight.max() - np.median(weight) < 1.0


def test_weight_hardly_changes_a_high_probability_and_extinguishes_a_low_one():
    x, valid, _ = _data(60)
    valid[:2] = ~valid[:2]
    model = ValidityModel().fit(x, valid)
    inside, outside = np.array([[-0.7, 0.0]]), np.array([[0.9, 0.0]])
    probability = model.predict_log_probability(np.vstack([inside, outside]))
    weight = model.log_weight(np.vstack([inside, outside]))
    assert weight[0] == pytest.approx(probability[0], abs=1.0)
    assert probability[1] < np.log(0.2)
    assert weight[1] < np.log(1e-6)


def test_training_waits_for_a_tenth_more_evaluations():
    x, valid, _ = _data(25)
    model = ValidityModel().fit(x[:20], valid[:20])
    first = model.get_state()
    assert model.fit(x[:21], valid[:21]).get_state() == first
    assert model.fit(x[:22], valid[:22]).get_state()["trained"] == 22


@pytest.mark.parametrize("failures", [True, False])
def test_state_through_json_gives_bitwise_the_same_numbers(failures):
    x, valid, rng = _data()
    valid |= not failures
    new = rng.uniform(-1, 1, (6, 2))
    model = ValidityModel().fit(x[:20], valid[:20]).fit(x[:21], valid[:21])
    state = json.loads(json.dumps(model.get_state()))
    restored = ValidityModel.from_state(state, x[:21], valid[:21])
    for _ in range(2):
        for got, expected in zip(
            restored.log_weight_with_gradient(new), model.log_weight_with_gradient(new), strict=True
        ):
            np.testing.assert_array_equal(got, expected)
        restored.fit(x, valid)
        model.fit(x, valid)
    assert restored.get_state() == model.get_state()


def test_state_refuses_other_evaluations():
    x, valid, _ = _data()
    assert ValidityModel.from_state(ValidityModel().get_state())._posterior is None
    state = ValidityModel().fit(x, np.ones(25, dtype=bool)).get_state()
    with pytest.raises(ValueError, match="valid must be all true"):
        ValidityModel.from_state(state, x, valid)


@settings(max_examples=30, deadline=None, derandomize=True)
@given(
    n=st.integers(1, 15),
    d=st.sampled_from([1, 2, 20]),
    seed=st.integers(0, 1000),
    share=st.sampled_from([0.0, 0.2, 0.5, 1.0]),
    digits=st.sampled_from([0, 1, 8]),
)
def test_any_outcomes_give_finite_answers(n, d, seed, share, digits):
    rng = np.random.default_rng(seed)
    # Rounding makes duplicates, of which some fail and some do not.
    x = np.round(rng.uniform(-1, 1, (n, d)), digits)
    model = ValidityModel().fit(x, rng.random(n) < share)
    for part in model.log_weight_with_gradient(np.vstack([x, -x, 1e3 * x])):
        assert np.isfinite(part).all()
    assert (model.predict_log_probability(x) <= 0.0).all()


@pytest.mark.parametrize(
    ("x", "valid", "message"),
    [
        ([[np.nan]], [True], "x must be finite"),
        ([[0.0]], [True, False], "valid must be a boolean"),
        ([[0.0]], [1.0], "valid must be a boolean"),
        (np.empty((0, 2)), np.empty(0, dtype=bool), "valid must be a boolean"),
    ],
)
def test_bad_evaluations_are_refused(x, valid, message):
    with pytest.raises(ValueError, match=message):
        ValidityModel().fit(x, valid)


def test_other_number_of_inputs_and_no_fit_are_refused():
    with pytest.raises(ValueError, match="call fit first"):
        ValidityModel().predict_log_probability([[0.0]])
    x, valid, _ = _data()
    model = ValidityModel().fit(x, valid)
    with pytest.raises(ValueError, match=r"\(n, 2\)"):
        model.log_weight([[0.0]])
    with pytest.raises(ValueError, match=r"\(n, 2\)"):
        model.fit([[0.0]], [True])


def _toy(x):
    return np.column_stack(
        [np.linalg.norm(2.0 * x - 1.0, axis=1), np.linalg.norm(2.0 * x + 1.0, axis=1)]
    )


def _failures(fails, seed, suggestions=25):
    """Failures among suggestions on the paper's toy problem, by exact EHVI over random candidates."""
    rng = np.random.default_rng(seed)
    x = rng.uniform(-1, 1, (5, 2))
    valid = ~fails(x)
    models, validity = [GaussianProcess(), GaussianProcess()], ValidityModel()
    for _ in range(suggestions):
        candidates = rng.uniform(-1, 1, (500, 2))
        if valid.any():
            y = _toy(x[valid])
            for model, column in zip(models, y.T, strict=True):
                model.fit(x[valid], column, restarts=0)
            near = x[valid][rng.integers(len(y), size=300)] + 0.1 * rng.normal(size=(300, 2))
            candidates = np.vstack([candidates, np.clip(near, -1, 1)])
            mean, stddev = np.stack([model.predict(candidates) for model in models], axis=-1)
            improvement = BoxDecomposition([4.3, 4.3], y).expected_improvement(mean, stddev)
            score = np.log(np.maximum(improvement, 1e-300))
        else:
            score = np.zeros(len(candidates))
        score += validity.fit(x, valid).log_weight(candidates)
        x = np.vstack([x, candidates[score.argmax()]])
        valid = np.append(valid, ~fails(x[-1:]))
    return suggestions - np.count_nonzero(valid[5:])


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_steers_away_from_a_failing_half(sign):
    failures = [_failures(lambda x: sign * x[:, 0] > 0.0, seed) for seed in range(5)]
    assert np.median(failures) <= 3


def outcomes(n: int, seed: int) -> tuple[np.ndarray, np.random.Generator]:
    rng = np.random.default_rng(seed)
    return rng.uniform(-1.0, 1.0, (n, 2)), rng


@pytest.mark.parametrize("rate", [0.2, 0.5, 0.75])
def test_failures_by_chance_do_not_narrow_the_search(rate: float) -> None:
    x, rng = outcomes(40, 3)
    model = ValidityModel().fit(x, rng.random(40) >= rate)
    weights = model.log_weight(x)
    assert weights.max() - weights.min() < 0.8


def test_what_fails_again_and_again_in_one_place_is_no_burst() -> None:
    x, _ = outcomes(40, 3)
    x[15:, 1] = 0.1 * x[15:, 1] - 0.9  # evaluations at an edge are valid
    order = [*range(40), 0, 15, 16, 1, 17, 18, 2, 19]
    valid = np.array(order) >= 15
    at_first = ValidityModel().fit(x, valid[:40]).log_weight(x[5:6])[0]
    assert ValidityModel().fit(x[order], valid).log_weight(x[5:6])[0] < min(at_first - 5.0, -4.0)


def test_the_evidence_of_bursts_is_that_of_all_chains() -> None:
    p = (np.arange(400) + 0.5) / 400
    lasts_valid, lasts_failed = p[:, None], p[None]
    likelihood = 0.5 * lasts_failed * (1 - lasts_failed) * lasts_valid**3 * (1 - lasts_valid)
    outcomes = np.array([False, False, True, True, True, True, False])
    assert _log_evidence_of_bursts(outcomes) == pytest.approx(np.log(likelihood.mean()), abs=1e-3)


def test_failures_that_repeat_somewhere_do_narrow_it() -> None:
    x, _ = outcomes(40, 3)
    model = ValidityModel().fit(x, x[:, 0] < 0.0)
    weights = model.log_weight(np.array([[-0.6, 0.0], [0.6, 0.0]]))
    assert weights[0] > -0.5
    assert weights[1] < -4.0


def test_a_single_failure_among_many_deters_less_than_three_of_three() -> None:
    x, _ = outcomes(20, 5)
    valid = np.ones(20, dtype=np.bool_)
    valid[7] = False
    once = ValidityModel().fit(x, valid).log_weight(x[7:8])[0]
    again = np.vstack([x, x[7] + [[0.03, 0.0], [0.0, 0.03]]])
    repeated = ValidityModel().fit(again, np.append(valid, [False, False])).log_weight(x[7:8])[0]
    assert repeated < once - 1.0
