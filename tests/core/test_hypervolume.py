"""The box decomposition against moocore, pygmo, Monte Carlo and finite differences."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator
from random import Random

import moocore
import numpy as np
import pygmo
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from mobo_tuner.core.arrays import FloatArray
from mobo_tuner.core.hypervolume import BoxDecomposition, hypervolume
from mobo_tuner.core.pareto import is_below, pareto_front

REFERENCE = 4.0

quick = settings(max_examples=60, deadline=None, derandomize=True)


def oracle(points: FloatArray, reference: FloatArray) -> float:
    below = points[is_below(points, reference)]
    return float(moocore.hypervolume(below, ref=reference)) if len(below) else 0.0


def integer_grid(rng: np.random.Generator, n: int, n_objectives: int) -> FloatArray:
    """Ties everywhere, on and beyond the reference point."""
    return rng.integers(0, 6, (n, n_objectives)).astype(float)


def duplicates(rng: np.random.Generator, n: int, n_objectives: int) -> FloatArray:
    """Each point twice, dominated ones included."""
    return np.repeat(rng.uniform(0.0, 4.2, ((n + 1) // 2, n_objectives)), 2, axis=0)


def clipped(rng: np.random.Generator, n: int, n_objectives: int) -> FloatArray:
    """Many points on the faces of a box, one of them at the reference point."""
    return np.clip(rng.normal(1.5, 1.5, (n, n_objectives)), 0.0, 4.0)


def cases() -> Iterator[tuple[np.random.Generator, FloatArray, FloatArray]]:
    makers: tuple[Callable[[np.random.Generator, int, int], FloatArray], ...]
    makers = (integer_grid, duplicates, clipped)
    for seed, (make, n_objectives) in enumerate(itertools.product(makers, range(1, 8))):
        rng = np.random.default_rng(seed)
        for _ in range(25):
            yield rng, make(rng, int(rng.integers(0, 26)), n_objectives), np.full(n_objectives, 4.0)


def test_hypervolume_and_improvement_agree_with_moocore() -> None:
    n_cases = 0
    for rng, points, reference in cases():
        decomposition = BoxDecomposition(reference)
        for point in points:
            decomposition.add(point)
        before = oracle(points, reference)
        assert decomposition.hypervolume == pytest.approx(before, rel=1e-10, abs=1e-10)
        assert hypervolume(points, reference) == pytest.approx(before, rel=1e-10, abs=1e-10)
        candidates = integer_grid(rng, 20, len(reference)) - 0.3 * rng.integers(0, 2)
        for candidate, improvement in zip(
            candidates, decomposition.improvement(candidates), strict=True
        ):
            after = oracle(np.vstack([points, candidate]), reference)
            assert improvement == pytest.approx(after - before, rel=1e-10, abs=1e-9 * before)
            n_cases += 1
    assert n_cases >= 10_000


@pytest.mark.parametrize("n_objectives", range(2, 8))
def test_hypervolume_agrees_with_pygmo(n_objectives: int) -> None:
    rng = np.random.default_rng(n_objectives)
    reference = rng.uniform(1.0, 2.0, n_objectives)
    front = pareto_front(rng.random((60, n_objectives)), reference)
    expected = pygmo.hypervolume(front).compute(reference)
    assert hypervolume(front, reference) == pytest.approx(expected, rel=1e-10)


def test_one_objective() -> None:
    decomposition = BoxDecomposition([2.0], [[1.0], [0.5], [3.0]])
    assert decomposition.hypervolume == 1.5
    np.testing.assert_array_equal(decomposition.improvement([[0.0], [0.5], [1.0]]), [0.5, 0.0, 0.0])


def test_adding_returns_the_gain() -> None:
    decomposition = BoxDecomposition([2.0, 2.0], [[1.0, 1.0]])
    assert decomposition.add([0.5, 1.5]) == 0.25
    assert decomposition.add([0.5, 1.5]) == 0.0
    assert decomposition.add([1.5, 1.5]) == 0.0
    assert decomposition.add([0.0, 2.0]) == 0.0
    assert decomposition.add([np.nan, 0.0]) == 0.0
    assert decomposition.hypervolume == 1.25


def test_incremental_equals_rebuilt() -> None:
    rng = np.random.default_rng(5)
    reference = np.ones(5)
    points = rng.random((200, 5))
    grown = BoxDecomposition(reference, points[:50])
    for point in points[50:]:
        grown.add(point)
    built = BoxDecomposition(reference, points)
    mean, stddev = rng.random((10, 5)), rng.random((10, 5)) * 0.2
    assert grown.hypervolume == pytest.approx(built.hypervolume, rel=1e-12)
    np.testing.assert_allclose(grown.improvement(mean), built.improvement(mean), rtol=1e-9)
    np.testing.assert_allclose(
        grown.expected_improvement(mean, stddev),
        built.expected_improvement(mean, stddev),
        rtol=1e-9,
    )


def test_more_points_than_fit_narrow_indices(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("mobo_tuner.core.hypervolume._MOST_NARROW_LEVELS", 70)
    points = np.random.default_rng(6).random((150, 3))
    points /= np.linalg.norm(points, axis=1, keepdims=True)
    reference = np.ones(3)
    for first in (0, 10, 100):
        decomposition = BoxDecomposition(reference, points[:first])
        for point in points[first:]:
            decomposition.add(point)
        assert decomposition.hypervolume == pytest.approx(oracle(points, reference), rel=1e-12)
        assert decomposition.improvement([[0.0, 0.0, 0.0]])[0] == pytest.approx(
            1.0 - decomposition.hypervolume, rel=1e-12
        )


def random_decomposition(rng: np.random.Generator, n_objectives: int) -> BoxDecomposition:
    n = 25 if n_objectives < 7 else 10
    return BoxDecomposition(np.full(n_objectives, 1.1), rng.random((n, n_objectives)))


@pytest.mark.parametrize("n_objectives", range(1, 9))
@pytest.mark.parametrize("truncated", [False, True])
def test_expected_improvement_agrees_with_monte_carlo(n_objectives: int, truncated: bool) -> None:
    rng = np.random.default_rng(10 * n_objectives + truncated)
    decomposition = random_decomposition(rng, n_objectives)
    lower = rng.uniform(-0.3, 0.0, n_objectives) if truncated else None
    mean = rng.uniform(-0.1, 0.5, (4, n_objectives))
    stddev = rng.uniform(0.15, 0.4, (4, n_objectives))
    exact = decomposition.expected_improvement(mean, stddev, lower)
    for i in range(len(mean)):
        samples = mean[i] + stddev[i] * rng.standard_normal((40_000, n_objectives))
        improvements = decomposition.improvement(samples, lower)
        error = improvements.std() / np.sqrt(len(samples))
        assert abs(improvements.mean() - exact[i]) < 4.0 * error
        assert error < 0.1 * exact[i]


def test_truncated_expected_improvement_from_its_definition() -> None:
    """Samples outside [A, B] count nothing, the front is projected onto the box; all by moocore."""
    rng = np.random.default_rng(1)
    lower, upper = np.array([0.2, -0.3, 0.1]), np.array([0.9, 0.8, 1.0])
    front = rng.uniform(-0.5, 1.2, (15, 3))
    mean, stddev = np.array([0.35, 0.2, 0.4]), np.array([0.3, 0.25, 0.35])
    samples = mean + stddev * rng.standard_normal((20_000, 3))
    inside = ((samples >= lower) & (samples <= upper)).all(axis=1)
    projected = np.maximum(front[is_below(front, upper)], lower)
    before = oracle(projected, upper)
    improvements = np.zeros(len(samples))
    for i in np.flatnonzero(inside):
        improvements[i] = oracle(np.vstack([projected, samples[i]]), upper) - before
    for points in (front, projected):
        exact = BoxDecomposition(upper, points).expected_improvement([mean], [stddev], lower)[0]
        error = improvements.std() / np.sqrt(len(samples))
        assert abs(improvements.mean() - exact) < 4.0 * error


def test_truncated_improvement_is_zero_outside_the_box() -> None:
    decomposition = BoxDecomposition([1.0, 1.0], [[0.5, 0.5]])
    candidates = [[0.1, 0.1], [0.0, 0.1], [0.1, 1.0], [0.1, 0.099]]
    improvement = decomposition.improvement(candidates, lower=[0.1, 0.1])
    np.testing.assert_allclose(improvement, [0.56, 0.0, 0.0, 0.0], rtol=1e-14)


def test_wide_truncation_box_changes_nothing() -> None:
    rng = np.random.default_rng(2)
    decomposition = random_decomposition(rng, 4)
    mean, stddev = rng.random((20, 4)), rng.random((20, 4)) * 0.2
    free = decomposition.expected_improvement(mean, stddev)
    for far in (-np.inf, -1e3, -7.0):
        boxed = decomposition.expected_improvement(mean, stddev, np.full(4, far))
        np.testing.assert_allclose(boxed, free, rtol=1e-11)


def test_certain_prediction_is_the_improvement() -> None:
    rng = np.random.default_rng(3)
    decomposition = random_decomposition(rng, 5)
    mean = rng.random((50, 5))
    expected = decomposition.improvement(mean)
    for stddev in (0.0, 1e-300, 1e-15):
        found = decomposition.expected_improvement(mean, np.full_like(mean, stddev))
        np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-14)


def test_some_objectives_certain() -> None:
    rng = np.random.default_rng(4)
    decomposition = random_decomposition(rng, 3)
    mean, stddev = rng.random((10, 3)), np.tile([0.1, 0.0, 0.2], (10, 1))
    nearly = np.tile([0.1, 1e-9, 0.2], (10, 1))
    np.testing.assert_allclose(
        decomposition.expected_improvement(mean, stddev),
        decomposition.expected_improvement(mean, nearly),
        rtol=1e-5,
    )


def differences(function: Callable[[FloatArray], FloatArray], at: FloatArray) -> FloatArray:
    """Central differences of a batched function, `(m, P) -> (m, P)`."""
    gradient = np.empty_like(at)
    step = 1e-6
    for j in range(at.shape[1]):
        up, down = at.copy(), at.copy()
        up[:, j] += step
        down[:, j] -= step
        gradient[:, j] = (function(up) - function(down)) / (2.0 * step)
    return gradient


@pytest.mark.parametrize("n_objectives", range(1, 9))
@pytest.mark.parametrize("truncated", [False, True])
def test_gradients_agree_with_finite_differences(n_objectives: int, truncated: bool) -> None:
    rng = np.random.default_rng(100 * n_objectives + truncated)
    decomposition = random_decomposition(rng, n_objectives)
    lower = rng.uniform(-0.1, 0.3, n_objectives) if truncated else None
    mean = rng.uniform(-0.2, 1.3, (30, n_objectives))
    stddev = rng.uniform(0.05, 0.4, mean.shape)

    value, by_mean, by_stddev = decomposition.expected_improvement_with_gradient(
        mean, stddev, lower
    )
    np.testing.assert_allclose(
        value, decomposition.expected_improvement(mean, stddev, lower), rtol=1e-10
    )
    numeric = differences(lambda at: decomposition.expected_improvement(at, stddev, lower), mean)
    np.testing.assert_allclose(by_mean, numeric, rtol=1e-5, atol=1e-9)
    numeric = differences(lambda at: decomposition.expected_improvement(mean, at, lower), stddev)
    np.testing.assert_allclose(by_stddev, numeric, rtol=1e-5, atol=1e-9)

    value, gradient = decomposition.improvement_with_gradient(mean, lower)
    np.testing.assert_allclose(value, decomposition.improvement(mean, lower), rtol=1e-10)
    numeric = differences(lambda at: decomposition.improvement(at, lower), mean)
    np.testing.assert_allclose(gradient, numeric, rtol=1e-6, atol=1e-9)


@pytest.mark.parametrize("far", [5.0, 10.0, 20.0, 30.0])
def test_expected_improvement_keeps_its_accuracy_in_the_tails(far: float) -> None:
    """With an empty front it is a product of one-dimensional integrals, however small."""
    one = BoxDecomposition([0.0]).expected_improvement([[far]], [[1.0]])[0]
    assert one > 0.0
    two = BoxDecomposition([0.0, 0.0]).expected_improvement([[far, 2.0]], [[1.0, 1.0]])[0]
    other = BoxDecomposition([0.0]).expected_improvement([[2.0]], [[1.0]])[0]
    assert two == pytest.approx(one * other, rel=1e-12)
    dominated = BoxDecomposition([9.0, 9.0], [[0.0, 0.0]])
    value = dominated.expected_improvement([[far, far]], [[1.0, 1.0]])[0]
    right = BoxDecomposition([9.0]).expected_improvement([[far]], [[1.0]])[0]
    assert value == pytest.approx(one * (2.0 * right - one), rel=1e-10)


coordinates = st.one_of(
    st.integers(0, 5).map(float), st.floats(-1.0, 5.0, allow_nan=False, width=32)
)
point_sets = st.integers(1, 5).flatmap(
    lambda p: st.integers(1, 12).flatmap(lambda n: arrays(float, (n, p), elements=coordinates))
)


@quick
@given(point_sets)
def test_adding_a_point_never_lowers_the_hypervolume(points: FloatArray) -> None:
    decomposition = BoxDecomposition(np.full(points.shape[1], REFERENCE))
    for point in points:
        before = decomposition.hypervolume
        announced = decomposition.improvement([point])[0]
        gained = decomposition.add(point)
        assert gained >= 0.0
        assert gained == pytest.approx(announced, rel=1e-10, abs=1e-12)
        assert decomposition.hypervolume >= before
        assert decomposition.improvement([point])[0] == 0.0


@quick
@given(point_sets, st.randoms(use_true_random=False))
def test_order_does_not_matter(points: FloatArray, random: Random) -> None:
    reference = np.full(points.shape[1], REFERENCE)
    order = list(range(len(points)))
    random.shuffle(order)
    forwards, shuffled = BoxDecomposition(reference), BoxDecomposition(reference)
    for i, j in enumerate(order):
        forwards.add(points[i])
        shuffled.add(points[j])
    assert forwards.hypervolume == pytest.approx(shuffled.hypervolume, rel=1e-10)
    mean = points - 0.5
    np.testing.assert_allclose(
        forwards.improvement(mean), shuffled.improvement(mean), rtol=1e-10, atol=1e-10
    )
    stddev = np.full_like(mean, 0.3)
    np.testing.assert_allclose(
        forwards.expected_improvement(mean, stddev),
        shuffled.expected_improvement(mean, stddev),
        rtol=1e-9,
        atol=1e-12,
    )


@quick
@given(point_sets, st.floats(0.0, 2.0))
def test_dominated_candidates_gain_nothing(points: FloatArray, shift: float) -> None:
    decomposition = BoxDecomposition(np.full(points.shape[1], REFERENCE), points)
    np.testing.assert_array_equal(decomposition.improvement(points + shift), 0.0)
    expected = decomposition.expected_improvement(points + shift, np.full_like(points, 0.2))
    assert (expected >= 0.0).all()


@quick
@given(point_sets, st.lists(st.floats(-9.0, 9.0), min_size=5, max_size=5))
def test_scaling_the_objectives_scales_the_results(
    points: FloatArray, exponents: list[float]
) -> None:
    n_objectives = points.shape[1]
    scale = 10.0 ** np.array(exponents[:n_objectives])
    volume = float(np.prod(scale))
    reference = np.full(n_objectives, REFERENCE)
    plain, scaled = (
        BoxDecomposition(reference, points),
        BoxDecomposition(reference * scale, points * scale),
    )
    mean, stddev = points - 0.25, np.full_like(points, 0.5)
    assert scaled.hypervolume == pytest.approx(plain.hypervolume * volume, rel=1e-9)
    np.testing.assert_allclose(
        scaled.improvement(mean * scale),
        plain.improvement(mean) * volume,
        rtol=1e-9,
        atol=1e-12 * volume,
    )
    np.testing.assert_allclose(
        scaled.expected_improvement(mean * scale, stddev * scale),
        plain.expected_improvement(mean, stddev) * volume,
        rtol=1e-9,
    )


@pytest.mark.parametrize("points", [None, [], np.empty((0, 3)), np.full((4, 3), np.nan)])
def test_no_points(points: FloatArray | None) -> None:
    decomposition = BoxDecomposition(np.ones(3), points)
    assert decomposition.hypervolume == 0.0
    assert decomposition.n_boxes == 1
    candidates = [[0.0, 0.5, 0.5], [1.0, 0.0, 0.0]]
    np.testing.assert_allclose(decomposition.improvement(candidates), [0.25, 0.0])
    value, gradient = decomposition.improvement_with_gradient(candidates)
    np.testing.assert_allclose(value, [0.25, 0.0])
    np.testing.assert_allclose(gradient, [[-0.25, -0.5, -0.5], [0.0, 0.0, 0.0]])
    assert decomposition.improvement(np.empty((0, 3))).shape == (0,)


def test_all_points_beyond_the_reference() -> None:
    decomposition = BoxDecomposition(np.zeros(3), np.eye(3))
    assert decomposition.hypervolume == 0.0
    assert decomposition.n_boxes == 1


def test_outliers_do_not_spoil_the_hypervolume() -> None:
    """One point a million below the others, but with little volume of its own."""
    reference = np.ones(3)
    points = np.vstack([np.random.default_rng(8).random((20, 3)), [-1e6, 0.999999, 0.999999]])
    assert hypervolume(points, reference) == pytest.approx(oracle(points, reference), rel=1e-10)


@pytest.mark.parametrize(
    ("reference", "points", "message"),
    [
        (1.0, None, "reference must have shape"),
        ([], None, "reference must have shape"),
        ([1.0, np.inf], None, "reference must be finite"),
        ([1.0, np.nan], None, "reference must be finite"),
        ([1.0, 1.0], [[1.0, 2.0, 3.0]], "points must have 2 columns, not 3"),
        ([1.0, 1.0], [0.0, 0.0], "points must have shape"),
        ([1.0, 1.0], [[0.0, -np.inf]], r"^point must .* minus infinity"),
    ],
)
def test_construction_rejects(
    reference: FloatArray, points: FloatArray | None, message: str
) -> None:
    with pytest.raises(ValueError, match=message):
        BoxDecomposition(reference, points)


def test_queries_reject() -> None:
    decomposition = BoxDecomposition([1.0, 1.0])
    mean = [[0.0, 0.0]]
    with pytest.raises(ValueError, match="candidates must have 2 columns"):
        decomposition.improvement([[0.0]])
    with pytest.raises(ValueError, match=r"^candidates must .* NaN"):
        decomposition.improvement([[0.0, np.nan]])
    with pytest.raises(ValueError, match=r"^stddev must be at least 0"):
        decomposition.expected_improvement(mean, [[1.0, -1.0]])
    with pytest.raises(ValueError, match="stddev must have the shape of mean"):
        decomposition.expected_improvement(mean, [[1.0, 1.0], [1.0, 1.0]])
    with pytest.raises(ValueError, match="lower must have shape"):
        decomposition.improvement(mean, [0.0])
    with pytest.raises(ValueError, match="must lie below the reference point"):
        decomposition.improvement(mean, [0.0, 1.0])
    with pytest.raises(ValueError, match="point must have shape"):
        decomposition.add([0.0])
