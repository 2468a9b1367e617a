"""The maximisers on functions whose maximum is known."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from mobo_tuner.core.acquisition import (
    AcquisitionFunction,
    ExpectedHypervolumeImprovement,
    Predictions,
    UpperConfidenceBoundHypervolumeImprovement,
)
from mobo_tuner.core.acquisition_optimizer import Maximizer, MultiStart, ParticleSwarm
from mobo_tuner.core.arrays import FloatArray
from mobo_tuner.core.hypervolume import BoxDecomposition
from mobo_tuner.core.proximal import ProximalBiasing
from tests.core.analytic_model import AnalyticModel

MAXIMIZERS: list[Maximizer] = [ParticleSwarm(), MultiStart()]
both = pytest.mark.parametrize("maximizer", MAXIMIZERS, ids=["swarm", "multi-start"])


class Peaks(AcquisitionFunction):
    """A sum of narrow bumps of different heights; records where it was evaluated."""

    def __init__(self, centers: FloatArray, heights: FloatArray, width: float) -> None:
        self.centers = np.asarray(centers, dtype=float)
        self.heights = np.asarray(heights, dtype=float)
        self.width = width
        self.seen: list[FloatArray] = []

    def log_value_from(self, predictions: Predictions) -> FloatArray:
        return self.log_value_with_gradient_from(predictions)[0]

    def log_value_with_gradient_from(
        self, predictions: Predictions
    ) -> tuple[FloatArray, FloatArray]:
        self.seen.append(predictions.inputs.copy())
        step = (predictions.inputs[:, None, :] - self.centers) / self.width
        bumps = self.heights * np.exp(-0.5 * (step**2).sum(axis=2))
        value = bumps.sum(axis=1)
        gradient = -(bumps[:, :, None] * step / self.width).sum(axis=1)
        zero = value < 1e-12
        with np.errstate(divide="ignore"):
            log_value = np.where(zero, -np.inf, np.log(value))
        return log_value, np.where(
            zero[:, None], 0.0, gradient / np.where(zero, 1.0, value)[:, None]
        )


def rng(seed: int = 0) -> np.random.Generator:
    return np.random.default_rng(seed)


def hypervolume_function(n_variables: int) -> AcquisitionFunction:
    models = [AnalyticModel(n_variables, seed) for seed in range(3)]
    inputs = rng(1).uniform(-1.0, 1.0, (30, n_variables))
    points = np.stack([model.predict(inputs)[0] for model in models], axis=1)
    return ExpectedHypervolumeImprovement(models, BoxDecomposition(np.full(3, 1.5), points))


@pytest.mark.parametrize("n_variables", [1, 2, 6, 20])
def test_multi_start_finds_a_single_peak_exactly(n_variables: int) -> None:
    center = rng(2).uniform(-0.9, 0.9, n_variables)
    found = MultiStart().maximize(ProximalBiasing(center, 3.0), n_variables, rng())
    assert found is not None
    assert found.complete
    np.testing.assert_allclose(found.x, center, atol=1e-3)
    assert found.log_value == pytest.approx(0.0, abs=1e-5)


@pytest.mark.parametrize(("n_variables", "near"), [(1, 0.02), (2, 0.05), (6, 0.3)])
def test_swarm_comes_near_a_single_peak(n_variables: int, near: float) -> None:
    center = rng(2).uniform(-0.9, 0.9, n_variables)
    found = ParticleSwarm().maximize(ProximalBiasing(center, 3.0), n_variables, rng())
    assert found is not None
    np.testing.assert_allclose(found.x, center, atol=near)


def test_swarm_evaluates_as_often_as_the_paper_says() -> None:
    function = Peaks(np.zeros((1, 2)), np.ones(1), 1.0)
    ParticleSwarm().maximize(function, 2, rng())
    assert sum(len(x) for x in function.seen) == 64 * 11


@pytest.mark.parametrize("n_variables", [1, 2, 6, 20])
@both
def test_any_number_of_variables(maximizer: Maximizer, n_variables: int) -> None:
    function = hypervolume_function(n_variables)
    found = maximizer.maximize(function, n_variables, rng())
    assert found is not None
    assert found.x.shape == (n_variables,)
    assert (np.abs(found.x) <= 1.0).all()
    assert found.log_value == pytest.approx(function.log_value(found.x[None])[0], rel=1e-9)
    sampled = function.log_value(rng(7).uniform(-1.0, 1.0, (64, n_variables)))
    assert found.log_value >= sampled.max() - (0.5 if maximizer is MAXIMIZERS[0] else 0.0)


def test_multi_start_beats_the_swarm() -> None:
    function = hypervolume_function(6)
    for seed in range(5):
        swarm = ParticleSwarm().maximize(function, 6, rng(seed))
        multi = MultiStart().maximize(function, 6, rng(seed))
        assert swarm is not None
        assert multi is not None
        assert multi.log_value >= swarm.log_value


def test_multi_start_finds_the_highest_of_many_peaks() -> None:
    centers = np.array(list(itertools.product([-0.7, 0.0, 0.7], repeat=3)))
    heights = np.linspace(1.0, 2.0, len(centers))
    function = Peaks(centers, heights, 0.15)
    for seed in range(5):
        found = MultiStart(finished=6).maximize(function, 3, rng(seed))
        assert found is not None
        assert found.log_value > np.log(1.9)


def test_a_maximum_on_the_edge() -> None:
    found = MultiStart().maximize(ProximalBiasing([3.0, -0.5], 1.0), 2, rng())
    assert found is not None
    np.testing.assert_allclose(found.x, [1.0, -0.5], atol=1e-3)


@both
def test_same_seed_same_result(maximizer: Maximizer) -> None:
    function = hypervolume_function(4)
    starts = rng(5).uniform(-1.0, 1.0, (7, 4))
    first, second = (maximizer.maximize(function, 4, rng(9), starts=starts) for _ in range(2))
    assert first is not None
    assert second is not None
    np.testing.assert_array_equal(first.x, second.x)
    assert first.log_value == second.log_value


@both
def test_zero_everywhere_is_signalled(maximizer: Maximizer) -> None:
    models = [AnalyticModel(3, seed, stddev=1e-3) for seed in range(2)]
    done = BoxDecomposition([1.0, 1.0], [[-9.0, -9.0]])
    function = UpperConfidenceBoundHypervolumeImprovement(models, done, 0.01)
    assert maximizer.maximize(function, 3, rng(), starts=np.zeros((1, 3))) is None
    assert maximizer.maximize(function, 3, rng()) is None


@both
def test_starts_lead_to_a_peak_that_is_hard_to_find(maximizer: Maximizer) -> None:
    center = np.full(8, 0.83)
    function = Peaks(center[None], np.ones(1), 0.04)
    assert maximizer.maximize(function, 8, rng()) is None
    found = maximizer.maximize(function, 8, rng(), starts=[center + 0.02, center - 0.02])
    assert found is not None
    np.testing.assert_allclose(found.x, center, atol=0.05)


def test_starts_outside_the_box_are_moved_into_it() -> None:
    function = Peaks(np.array([[1.0, 0.0]]), np.ones(1), 0.2)
    for maximizer in MAXIMIZERS:
        found = maximizer.maximize(function, 2, rng(), starts=[[1.5, 0.0]])
        assert found is not None
    assert all((np.abs(x) <= 1.0).all() for x in function.seen)


@both
def test_excluded_points_are_not_proposed(maximizer: Maximizer) -> None:
    center = np.array([0.3, -0.4])
    function = Peaks(center[None], np.ones(1), 0.2)
    found = maximizer.maximize(
        function, 2, rng(), starts=center[None], excluded=center[None], tolerance=0.05
    )
    assert found is not None
    assert np.abs(found.x - center).max() > 0.05
    np.testing.assert_allclose(found.x, center, atol=0.2)


@both
def test_all_excluded(maximizer: Maximizer) -> None:
    function = Peaks(np.zeros((1, 2)), np.ones(1), 0.5)
    assert maximizer.maximize(function, 2, rng(), excluded=[[0.0, 0.0]], tolerance=1.0) is None


@both
@pytest.mark.parametrize("ticks", [0, 1, 3, 12])
def test_time_budget_returns_the_best_so_far(
    maximizer: Maximizer, ticks: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each look at the clock takes a second."""
    clock = itertools.count(0.0)
    monkeypatch.setattr("time.monotonic", lambda: next(clock))
    function = Peaks(np.zeros((1, 3)), np.ones(1), 0.5)
    found = maximizer.maximize(function, 3, rng(), seconds=ticks)
    whole_swarm = 11 if isinstance(maximizer, ParticleSwarm) else 1000
    assert len(function.seen) == min(ticks + 1, whole_swarm)
    assert found is not None
    assert found.complete == (ticks >= whole_swarm)
    seen = np.concatenate(function.seen)
    assert found.log_value == function.log_value(seen).max()


