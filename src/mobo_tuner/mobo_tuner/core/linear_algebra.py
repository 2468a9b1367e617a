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


_entered = threading.local()


@cache
def _controller() -> ThreadpoolController:
    # Looks for the libraries once, which takes longer than what it is used around.
    return ThreadpoolController()


@contextmanager
def single_blas_thread() -> Iterator[None]:
    """Run the block with one BLAS thread; may be nested.

    The outermost entry costs about 20 microseconds, an inner one less than 1: a caller of many
    small predictions holds it around all of them. The limit is the whole process', and the thread
    that entered first lifts it: who hands work to other threads enters before they do and leaves
    after them.
    """
    if getattr(_entered, "inside", False):
        yield
        return
    _entered.inside = True
    try:
        with _controller().limit(limits=1, user_api="blas"):
            yield
    finally:
        _entered.inside = False


def cholesky(matrix: FloatArray) -> tuple[FloatArray, float]:
    """Lower Cholesky factor of a symmetric positive semi-definite matrix, with jitter as needed.

    Args:
        matrix: `(n, n)` symmetric and finite; only its upper triangle is read; not modified.

    Returns:
        The factor `(n, n)` of `matrix + jitter I` in Fortran order with zeros above the diagonal,
        and the jitter: 0 where the matrix is positive definite in floating point, else 1e-10 of the
        mean diagonal, times ten until the factorisation succeeds. O(n^3 / 3).

    Raises:
        ValueError: the matrix has a value that is not finite, or is far from positive
            semi-definite.
    """
    factor, info = lapack.dpotrf(matrix.T, lower=1, clean=1)
    if not np.isfinite(np.diagonal(factor)).all() or (info and not np.isfinite(matrix).all()):
        raise ValueError("the covariance matrix has a value that is not finite")
    if info == 0:
        return factor, 0.0
    scale = float(np.mean(np.abs(np.diagonal(matrix)))) or 1.0
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
