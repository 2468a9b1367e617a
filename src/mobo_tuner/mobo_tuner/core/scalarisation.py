"""Several objectives as one: the weighted sum, for comparisons and for tuning around a point."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from mobo_tuner.core.acquisition import Model
from mobo_tuner.core.arrays import FloatArray


class WeightedSum:
    """A model of sum_p w_p f_p for independent objectives f_p; itself a `Model`.

    The sum of independent normal distributions is normal: means add with the weights, variances
    with their squares. With it, single-objective acquisition functions can be used for several
    objectives.
    """

    def __init__(self, models: Sequence[Model], weights: ArrayLike) -> None:
        """Set models and weights.

        Args:
            models: Models of the P minimised objectives.
            weights: Weights `(P,)`, at least zero and not all zero, in the inverse of the
                objectives' units.

        Raises:
            ValueError: If the weights are not allowed.
        """
        self._models = tuple(models)
        self._weights = np.array(weights, dtype=np.float64)
        if self._weights.shape != (len(self._models),):
            raise ValueError(
                f"weights must have shape ({len(self._models)},), not {self._weights.shape}"
            )
        usable = np.isfinite(self._weights).all() and (self._weights >= 0.0).all()
        if not usable or not self._weights.any():
            raise ValueError(
                f"weights must be finite, at least 0 and not all 0, not {self._weights}"
            )

    def predict(self, X: FloatArray) -> tuple[FloatArray, FloatArray]:  # noqa: N803
        """Return mean and standard deviation of the sum, `(m, d) -> (m,), (m,)`."""
        mean = np.zeros(len(X))
        variance = np.zeros(len(X))
        for weight, model in zip(self._weights, self._models, strict=True):
            each_mean, each_stddev = model.predict(X)
            mean += weight * each_mean
            variance += (weight * each_stddev) ** 2
        return mean, np.sqrt(variance)

    def predict_with_gradient(
        self,
        X: FloatArray,  # noqa: N803
    ) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Return mean, standard deviation `(m,)` and their gradients `(m, d)`."""
        mean = np.zeros(len(X))
        variance = np.zeros(len(X))
        mean_gradient = np.zeros(X.shape)
        half_variance_gradient = np.zeros(X.shape)
        for weight, model in zip(self._weights, self._models, strict=True):
            each = model.predict_with_gradient(X)
            mean += weight * each[0]
            variance += (weight * each[1]) ** 2
            mean_gradient += weight * each[2]
            half_variance_gradient += weight**2 * each[1][:, None] * each[3]
        stddev = np.sqrt(variance)
        divisor = np.where(stddev > 0.0, stddev, 1.0)[:, None]
        return mean, stddev, mean_gradient, half_variance_gradient / divisor
