"""Between an output in its own units and the standardised residual a Gaussian process works on."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mobo_tuner.core.gaussian_process_settings import MeanFunction
from mobo_tuner.core.linear_algebra import FloatArray

_ROUNDING = 1e-12
_GRADIENT_STEP = 1e-5
_LARGEST_EXPONENT = 600.0
_SMALLEST_SCALE = 1e-150
_LARGEST_VARIANCE = 1e100


@dataclass(frozen=True)
class OutputScaling:
    """`z = (t(y) - m(x)) / scale`, with t the identity or the logarithm and m the prior mean.

    Attributes:
        log: t is the logarithm.
        offset: the prior mean where it is a constant, in units of t(y).
        scale: standard deviation of `t(y) - m(x)` over the observations, positive.
        mean: the prior mean where it is a function of the inputs `(n, d) -> (n,)`; offset is 0
            then.
        mean_gradient: its gradient `(m, d) -> (m, d)`; central differences without it.
    """

    log: bool
    offset: float
    scale: float
    mean: MeanFunction | None = None
    mean_gradient: MeanFunction | None = None

    @classmethod
    def of(
        cls,
        X: FloatArray,
        y: FloatArray,
        *,
        offset: float | None = None,
        log: bool = False,
        mean: MeanFunction | None = None,
        mean_gradient: MeanFunction | None = None,
    ) -> OutputScaling:
        """The scaling that suits the observations X `(n, d)`, y `(n,)`; offset None: the data mean.

        Where all residuals are the same, to rounding, nothing says how much the function varies:
        their distance from
        the prior mean is taken, or, where that is nothing either, 1 / n of the outputs' magnitude.
        """
        values = np.log(y) if log else y
        if mean is not None:
            offset = 0.0
        elif offset is None:
            offset = float(np.mean(values))
        unscaled = cls(log, offset, 1.0, mean, mean_gradient)
        residuals = values - unscaled.prior_mean(X)
        magnitude = max(float(np.abs(values).max()), abs(offset))
        negligible = _ROUNDING * magnitude
        centre = float(np.mean(residuals))
        for scale in (float(np.std(residuals)), abs(centre), magnitude / len(y)):
            if scale > max(negligible, _SMALLEST_SCALE):
                return cls(log, offset, scale, mean, mean_gradient)
        return cls(log, offset, 1.0 / len(y), mean, mean_gradient)

    def prior_mean(self, X: FloatArray) -> FloatArray:
        """The prior mean m(x) at X `(m, d)`, `(m,)`, in units of t(y)."""
        if self.mean is None:
            return np.full(len(X), self.offset)
        values = np.asarray(self.mean(X), dtype=np.float64)
        if values.shape != (len(X),) or not np.isfinite(values).all():
            raise ValueError(
                f"the mean function must return {len(X)} finite values, got shape {values.shape}"
            )
        return values

    def prior_mean_gradient(self, X: FloatArray) -> FloatArray:
        """Gradient of the prior mean in x at X `(m, d)`, `(m, d)`."""
        if self.mean is None:
            return np.zeros_like(X)
        if self.mean_gradient is not None:
            gradient = np.asarray(self.mean_gradient(X), dtype=np.float64)
            if gradient.shape != X.shape or not np.isfinite(gradient).all():
                raise ValueError(
                    f"mean_gradient must return finite values of shape {X.shape}, got {gradient.shape}"
                )
            return gradient
        gradient = np.empty_like(X)
        for a in range(X.shape[1]):
            step = np.zeros(X.shape[1])
            step[a] = _GRADIENT_STEP
            gradient[:, a] = (self.prior_mean(X + step) - self.prior_mean(X - step)) / (
                2.0 * _GRADIENT_STEP
            )
        return gradient

    def standardise(self, X: FloatArray, y: FloatArray) -> FloatArray:
        """Residuals z `(n,)` of the observations X `(n, d)`, y `(n,)`."""
        return ((np.log(y) if self.log else y) - self.prior_mean(X)) / self.scale

    def unstandardise(
        self, X: FloatArray, mean: FloatArray, stddev: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Mean and standard deviation of t(y) at X `(m, d)` from those of z, `(m,)` each."""
        return self.prior_mean(X) + self.scale * mean, self.scale * stddev

    def noise_variances(self, y: FloatArray, stddev: FloatArray) -> FloatArray:
        """Variances of z `(n,)` from standard deviations of y; to first order under the logarithm."""
        relative = stddev / (np.abs(y) if self.log else 1.0) / self.scale
        return np.minimum(relative * relative, _LARGEST_VARIANCE)

    def log_slope(self, y: FloatArray) -> FloatArray:
        """`log |dz/dy|` `(n,)`, which turns log densities of z into those of y."""
        return -np.log(self.scale) - (np.log(y) if self.log else np.zeros_like(y))

    def moments(self, mean: FloatArray, stddev: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Mean and standard deviation of y, each `(m,)`, from those of t(y).

        Under the logarithm they are the log-normal's, `exp(mu + s^2 / 2)` and that times
        `sqrt(exp(s^2) - 1)`, so that an acquisition function that takes them for a Gaussian's has
        the first two moments right.
        """
        if not self.log:
            return mean, stddev
        variance = np.clip(stddev * stddev, 0.0, _LARGEST_EXPONENT / 2.0)
        centre = np.exp(np.minimum(mean + 0.5 * variance, _LARGEST_EXPONENT / 2.0))
        return centre, centre * np.sqrt(np.expm1(variance))

    def moment_gradients(
        self,
        mean: FloatArray,
        stddev: FloatArray,
        mean_gradient: FloatArray,
        stddev_gradient: FloatArray,
    ) -> tuple[FloatArray, FloatArray]:
        """Gradients in x of `moments`, each `(m, d)`, from those of the mean and standard deviation of t(y)."""
        if not self.log:
            return mean_gradient, stddev_gradient
        centre, _ = self.moments(mean, stddev)
        variance = np.clip(stddev * stddev, 0.0, _LARGEST_EXPONENT / 2.0)
        centre_gradient = centre[:, None] * (mean_gradient + stddev[:, None] * stddev_gradient)
        ratio = np.sqrt(np.expm1(variance))
        ratio_slope = np.where(
            ratio > 0.0, stddev * np.exp(variance) / np.maximum(ratio, 1e-150), 1.0
        )
        return centre_gradient, ratio[:, None] * centre_gradient + (centre * ratio_slope)[
            :, None
        ] * stddev_gradient
