"""Proximal biasing: a factor that prefers candidates near the current set-point."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from mobo_tuner.core.acquisition import AcquisitionFunction, Predictions
from mobo_tuner.core.arrays import FloatArray

_SAME = 1e-6  # largest difference of one choice and itself


class ProximalBiasing(AcquisitionFunction):
    """exp(-1/2 (x - x_0)^T Lambda (x - x_0)), `[Roussel2021]_` Eq. (10) (eqn:restricted_acq)."""

    def __init__(
        self, center: ArrayLike, precision: ArrayLike, unordered: Sequence[bool] = ()
    ) -> None:
        """Set the current point and the cost of leaving it.

        Args:
            center: Current normalised set-point x_0 `(d,)`.
            precision: Precision matrix Lambda in normalised space, in which each variable has a
                range of 2: one number for all variables, the diagonal `(d,)`, or the full matrix
                `(d, d)`, symmetric and positive semi-definite.
            unordered: Which variables have no order: any change of one counts as half its range. Empty = none.

        Raises:
            ValueError: If a shape is wrong, a value is not finite or Lambda is not positive
                semi-definite.
        """
        self._center = np.array(center, dtype=np.float64)
        if self._center.ndim != 1 or not np.isfinite(self._center).all():
            raise ValueError(f"center must be finite and of shape (d,), not {self._center}")
        self._precision = _as_matrix(precision, len(self._center))
        self._unordered = np.flatnonzero(unordered)

    def log_value_from(self, predictions: Predictions) -> FloatArray:
        """Return the logarithm of the factor, `(m,)`."""
        return self.log_value_with_gradient_from(predictions)[0]

    def log_value_with_gradient_from(
        self, predictions: Predictions
    ) -> tuple[FloatArray, FloatArray]:
        """Return the logarithm of the factor, `(m,)`, and its gradient, `(m, d)`."""
        if predictions.inputs.shape[1] != len(self._center):
            raise ValueError(
                f"inputs must have {len(self._center)} columns, not {predictions.inputs.shape[1]}"
            )
        step = predictions.inputs - self._center
        for j in self._unordered:
            step[:, j] = np.abs(step[:, j]) > _SAME
        pull = -step @ self._precision
        value = 0.5 * (step * pull).sum(axis=1)
        pull[:, self._unordered] = 0.0
        return value, pull


def _as_matrix(precision: ArrayLike, n_variables: int) -> FloatArray:
    matrix = np.array(precision, dtype=np.float64)
    if not np.isfinite(matrix).all():
        raise ValueError(f"precision must be finite, not {matrix}")
    if matrix.ndim == 0:
        matrix = np.full(n_variables, float(matrix))
    if matrix.ndim == 1:
        matrix = np.diag(matrix)
    if matrix.shape != (n_variables, n_variables):
        raise ValueError(
            f"precision must be a number or have shape ({n_variables},) or "
            f"({n_variables}, {n_variables}), not {np.shape(precision)}"
        )
    if not np.allclose(matrix, matrix.T, rtol=1e-9, atol=0.0):
        raise ValueError(f"precision must be symmetric, not {matrix}")
    eigenvalues = np.linalg.eigvalsh(matrix)
    if eigenvalues[0] < -1e-9 * max(eigenvalues[-1], 0.0):
        raise ValueError(
            f"precision must be positive semi-definite; its lowest eigenvalue is {eigenvalues[0]}"
        )
    return 0.5 * (matrix + matrix.T)
