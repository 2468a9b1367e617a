"""The signed logarithm about a limit: the probability to keep the limit is that of the transformed output."""

from __future__ import annotations

import json

import numpy as np
import pytest

from mobo_tuner.core import Optimizer
from mobo_tuner.core.arrays import FloatArray
from mobo_tuner.core.constraints import log_probability_between
from mobo_tuner.core.gaussian_process import GaussianProcess, GaussianProcessSettings
from mobo_tuner.core.output_scaling import OutputScaling, has_heavy_tail_about
from mobo_tuner.core.output_transform import Logarithm, SignedLogarithm, transform_from_state
from tests.core.toy_runs import with_changes

ABOUT = SignedLogarithm(limit=3.0, width=0.5)
PLACES = np.array([-6.0, -1.0, -1e-3, -1e-7, 0.0, 1e-7, 1e-3, 1.0, 6.0])


def test_it_is_inverted_and_its_unit_is_its_slope() -> None:
    y = ABOUT.invert(PLACES)
    np.testing.assert_allclose(ABOUT.apply(y), PLACES, atol=1e-12)
    h = 1e-6
    slope = (ABOUT.invert(PLACES + h) - ABOUT.invert(PLACES - h)) / (2.0 * h)
    np.testing.assert_allclose(ABOUT.unit(y), slope, rtol=1e-5)
    assert ABOUT.apply(np.array([3.5]))[0] == pytest.approx(np.log(2.0))


@pytest.mark.parametrize("mean", [-2.0, -0.3, 0.0, 0.4, 3.0])
@pytest.mark.parametrize("stddev", [0.2, 1.0, 2.5])
def test_the_probability_to_keep_a_limit_is_that_of_random_draws(
    mean: float, stddev: float
) -> None:
    draws = ABOUT.invert(np.random.default_rng(0).normal(mean, stddev, 100_000))
    output = ABOUT.to_output(np.array([mean]), np.array([stddev]))
    assert ABOUT.apply(output[0])[0] == pytest.approx(np.median(ABOUT.apply(draws)), abs=0.03)
    kept = np.exp(log_probability_between(*output, -np.inf, ABOUT.limit)[0][0])
    assert kept == pytest.approx(np.mean(draws <= ABOUT.limit), abs=0.005)
    kept = np.exp(log_probability_between(*output, ABOUT.limit, np.inf)[0][0])
    assert kept == pytest.approx(np.mean(draws >= ABOUT.limit), abs=0.005)


@pytest.mark.parametrize("reading", [-20.0, 2.9, 3.0, 3.2, 40.0])
def test_a_reading_is_as_improbable_as_in_random_draws(reading: float) -> None:
    mean, stddev, y = np.array([0.4]), np.array([1.5]), np.array([reading])
    draws = ABOUT.invert(np.random.default_rng(0).normal(0.4, 1.5, 100_000))
    output = ABOUT.to_reading(mean, stddev, y)
    below = np.exp(log_probability_between(*output, -np.inf, reading)[0][0])
    assert below == pytest.approx(np.mean(draws <= reading), abs=0.005)
    at_the_median = ABOUT.to_reading(mean, stddev, ABOUT.invert(mean))
    assert at_the_median[1][0] == pytest.approx(1.5 * ABOUT.unit(ABOUT.invert(mean))[0])


def test_gradients_are_finite_differences() -> None:
    mean, stddev, h = PLACES[PLACES != 0.0], np.linspace(0.1, 2.0, 8), 1e-9
    for step in ((h, 0.0), (0.0, h)):
        slopes = [np.full((8, 1), part / h) for part in step]
        gradients = ABOUT.gradients_to_output(mean, stddev, *slopes)
        above = ABOUT.to_output(mean + step[0], stddev + step[1])
        below = ABOUT.to_output(mean - step[0], stddev - step[1])
        for gradient, a, b in zip(gradients, above, below, strict=True):
            np.testing.assert_allclose(gradient[:, 0], (a - b) / (2.0 * h), rtol=1e-4, atol=1e-4)


@pytest.mark.parametrize("transform", [SignedLogarithm(1e90, 1e99), SignedLogarithm(0.0, 1e-140)])
def test_huge_numbers_stay_finite(transform: SignedLogarithm) -> None:
    moments = np.array([1e5, -1e5, 0.0]), np.array([1e5, 1.0, 1e5])
    for part in (*transform.to_output(*moments), transform.apply(np.array([1e100, -1e100]))):
        assert np.isfinite(part).all()


