"""Pareto dominance between points in objective space, everything minimised.

A point p dominates q when p_j <= q_j in every objective and p_j < q_j in at least one.

NaN: a row with any NaN is a failed evaluation. It neither dominates nor counts as non-dominated.
Infinities are ordinary values. Of exact duplicates the first row counts and the others do not.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mobo_tuner.core.arrays import FloatArray, as_points
from mobo_tuner.core.compilation import compiled

BoolArray = NDArray[np.bool_]
CountArray = NDArray[np.int64]


def is_nondominated(points: ArrayLike) -> BoolArray:
    """Mark the Pareto front of a set of points.

    Args:
        points: Points `(n, P)`, minimised; see the module's docstring for NaN and duplicates.

    Returns:
        Whether each point is on the front `(n,)`.

    Raises:
        ValueError: If `points` is not two-dimensional.

    Complexity: O(k n P) time for at most k points on the front of the first ones, O(n P) memory.

    Example:
        >>> is_nondominated([[1.0, 3.0], [2.0, 2.0], [2.0, 4.0], [3.0, 1.0]])
        array([ True,  True, False,  True])
    """
    return _nondominated(as_points(points, "points"))


@compiled
def _nondominated(points: FloatArray) -> BoolArray:
    """Mark the Pareto front of points `(n, P)`, one point after the other."""
    n, n_objectives = points.shape
    mask = np.zeros(n, np.bool_)
    front = np.empty(n, np.int64)  # rows of the front of the points so far
    size = 0
    for i in range(n):
        dominated = False
        for j in range(n_objectives):
            if np.isnan(points[i, j]):
                dominated = True
        kept = 0
        for k in range(size):
            if dominated:
                break
            no_worse = no_better = True  # than the other point, in any objective
            for j in range(n_objectives):
                if points[i, j] > points[front[k], j]:
                    no_worse = False
                elif points[i, j] < points[front[k], j]:
                    no_better = False
                if not (no_worse or no_better):
                    break
            if no_better:
                dominated = True  # so it dominates no other, and none was removed
            elif not no_worse:
                front[kept] = front[k]
                kept += 1
        if not dominated:
            front[kept] = i
            size = kept + 1
    for k in range(size):
        mask[front[k]] = True
    return mask


def count_nondominated(draws: ArrayLike) -> CountArray:
    """Count in how many of several sets each point is on the Pareto front.

    Args:
        draws: Sets of points `(s, n, P)`, minimised.

    Returns:
        Number of sets `(n,)`; complexity as for `is_nondominated`, for each set.

    Example:
        >>> count_nondominated([[[1.0], [2.0]], [[3.0], [2.0]], [[1.0], [0.0]]])
        array([1, 2])
    """
    return _counts(np.require(draws, np.float64, ["C", "A", "W"]))


@compiled
def _counts(draws: FloatArray) -> CountArray:
    counts = np.zeros(draws.shape[1], np.int64)
    for s in range(len(draws)):
        mask = _nondominated(draws[s])
        for i in range(len(counts)):
            counts[i] += mask[i]
    return counts


def is_below(points: ArrayLike, reference: ArrayLike) -> BoolArray:
    """Mark the points strictly below the reference point in every objective, `(n, P) -> (n,)`.

    Only these contribute to a hypervolume. A row with NaN is never below.
    """
    reference = np.asarray(reference, dtype=np.float64)
    mask: BoolArray = np.all(as_points(points, "points", len(reference)) < reference, axis=1)
    return mask


def pareto_front(points: ArrayLike, reference: ArrayLike) -> FloatArray:
    """Return the non-dominated points strictly below the reference point, `(n, P) -> (k, P)`.

    Example:
        >>> pareto_front([[1.0, 3.0], [2.0, 2.0], [2.0, 4.0], [3.0, 1.0]], [4.0, 3.0])
        array([[2., 2.],
               [3., 1.]])
    """
    points = as_points(points, "points", len(np.asarray(reference)))
    below = points[is_below(points, reference)]
    return below[is_nondominated(below)]
