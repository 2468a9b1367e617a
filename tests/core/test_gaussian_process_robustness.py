"""The Gaussian process on awkward data: an answer in finite numbers, or one clear error."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mobo_tuner.core.gaussian_process import GaussianProcess, GaussianProcessSettings
from tests.core.gaussian_process_data import KERNELS, quick, sample


@pytest.mark.parametrize("value", [0.0, 5.0, -1e-9, 1e9])
@pytest.mark.parametrize("n", [1, 2, 30])
def test_constant_outputs_give_a_constant_mean_and_a_small_spread(value, n):
    x = np.random.default_rng(0).uniform(-1, 1, (n, 2))
    model = GaussianProcess().fit(x, np.full(n, value))
    mean, stddev = model.predict(np.random.default_rng(1).uniform(-1, 1, (5, 2)))
    np.testing.assert_allclose(mean, value, rtol=1e-9)
    assert (stddev > 0.0).all()
    assert (stddev <= (abs(value) or 1.0) / n).all()


def test_constant_outputs_below_the_reference_point_rise_towards_it():
    x = np.random.default_rng(0).uniform(-0.1, 0.1, (5, 1))
    choice = GaussianProcessSettings(mean="reference")
    model = GaussianProcess(choice, reference=9.0).fit(x, np.full(5, 2.0))
    near, far = model.predict([[0.0], [1e6]])[0]
    assert near == pytest.approx(2.0, abs=0.01)
    assert far == pytest.approx(9.0)


@pytest.mark.parametrize("scale", [1e-9, 1e-3, 1e9])
@pytest.mark.parametrize("mean", ["data", "reference"])
def test_predictions_scale_with_the_outputs(scale, mean):
    x, y, new = sample(noise=0.1)
    choice = GaussianProcessSettings(mean=mean)
    plain = GaussianProcess(choice, reference=60.0).fit(x, y)
    scaled = GaussianProcess(choice, reference=scale * 60.0).fit(x, scale * y)
    for got, expected in zip(
        scaled.predict_with_gradient(new), plain.predict_with_gradient(new), strict=True
    ):
        np.testing.assert_allclose(
            got, scale * expected, rtol=1e-2, atol=1e-3 * scale * np.abs(expected).max()
        )


def test_same_input_with_different_outputs_is_noise():
    x, y, _ = sample(20)
    model = GaussianProcess().fit(np.vstack([x, x]), np.append(y - 0.5, y + 0.5))
    assert model.noise == pytest.approx(0.5, rel=0.5)
    np.testing.assert_allclose(model.predict(x)[0], y, atol=0.5)


_magnitudes = st.sampled_from([1e-9, 1e-3, 1.0, 1e6, 1e9])


@st.composite
def _ill_conditioned(draw):
    n, d = draw(st.integers(1, 12)), draw(st.sampled_from([1, 2, 20]))
    rng = np.random.default_rng(draw(st.integers(0, 1000)))
    x = np.round(rng.uniform(-1, 1, (n, d)), draw(st.sampled_from([0, 1, 8])))
    y = draw(_magnitudes) * rng.normal(size=n) + draw(st.sampled_from([0.0, 1.0, -1e9]))
    if draw(st.booleans()):
        y[rng.integers(n)] = 1e6
    if draw(st.booleans()):
        x[rng.integers(n)] = x[rng.integers(n)]
    stddev = draw(st.sampled_from([None, 0.0, 1e-9, 1e9]))
    return x, y, None if stddev is None else np.full(n, stddev)


@quick
@given(
    data=_ill_conditioned(),
    kernel=st.sampled_from(KERNELS),
    mean=st.sampled_from(["data", "reference", "auto"]),
    noise=st.sampled_from(["learned", 0.0, 1.0]),
    transform=st.sampled_from(["none", "auto", "log"]),
    prior=st.sampled_from(["weak", "none"]),
)
def test_ill_conditioned_data_gives_finite_answers(data, kernel, mean, noise, transform, prior):
    x, y, stddev = data
    choice = GaussianProcessSettings(
        kernel=kernel, mean=mean, noise=noise, transform=transform, prior=prior
    )
    model = GaussianProcess(choice, reference=3.0).fit(x, y, stddev)
    for i in range(3):
        model.add(x[0], y[0] + i, None if stddev is None else stddev[0])
    for point in (x[:1], x[:1] + 0.1, np.vstack([x, -x])):
        for part in model.predict_with_gradient(point):
            assert np.isfinite(part).all()
        assert (model.predict(point)[1] > 0.0).all()
    for part in model.leave_one_out():
        assert np.isfinite(part).all()
    model.fit(x, y, stddev)
    assert np.isfinite(model.log_marginal_likelihood)


@quick
@given(seed=st.integers(0, 1000))
def test_the_order_of_the_observations_does_not_matter(seed):
    x, y, new = sample(10, noise=0.1)
    order = np.random.default_rng(seed).permutation(10)
    choice = GaussianProcessSettings(length_scales=0.7, variance=30.0, noise=0.1)
    straight, shuffled = (GaussianProcess(choice).fit(x[i], y[i]) for i in (slice(10), order))
    np.testing.assert_allclose(shuffled.predict(new), straight.predict(new), rtol=1e-6)


@pytest.mark.parametrize(
    ("x", "y", "stddev", "message"),
    [
        ([[0.0], [np.nan]], [1.0, 2.0], None, "x must be finite"),
        ([[0.0], [1.0]], [1.0, np.nan], None, "y must be finite"),
        ([[0.0], [1.0]], [1.0, np.inf], None, "y must be finite"),
        ([[0.0], [1.0]], [1.0, 1e101], None, "y must be finite and at most 1e"),
        ([[0.0], [1.0]], [1.0], None, "y must have one value"),
        ([[0.0], [1.0]], [[1.0], [2.0]], None, "y must have one value"),
        (np.empty((0, 2)), [], None, "y must have one value"),
        ([0.0, 1.0], [1.0, 2.0], None, "x must have shape"),
        ([[0.0], [1.0]], [1.0, 2.0], [0.1], "stddev must have the shape"),
        ([[0.0], [1.0]], [1.0, 2.0], [0.1, -0.1], "stddev must be at least 0"),
        ([[0.0], [1.0]], [1.0, 2.0], [0.1, np.inf], "stddev must be at least 0"),
    ],
)
def test_bad_observations_are_refused(x, y, stddev, message):
    with pytest.raises(ValueError, match=message):
        GaussianProcess().fit(x, y, stddev)


def test_other_number_of_inputs_is_refused():
    x, y, new = sample()
    model = GaussianProcess().fit(x, y)
    for call in (
        lambda: model.predict(new[:, :2]),
        lambda: model.predict_with_gradient(new[:, :2]),
        lambda: model.add(new[0, :2], 1.0),
        lambda: model.fit(x[:, :2], y),
        lambda: model.condition(x[:, :2], y),
    ):
        with pytest.raises(ValueError, match=r"x must have shape \(n, 3\)"):
            call()


def test_refused_observation_leaves_the_model_as_it_was():
    x, y, new = sample()
    model = GaussianProcess().fit(x, y)
    before = model.predict(new)
    with pytest.raises(ValueError, match="y must be finite"):
        model.add(new[0], np.nan)
    with pytest.raises(ValueError, match="y must be finite"):
        model.fit(x, np.full(len(y), np.nan))
    np.testing.assert_array_equal(model.predict(new), before)


def test_nothing_works_before_the_first_fit():
    with pytest.raises(ValueError, match="call fit first"):
        GaussianProcess().predict([[0.0]])
    with pytest.raises(ValueError, match="call fit first"):
        GaussianProcess().add([0.0], 1.0)


def test_reference_is_checked():
    with pytest.raises(ValueError, match="reference must be given"):
        GaussianProcess(GaussianProcessSettings(mean="reference"))
    with pytest.raises(ValueError, match="reference must be finite"):
        GaussianProcess(reference=np.nan)


@pytest.mark.parametrize(
    ("mean", "gradient", "message"),
    [
        (lambda x: x, None, "mean function must return"),
        (lambda x: np.full(len(x), np.nan), None, "mean function must return"),
        (lambda x: x[:, 0], lambda x: x[:, 0], "mean_gradient must return"),
    ],
)
def test_bad_mean_functions_are_refused(mean, gradient, message):
    x, _, new = sample()
    model = GaussianProcess(mean=mean, mean_gradient=gradient)
    with pytest.raises(ValueError, match=message):
        model.fit(x, x[:, 0]).predict_with_gradient(new)  # outputs for which the function is chosen
