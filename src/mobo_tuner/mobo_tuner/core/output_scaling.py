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


def is_constant(y: FloatArray) -> bool:
    """Return whether all outputs `(n,)` are the same, to rounding."""
    return bool(np.ptp(y) <= _ROUNDING * np.abs(y).max())


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
        x: FloatArray,
        y: FloatArray,
        *,
        offset: float | None = None,
        log: bool = False,
        mean: MeanFunction | None = None,
        mean_gradient: MeanFunction | None = None,
    ) -> OutputScaling:
        """The scaling that suits the observations x `(n, d)`, y `(n,)`; offset None: the data mean.

        Where all residuals are the same, to rounding, nothing says how much the function varies:
        their distance from the prior mean is taken, or, where that is nothing either, 1 / n of the
        outputs' magnitude.
        """
        values = np.log(y) if log else y
        if mean is not None:
            offset = 0.0
        elif offset is None:
            offset = float(np.mean(values))
        unscaled = cls(log, offset, 1.0, mean, mean_gradient)
        residuals = values - unscaled.prior_mean(x)
        magnitude = max(float(np.abs(values).max()), abs(offset))
        negligible = _ROUNDING * magnitude
        centre = float(np.mean(residuals))
        for scale in (float(np.std(residuals)), abs(centre), magnitude / len(y)):
            if scale > max(negligible, _SMALLEST_SCALE):
                return cls(log, offset, scale, mean, mean_gradient)
        return cls(log, offset, 1.0 / len(y), mean, mean_gradient)

    def prior_mean(self, x: FloatArray) -> FloatArray:
        """The prior mean m(x) at x `(m, d)`, `(m,)`, in units of t(y)."""
        if self.mean is None:
            return np.full(len(x), self.offset)
        values = np.asarray(self.mean(x), dtype=np.float64)
        if values.shape != (len(x),) or not np.isfinite(values).all():
            raise ValueError(
                f"the mean function must return {len(x)} finite values, got shape {values.shape}"
            )
        return values

    def prior_mean_gradient(self, x: FloatArray) -> FloatArray:
        """Gradient of the prior mean in x at x `(m, d)`, `(m, d)`."""
        if self.mean is None:
            return np.zeros_like(x)
        if self.mean_gradient is not None:
            gradient = np.asarray(self.mean_gradient(x), dtype=np.float64)
            if gradient.shape != x.shape or not np.isfinite(gradient).all():
                raise ValueError(
                    f"mean_gradient must return finite values {x.shape}, got shape {gradient.shape}"
                )
            return gradient
        gradient = np.empty_like(x)
        for a in range(x.shape[1]):
            step = np.zeros(x.shape[1])
            step[a] = _GRADIENT_STEP
            gradient[:, a] = (self.prior_mean(x + step) - self.prior_mean(x - step)) / (
                2.0 * _GRADIENT_STEP
            )
        return gradient

    def standardise(self, x: FloatArray, y: FloatArray) -> FloatArray:
        """Residuals z `(n,)` of the observations x `(n, d)`, y `(n,)`."""
        return ((np.log(y) if self.log else y) - self.prior_mean(x)) / self.scale

    def unstandardise(
        self, x: FloatArray, mean: FloatArray, stddev: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Mean and standard deviation of t(y) at x `(m, d)` from those of z, `(m,)` each."""
        return self.prior_mean(x) + self.scale * mean, self.scale * stddev

    def noise_variances(self, y: FloatArray, stddev: FloatArray) -> FloatArray:
        """Variances of z `(n,)` from standard deviations of y, to first order for the log."""
        unit = self.scale * np.abs(y) if self.log else self.scale
        with np.errstate(over="ignore"):
            return np.asarray(np.minimum(np.square(stddev / unit), _LARGEST_VARIANCE))

    def log_slope(self, y: FloatArray) -> FloatArray:
        """`log |dz/dy|` `(n,)`, which turns log densities of z into those of y."""
        return np.asarray(-np.log(self.scale) - (np.log(y) if self.log else np.zeros_like(y)))

    def to_output(self, mean: FloatArray, stddev: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Mean and standard deviation of y, each `(m,)`, from those of t(y), mu and s.

        Under the logarithm, the Gaussian that shares the log-normal's median and its quantile one
        standard deviation below: `exp(mu)` and `exp(mu) (1 - exp(-s))`. An acquisition function of
        a minimised y looks at that side: expected improvements are right to a fifth for
        s up to 0.6 and targets down to half a standard deviation below the median, where a Gaussian
        with the log-normal's mean and variance, swollen by its upper tail, is wrong without limit
        (by a factor of 6 at s = 1, of 3000 at s = 2.5). The probability
        to exceed a limit comes out too low: do not transform what has an upper limit to keep.
        """
        if not self.log:
            return mean, stddev
        median = np.exp(np.minimum(mean, _LARGEST_EXPONENT))
        return median, -median * np.expm1(-stddev)

    def gradients_to_output(
        self,
        mean: FloatArray,
        stddev: FloatArray,
        mean_gradient: FloatArray,
        stddev_gradient: FloatArray,
    ) -> tuple[FloatArray, FloatArray]:
        """Gradients in x of `to_output`, each `(m, d)`, from those of its arguments."""
        if not self.log:
            return mean_gradient, stddev_gradient
        median, spread = self.to_output(mean, stddev)
        lower = (median - spread)[:, None]
        return (
            median[:, None] * mean_gradient,
            spread[:, None] * mean_gradient + lower * stddev_gradient,
        )
