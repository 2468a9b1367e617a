"""The average of shots against numpy and against what was put in."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mobo_tuner.machine.averaging import OutlierRule, average

SHOTS = np.random.default_rng(5).normal(3.0, 0.5, 200).tolist()
RULES = [OutlierRule("mad", 6.0), OutlierRule("sigma", 5.0)]


def test_the_mean_and_its_uncertainty() -> None:
    mean, stddev = average([*SHOTS, math.nan, math.inf])
    assert mean == pytest.approx(np.mean(SHOTS), rel=1e-12)
    assert stddev == pytest.approx(np.std(SHOTS, ddof=1) / math.sqrt(200), rel=1e-12)


def test_the_uncertainty_is_that_of_the_mean() -> None:
    count = 4000
    rng = np.random.default_rng(5)
    averages = [average(list(rng.normal(3.0, 0.4, 5))) for _ in range(count)]
    means = np.array([mean for mean, _ in averages])
    variances = np.array([stddev**2 for _, stddev in averages])
    expected = 0.4**2 / 5
    assert abs(means.var() / expected - 1.0) < 4.0 * math.sqrt(2 / count)
    # The variance of a sample variance of 5 shots is 2 / 4 of its square.
    assert abs(variances.mean() / expected - 1.0) < 4.0 * math.sqrt(0.5 / count)


@pytest.mark.parametrize(
    ("statistic", "of"),
    [
        ("rms", lambda shots: np.sqrt(np.mean(np.square(shots), axis=-1))),
        ("p50", lambda shots: np.median(shots, axis=-1)),
        ("p90", lambda shots: np.percentile(shots, 90.0, axis=-1)),
    ],
)
def test_other_statistics_and_their_uncertainty(
    statistic: str, of: Callable[[np.ndarray], np.ndarray]
) -> None:
    value, _ = average([*SHOTS, math.nan], statistic=statistic)
    assert value == pytest.approx(of(np.array(SHOTS)), rel=1e-12)
    shots = np.random.default_rng(6).normal(3.0, 0.4, (2000, 50))
    told = np.mean([average(list(row), statistic=statistic)[1] for row in shots])
    assert told == pytest.approx(of(shots).std(), rel=0.1)


@pytest.mark.parametrize("statistic", ["mean", "rms", "p0", "p37.5", "p100"])
def test_every_statistic_of_equal_shots_and_of_one(statistic: str) -> None:
    assert average([-2.5], statistic=statistic)[0] == (2.5 if statistic == "rms" else -2.5)
    assert math.isnan(average([-2.5], statistic=statistic)[1])
    assert average([0.0, 0.0, 0.0], statistic=statistic) == (0.0, 0.0)
    assert average([3e200] * 4, statistic=statistic) == (3e200, 0.0)
    assert np.isnan(average([math.nan], statistic=statistic)).all()


@pytest.mark.parametrize("statistic", ["", "p", "p-1", "p101", "p1e1", "median", "90"])
def test_unknown_statistics_are_refused(statistic: str) -> None:
    with pytest.raises(ValueError, match="allowed are mean, rms, and p0 to p100"):
        average([1.0], statistic=statistic)


def test_few_shots_show_no_scatter() -> None:
    assert np.isnan(average([])).all()
    assert np.isnan(average([math.nan, math.nan])).all()
    assert average([2.5])[0] == 2.5
    assert math.isnan(average([2.5, math.nan])[1])
    assert average([0.1, 0.1, 0.1]) == (0.1, 0.0)


@pytest.mark.parametrize("rule", RULES)
def test_outliers_are_left_out_and_nothing_else(rule: OutlierRule) -> None:
    clean = average(SHOTS)
    assert average(SHOTS, rule) == clean
    assert average([*SHOTS, 50.0, -80.0, 1e6], rule) == pytest.approx(clean, rel=1e-9)
    # Of two shots, neither can be said to be the outlier.
    assert average([1.0, 1e6], rule)[0] == pytest.approx(500_000.5)


def test_the_mad_rule_by_hand() -> None:
    # Median 3, deviations 2 1 0 1 97: their median is 1; 3 sigma are 3 * 1.4826 = 4.4.
    assert average([1.0, 2.0, 3.0, 4.0, 100.0], OutlierRule("mad", 3.0))[0] == 2.5
    assert average([7.0, 7.0, 7.0, 8.0], OutlierRule("mad", 3.0)) == (7.0, 0.0)


@given(
    st.lists(st.floats(allow_nan=True, allow_infinity=True, width=32)),
    st.sampled_from(["none", "mad", "sigma"]),
    st.floats(0.1, 10.0),
)
def test_an_average_lies_between_the_shots(shots: list[float], kind: str, limit: float) -> None:
    mean, stddev = average(shots, OutlierRule(kind, limit))
    finite = [shot for shot in shots if math.isfinite(shot)]
    if not finite:
        assert math.isnan(mean)
    elif not math.isnan(mean):
        slack = 1e-6 * max(abs(shot) for shot in finite)
        assert min(finite) - slack <= mean <= max(finite) + slack
        assert math.isnan(stddev) or stddev >= 0.0
