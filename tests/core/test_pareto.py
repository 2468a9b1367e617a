"""Pareto utilities against a direct definition and moocore."""

from __future__ import annotations

import moocore
import numpy as np
import pytest

from mobo_tuner.core.arrays import FloatArray
from mobo_tuner.core.pareto import (
    BoolArray,
    count_nondominated,
    is_below,
    is_nondominated,
    pareto_front,
)


def by_definition(points: FloatArray) -> BoolArray:
    """The definition, row by row: slow and obvious."""
    mask = np.zeros(len(points), dtype=bool)
    for i, p in enumerate(points):
        if np.isnan(p).any():
            continue
        dominated = any((q <= p).all() and (q < p).any() for q in points)
        repeated = any((q == p).all() for q in points[:i])
        mask[i] = not dominated and not repeated
    return mask


@pytest.mark.parametrize("n_objectives", range(1, 8))
def test_front_follows_the_definition(n_objectives: int) -> None:
    rng = np.random.default_rng(n_objectives)
    for _ in range(30):
        points = rng.integers(0, 4, (rng.integers(0, 30), n_objectives)).astype(float)
        points[rng.random(points.shape) < 0.03] = np.nan
        points[rng.random(points.shape) < 0.03] = np.inf
        np.testing.assert_array_equal(is_nondominated(points), by_definition(points))


def test_front_agrees_with_moocore() -> None:
    rng = np.random.default_rng(0)
    points = rng.random((2000, 4))
    np.testing.assert_array_equal(is_nondominated(points), moocore.is_nondominated(points))


def test_points_are_counted_over_several_sets() -> None:
    draws = np.random.default_rng(1).integers(0, 5, (20, 12, 3)).astype(float)
    counts = np.sum([moocore.is_nondominated(draw) for draw in draws], axis=0)
    np.testing.assert_array_equal(count_nondominated(draws), counts)
    assert count_nondominated(np.empty((5, 0, 3))).shape == (0,)


def test_first_of_duplicates_counts() -> None:
    points = [[1.0, 2.0], [0.0, 3.0], [1.0, 2.0], [-0.0, 3.0]]
    np.testing.assert_array_equal(is_nondominated(points), [True, True, False, False])


def test_nan_neither_dominates_nor_counts() -> None:
    points = [[np.nan, -9.0], [1.0, 1.0]]
    np.testing.assert_array_equal(is_nondominated(points), [False, True])


def test_no_points() -> None:
    assert is_nondominated(np.empty((0, 3))).shape == (0,)
    assert pareto_front(np.empty((0, 3)), np.ones(3)).shape == (0, 3)
    assert pareto_front([], np.ones(3)).shape == (0, 3)


def test_many_points_need_little_memory() -> None:
    rng = np.random.default_rng(3)
    points = np.abs(rng.standard_normal((2000, 7)))
    points /= np.linalg.norm(points, axis=1, keepdims=True)
    assert is_nondominated(points).all()


def test_below_is_strict() -> None:
    points = [[0.0, 0.0], [1.0, 0.0], [0.0, 2.0], [np.nan, 0.0], [-np.inf, 0.0]]
    np.testing.assert_array_equal(is_below(points, [1.0, 1.0]), [True, False, False, False, True])


def test_front_leaves_out_what_is_not_below_the_reference() -> None:
    points = [[0.5, 0.5], [0.0, 1.0], [0.6, 0.6], [0.9, 0.1]]
    np.testing.assert_array_equal(pareto_front(points, [1.0, 1.0]), [[0.5, 0.5], [0.9, 0.1]])


@pytest.mark.parametrize("points", [[1.0, 2.0], np.zeros((2, 2, 2)), np.zeros((2, 0))])
def test_wrong_shape(points: FloatArray) -> None:
    with pytest.raises(ValueError, match="points must have shape"):
        is_nondominated(points)


def test_wrong_number_of_objectives() -> None:
    with pytest.raises(ValueError, match="points must have 3 columns, not 2"):
        pareto_front([[1.0, 2.0]], np.ones(3))
