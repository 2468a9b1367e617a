"""Arrays of numbers, as the whole core passes them around.

Without compiled code, so that what needs no more than these, as a check of settings, starts quickly.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

FloatArray = NDArray[np.float64]


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
