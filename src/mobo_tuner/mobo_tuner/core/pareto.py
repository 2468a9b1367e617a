"""Pareto dominance between points in objective space, everything minimised.

A point p dominates q when p_j <= q_j in every objective and p_j < q_j in at least one.

NaN: a row with any NaN is a failed evaluation. It neither dominates nor counts as non-dominated.
Infinities are ordinary values. Of exact duplicates the first row counts and the others do not.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]


def as_points(values: ArrayLike, name: str, n_objectives: int | None = None) -> FloatArray:
    """Return `values` as a contiguous, writable float64 array `(n, P)`, copied only if necessary.

    So the compiled kernels get one kind of array and are compiled once.

    Args:
        values: Points; an empty sequence becomes `(0, P)` if `n_objectives` is given.
        name: Name of the argument, for errors.
        n_objectives: Number of objectives P, or None for any.

    Raises:
        ValueError: If `values` is not two-dimensional or does not have `n_objectives` columns.
    """
    points = np.require(values, np.float64, ["C", "A", "W"])
    if points.size == 0 and n_objectives is not None:
        return np.empty((0, n_objectives))
    if points.ndim != 2 or points.shape[1] == 0:
        raise ValueError(f"{name} must have shape (n, P) with P >= 1, not {points.shape}")
    if n_objectives is not None and points.shape[1] != n_objectives:
        raise ValueError(f"{name} must have {n_objectives} columns, not {points.shape[1]}")
    return points


def is_nondominated(points: ArrayLike) -> BoolArray:
    """Mark the Pareto front of a set of points.

    Args:
        points: Points `(n, P)`, minimised; see the module's docstring for NaN and duplicates.

    Returns:
        Whether each point is on the front `(n,)`.

    Raises:
        ValueError: If `points` is not two-dimensional.

    Complexity: O(k n P) time for k points on the front, O(n P) memory.

    Example:
        >>> is_nondominated([[1.0, 3.0], [2.0, 2.0], [2.0, 4.0], [3.0, 1.0]])
        array([ True,  True, False,  True])
    """
    points = as_points(points, "points")
    mask = np.zeros(len(points), dtype=np.bool_)
    valid = np.flatnonzero(~np.isnan(points).any(axis=1))
    # In lexicographic order a point is only ever dominated by an earlier one, and the sort is
    # stable, so a point that weakly dominates a later one removes it, including duplicates.
    remaining = valid[np.lexsort(points[valid].T[::-1])]
    while len(remaining):
        first = remaining[0]
        mask[first] = True
        remaining = remaining[1:]
        remaining = remaining[(points[remaining] < points[first]).any(axis=1)]
    return mask


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
