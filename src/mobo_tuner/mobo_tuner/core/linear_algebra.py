"""Linear algebra of the models: one BLAS thread, a Cholesky factor that does not fail.

Small matrices (n of a few hundred) are slower on several BLAS threads than on one, and far slower
when the cores are busy; therefore every model runs its linear algebra inside `single_blas_thread`.
"""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import lapack
from threadpoolctl import ThreadpoolController

FloatArray = NDArray[np.float64]

_FIRST_JITTER = 1e-10
_LAST_JITTER = 1e2


class _BlasThreadLimit:
    """A limit shared by all threads: set by the first to enter, lifted by the last to leave."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._depth = 0
        self._controller = ThreadpoolController()
        self._limiter = None

    def enter(self) -> None:
        with self._lock:
            if self._depth == 0:
                self._limiter = self._controller.limit(limits=1, user_api="blas")
            self._depth += 1

    def leave(self) -> None:
        with self._lock:
            self._depth -= 1
            if self._depth == 0 and self._limiter is not None:
                self._limiter.restore_original_limits()
                self._limiter = None


@cache
def _blas_thread_limit() -> _BlasThreadLimit:
    return _BlasThreadLimit()


@contextmanager
def single_blas_thread() -> Iterator[None]:
    """Run the block with one BLAS thread; may be nested and entered from several threads.

    The outermost entry costs about 15 microseconds, an inner one less than 1: a caller of many
    small predictions
    holds it around all of them.
    """
    limit = _blas_thread_limit()
    limit.enter()
    try:
        yield
    finally:
        limit.leave()


def cholesky(matrix: FloatArray) -> tuple[FloatArray, float]:
    """Lower Cholesky factor of a symmetric positive semi-definite matrix, with jitter as needed.

    Args:
        matrix: `(n, n)` symmetric and finite; not modified.

    Returns:
        The factor `(n, n)` of `matrix + jitter I` in Fortran order with zeros above the diagonal,
        and the jitter: 0 where the matrix is positive definite in floating point, else 1e-10 of the
        mean diagonal, times ten until the factorisation succeeds. O(n^3 / 3).

    Raises:
        ValueError: the matrix has a value that is not finite, or is far from positive
            semi-definite.
    """
    factor, info = lapack.dpotrf(matrix.T, lower=1, clean=1)
    if info == 0:
        return factor, 0.0
    scale = float(np.mean(np.abs(np.diagonal(matrix)))) or 1.0
    if not np.isfinite(matrix).all():
        raise ValueError("the covariance matrix has a value that is not finite")
    relative = _FIRST_JITTER
    while relative <= _LAST_JITTER:
        jittered = matrix.copy()
        jittered.flat[:: len(matrix) + 1] += relative * scale
        factor, info = lapack.dpotrf(jittered.T, lower=1, clean=1, overwrite_a=1)
        if info == 0:
            return factor, relative * scale
        relative *= 10.0
    raise ValueError("the covariance matrix is not positive semi-definite")


def inverse_triangle(factor: FloatArray) -> FloatArray:
    """Inverse of a lower triangular matrix `(n, n)`, zeros above, Fortran order; O(n^3 / 3)."""
    inverse, info = lapack.dtrtri(factor, lower=1)
    if info != 0:
        raise ValueError(f"the triangular factor is singular at row {info}")
    return np.asfortranarray(inverse)


def inverse_lower(factor: FloatArray) -> FloatArray:
    """Lower triangle of `(L L^T)^-1`, zeros above, for a Cholesky factor L; O(2 n^3 / 3)."""
    inverse, info = lapack.dpotri(factor, lower=1)
    if info != 0:
        raise ValueError(f"the triangular factor is singular at row {info}")
    return np.asfortranarray(inverse)