def test_state_through_json() -> None:
    for transform in (ABOUT, Logarithm(2.0)):
        state = json.loads(json.dumps(OutputScaling(transform, 1.0, 2.0).get_state()))
        assert OutputScaling.from_state(state, None, None).transform == transform
    former = {"log": False, "low": None, "offset": 0.0, "scale": 1.0}
    assert OutputScaling.from_state(former, None, None).transform is None
    with pytest.raises(ValueError, match="width"):
        transform_from_state({"log": False, "limit": 1.0, "width": -1.0})


# ------------------------------------------------------------------ models


def cliff(x: FloatArray) -> FloatArray:
    """Return readings that are nearly alike below the limit 0 and span decades above it."""
    return np.asarray(10.0 ** (2.5 * (x[:, 0] + 0.3 * np.sin(3.0 * x[:, 1]))) - 1.0)


def fitted(n: int = 24, stddev: float | None = None) -> GaussianProcess:
    x = np.random.default_rng(1).uniform(-1.0, 1.0, (n, 2))
    told = None if stddev is None else np.full(n, stddev)
    return GaussianProcess(GaussianProcessSettings(mean="auto"), limit=0.0).fit(x, cliff(x), told)


def test_a_model_takes_it_where_distances_from_the_limit_have_a_heavy_tail() -> None:
    model = fitted()
    assert model.model == "data signed log"
    x = np.random.default_rng(2).uniform(-0.9, 0.9, (300, 2))
    plain = GaussianProcess(GaussianProcessSettings(mean="auto", transform="none"))
    inputs = np.random.default_rng(1).uniform(-1.0, 1.0, (24, 2))
    plain.fit(inputs, cliff(inputs))

    def log_score(process: GaussianProcess) -> float:
        log_kept = log_probability_between(*process.predict(x), -np.inf, 0.0)[0]
        log_missed = log_probability_between(*process.predict(x), 0.0, np.inf)[0]
        return float(np.where(cliff(x) <= 0.0, log_kept, log_missed).mean())

    assert log_score(model) > 0.5 * log_score(plain)


def test_a_model_stays_plain_without_a_heavy_tail_or_a_limit() -> None:
    x = np.random.default_rng(1).uniform(-1.0, 1.0, (24, 2))
    y = x[:, 0] + np.sin(3.0 * x[:, 1])
    assert not has_heavy_tail_about(y, 0.0)
    with_limit = GaussianProcess(GaussianProcessSettings(mean="auto"), limit=0.0).fit(x, y)
    without = GaussianProcess(GaussianProcessSettings(mean="auto")).fit(x, y)
    assert with_limit.model == "data"
    np.testing.assert_array_equal(with_limit.predict(x), without.predict(x))
    none = GaussianProcess(GaussianProcessSettings(transform="none"), limit=0.0).fit(x, cliff(x))
    assert none.model == "data"


def test_told_noise_counts_in_the_units_of_the_readings() -> None:
    model, x = fitted(stddev=0.2), np.random.default_rng(1).uniform(-1.0, 1.0, (24, 2))
    if model.model != "data signed log":
        pytest.fail(model.model)
    far, near = int(cliff(x).argmax()), int(np.abs(cliff(x)).argmin())
    for row in (far, near):
        assert model.noise_at(x[row]) >= 0.2
    quiet = fitted().predict(x[[near]])[1][0]
    assert model.predict(x[[near]])[1][0] > 2.0 * quiet


def test_state_of_a_model_through_json_gives_bitwise_the_same_numbers() -> None:
    model, new = fitted(), np.random.default_rng(3).uniform(-1.0, 1.0, (5, 2))
    x = np.random.default_rng(1).uniform(-1.0, 1.0, (24, 2))
    state = json.loads(json.dumps(model.get_state()))
    again = GaussianProcess.from_state(state, x, cliff(x), limit=0.0)
    np.testing.assert_array_equal(again.predict(new), model.predict(new))
    model.add(new[0], 1.0)
    again.add(new[0], 1.0)
    np.testing.assert_array_equal(again.predict(new), model.predict(new))
    assert again.untrained().fit(x, cliff(x)).model == "data signed log"


def test_only_a_diagnostic_with_one_limit_has_it() -> None:
    limits = {
        "f1": {"max": 3.0},
        "g": {"max": 2.0},
        "h": {"min": 0.0, "max": 1.0},
        "l": {"min": 5.0},
    }
    optimizer = Optimizer(with_changes(constraints=limits), seed=0)
    found = {name: m.limit for name, m in optimizer.archive.models.by_output.items()}
    assert found == {"f1": None, "f2": None, "g": 2.0, "h": None, "l": 5.0}
    summed = {"derived": {"s": {"formula": "g + f2"}}, "constraints": limits | {"s": {"max": 9.0}}}
    optimizer = Optimizer(with_changes(**summed), seed=0)
    found = {name: m.limit for name, m in optimizer.archive.models.by_output.items()}
    assert found["s"] == 9.0
    assert found["g"] is None
