"""Shot noise and averages."""

from __future__ import annotations

import math

import numpy as np
import pytest

from awa_sim_node.machine.diagnostics import ShotNoise, average

N = 4000


@pytest.mark.parametrize(
    ("noise", "value", "expected"),
    [
        (ShotNoise(0.02, 0.05), 10.0, 0.2),
        (ShotNoise(0.02, 0.05), 2.0, 0.05),
        (ShotNoise(0.07), 80.0, 5.6),
        (ShotNoise(0.1), -3.0, 0.3),
        (ShotNoise(), 5.0, 0.0),
    ],
)
def test_shots_scatter_as_stated(noise: ShotNoise, value: float, expected: float) -> None:
    rng = np.random.default_rng(1)
    shots = np.array([noise.shot(value, rng) for _ in range(N)])
    assert noise.stddev(value) == pytest.approx(expected)
    assert abs(shots.mean() - value) <= 4.0 * expected / math.sqrt(N)
    assert abs(shots.std() - expected) <= 4.0 * expected / math.sqrt(2 * N)


def test_average_gives_the_mean_and_its_standard_uncertainty() -> None:
    shots = [1.0, 2.0, 4.0, 5.0]
    mean, stddev = average(shots)
    assert mean == pytest.approx(np.mean(shots))
    assert stddev == pytest.approx(np.std(shots, ddof=1) / 2.0)


def test_the_uncertainty_is_that_of_the_mean() -> None:
    rng = np.random.default_rng(5)
    averages = [average(list(rng.normal(3.0, 0.4, 5))) for _ in range(N)]
    means = np.array([mean for mean, _ in averages])
    variances = np.array([stddev**2 for _, stddev in averages])
    expected = 0.4**2 / 5
    assert abs(means.var() / expected - 1.0) < 4.0 * math.sqrt(2 / N)
    # The variance of a sample variance of 5 shots is 2 / 4 of its square.
    assert abs(variances.mean() / expected - 1.0) < 4.0 * math.sqrt(0.5 / N)


def test_equal_shots_average_to_their_value() -> None:
    assert average([0.1] * 7) == (0.1, 0.0)


def test_shots_without_a_value_are_left_out() -> None:
    assert average([math.nan, 2.0, 4.0]) == (3.0, pytest.approx(1.0))


def test_a_single_shot_has_no_known_uncertainty() -> None:
    mean, stddev = average([2.5])
    assert mean == 2.5
    assert math.isnan(stddev)


@pytest.mark.parametrize("shots", [[], [math.nan], [math.nan, math.nan]])
def test_nothing_measured_is_nan(shots: list[float]) -> None:
    mean, stddev = average(shots)
    assert math.isnan(mean)
    assert math.isnan(stddev)


@pytest.mark.parametrize(("fraction", "floor"), [(-0.1, 0.0), (0.0, -1.0), (math.nan, 0.0)])
def test_senseless_noise_is_refused(fraction: float, floor: float) -> None:
    with pytest.raises(ValueError, match=r"^(fraction|floor) = .* must be finite and at least 0$"):
        ShotNoise(fraction, floor)
