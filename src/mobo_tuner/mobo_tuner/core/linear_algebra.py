"""Linear algebra of the models: one BLAS thread, a Cholesky factor that does not fail.

Small matrices (n of a few hundred) are slower with several BLAS threads than with one, and far
slower if the cores are busy. Therefore every model runs its linear algebra in `single_blas_thread`.
"""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache

import numpy as np
from scipy.linalg import lapack
from threadpoolctl import ThreadpoolController

from mobo_tuner.core.arrays import FloatArray

_FIRST_JITTER = 1e-10
_LAST_JITTER = 1e2


_entered = threading.local()


@cache
def _controller() -> ThreadpoolController:
    # Finds the libraries once; finding them takes longer than a typical block.
    return ThreadpoolController()


@contextmanager
def single_blas_thread() -> Iterator[None]:
    """Run the block with one BLAS thread; blocks may be nested.

    The outermost entry takes about 20 microseconds, an inner one less than 1: enter it once around
    many small predictions. The limit applies to the whole process, and the thread that entered
    first removes it: a caller that uses other threads must enter before them and leave after them.
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
    """Return the lower Cholesky factor of a symmetric positive semi-definite matrix.

    Jitter is added to the diagonal if needed. O(n^3 / 3).

    Args:
        matrix: Symmetric finite matrix `(n, n)`; only its upper triangle is read; not modified.

    Returns:
        The factor `(n, n)` of `matrix + jitter I` in Fortran order with zeros above the diagonal,
        and the jitter: 0 if the matrix is positive definite in floating point, else 1e-10 of the
        mean diagonal, multiplied by ten until the factorisation succeeds.

    Raises:
        ValueError: If a value of the matrix is not finite, or the matrix is far from positive
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
    """Return the inverse of a lower triangular matrix `(n, n)`, in Fortran order; O(n^3 / 3)."""
    inverse, info = lapack.dtrtri(factor, lower=1)
    if info != 0:
        raise ValueError(f"the triangular factor is singular at row {info}")
    return np.asfortranarray(inverse)


def inverse_lower(factor: FloatArray) -> FloatArray:
    """Return the lower triangle of `(L L^T)^-1` for a Cholesky factor L; O(2 n^3 / 3)."""
    inverse, info = lapack.dpotri(factor, lower=1)
    if info != 0:
        raise ValueError(f"the triangular factor is singular at row {info}")
    return np.asfortranarray(inverse)
