"""A smooth model with exact gradients, in place of a Gaussian process."""

from __future__ import annotations

import numpy as np

from mobo_tuner.core.arrays import FloatArray


class AnalyticModel:
    """A bowl with a ripple; the standard deviation is an exponential of a linear function."""

    def __init__(
        self, n_variables: int, seed: int, stddev: float = 0.3, scale: float = 1.0
    ) -> None:
        rng = np.random.default_rng(seed)
        self.center = rng.uniform(-0.7, 0.7, n_variables)
        self.slope = rng.uniform(-0.5, 0.5, n_variables)
        self.wave = rng.uniform(-2.0, 2.0, n_variables)
        self.stddev = stddev
        self.scale = scale
        self.calls = 0

    def predict(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        return self.predict_with_gradient(x)[:2]

    def predict_with_gradient(
        self, x: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        self.calls += 1
        step = x - self.center
        mean = (step**2).mean(axis=1) + 0.2 * np.sin(x @ self.wave)
        mean_gradient = (
            2.0 * step / len(self.center) + 0.2 * np.cos(x @ self.wave)[:, None] * self.wave
        )
        stddev = self.stddev * np.exp(x @ self.slope)
        stddev_gradient = stddev[:, None] * self.slope
        s = self.scale
        return s * mean, s * stddev, s * mean_gradient, s * stddev_gradient