@both
def test_one_screen_is_enough_for_a_fallback(maximizer: Maximizer) -> None:
    found = maximizer.maximize(hypervolume_function(5), 5, rng(), seconds=0.0)
    assert found is not None
    assert not found.complete


@both
def test_wrong_arguments(maximizer: Maximizer) -> None:
    function = ProximalBiasing([0.0, 0.0], 1.0)
    with pytest.raises(ValueError, match="n_variables must be at least 1, not 0"):
        maximizer.maximize(function, 0, rng())
    with pytest.raises(ValueError, match=r"starts must have shape \(k, 2\), not \(1, 3\)"):
        maximizer.maximize(function, 2, rng(), starts=[[0.0, 0.0, 0.0]])
    with pytest.raises(ValueError, match="starts must be finite"):
        maximizer.maximize(function, 2, rng(), starts=[[np.nan, 0.0]])
    with pytest.raises(ValueError, match="excluded must have shape"):
        maximizer.maximize(function, 2, rng(), excluded=[0.0, 0.0])
    with pytest.raises(ValueError, match="tolerance must be at least 0"):
        maximizer.maximize(function, 2, rng(), tolerance=-1.0)
    with pytest.raises(ValueError, match="seconds must be at least 0 or None"):
        maximizer.maximize(function, 2, rng(), seconds=-1.0)
