"""Scaling of an output in its own units to the standardised residual that a Gaussian process models."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, Self

import numpy as np

from mobo_tuner.core.gaussian_process_settings import MeanFunction
from mobo_tuner.core.linear_algebra import FloatArray

LARGEST_OUTPUT = 1e100
"""Largest magnitude of an output."""
_ROUNDING = 1e-12
_EXACT = 1e-9
_GRADIENT_STEP = 1e-5
_LARGEST_EXPONENT = 600.0
_SMALLEST_SCALE = 1e-150
_LARGEST_VARIANCE = 1e100
_LEAST_DEPTH = 1e-300
_HEAVY = 10.0


def is_constant(y: FloatArray) -> bool:
    """Return whether all outputs `(n,)` are the same, to rounding."""
    return bool(np.ptp(y) <= _ROUNDING * np.abs(y).max())


def has_heavy_tail(y: FloatArray) -> bool:
    """Return whether outputs `(n,)` are positive and so unequal that their logarithm may say more.

    They are if the largest one is far from the median, compared with the least one: by as much as where
    the logarithms of two decades are evenly spread.
    """
    least, median, most = float(y.min()), float(np.median(y)), float(y.max())
    return least > 0.0 and most - median > _HEAVY * (median - least)


@dataclass(frozen=True)
class OutputScaling:
    """`z = (t(y) - m(x)) / scale`, with t the identity or the logarithm and m the prior mean.

    The prior mean is `m(x) = offset + factor * mean(x)`, or `offset` alone without a function.

    Attributes:
        log: Whether t is the logarithm.
        offset: Constant part of the prior mean, in units of t(y).
        scale: Standard deviation of `t(y) - m(x)` over the observations, positive.
        mean: Function of the inputs `(n, d) -> (n,)`, if there is one.
        mean_gradient: Gradient of `mean` `(m, d) -> (m, d)`; by default central differences.
        factor: Factor of `mean`.
        low: Logarithm of a low output, of which `to_output` keeps the probability; infinite for none.
    """

    log: bool
    offset: float
    scale: float
    mean: MeanFunction | None = None
    mean_gradient: MeanFunction | None = None
    factor: float = 1.0
    low: float = math.inf

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
        scaled: bool = False,
        low: float = math.inf,
    ) -> OutputScaling:
        """Return the scaling that suits observations.

        If all residuals are the same, to rounding, nothing shows how much the function varies: the
        scale is then their distance from the prior mean or, if that is zero too, 1 / n of the outputs'
        magnitude.

        Args:
            x: Normalised inputs `(n, d)`.
            y: Outputs `(n,)`.
            offset: Constant prior mean, in units of t(y); None for the mean of the data.
            log: Whether t is the logarithm.
            mean: Function whose best offset from the outputs is the prior mean, in place of `offset`.
            mean_gradient: Gradient of `mean`.
            scaled: Whether the best factor of `mean` is taken, too.
            low: Logarithm of a low output, see the attribute.
        """
        values = np.log(y) if log else y
        factor = 1.0
        if mean is not None:
            predicted = cls(log, 0.0, 1.0, mean).prior_mean(x)
            if scaled:
                variance = float(np.var(predicted))
                agreement = float(np.mean((predicted - predicted.mean()) * values))
                factor = agreement / variance if variance > 0.0 else 1.0
            offset = float(np.mean(values - factor * predicted))
        elif offset is None:
            offset = float(np.mean(values))
        unscaled = cls(log, offset, 1.0, mean, mean_gradient, factor, low)
        residuals = values - unscaled.prior_mean(x)
        magnitude = max(float(np.abs(values).max()), abs(offset))
        negligible = _ROUNDING * magnitude
        centre = float(np.mean(residuals))
        for scale in (float(np.std(residuals)), abs(centre), magnitude / len(y)):
            if scale > max(negligible, _SMALLEST_SCALE):
                return replace(unscaled, scale=scale)
        return replace(unscaled, scale=1.0 / len(y))

    def get_state(self) -> dict[str, Any]:
        """Return what `from_state` needs beside the prior mean, as data for JSON."""
        return {
            "log": self.log,
            "offset": self.offset,
            "scale": self.scale,
            "factor": self.factor,
            "low": self.low if self.log else None,
        }

    @classmethod
    def from_state(
        cls,
        state: Mapping[str, Any],
        mean: MeanFunction | None,
        mean_gradient: MeanFunction | None,
    ) -> Self:
        """Return the scaling that `get_state` came from, given its prior mean again.

        Raises:
            ValueError: If a number is out of range.
        """
        offset, scale = state["offset"], state["scale"]
        if not (abs(offset) <= LARGEST_OUTPUT and 0.0 < scale < np.inf):
            raise ValueError(f"offset is {offset}, scale {scale}")
        factor = float(state.get("factor", 1.0))
        if not abs(factor) <= LARGEST_OUTPUT:
            raise ValueError(f"factor is {factor}")
        low = math.inf if state.get("low") is None else float(state["low"])
        return cls(
            bool(state["log"]), float(offset), float(scale), mean, mean_gradient, factor, low
        )

    def prior_mean(self, x: FloatArray) -> FloatArray:
        """Return the prior mean m(x) `(m,)` at x `(m, d)`, in units of t(y)."""
        if self.mean is None:
            return np.full(len(x), self.offset)
        values = np.asarray(self.mean(x), dtype=np.float64)
        if values.shape != (len(x),) or not np.isfinite(values).all():
            raise ValueError(
                f"the mean function must return {len(x)} finite values, got shape {values.shape}"
            )
        return np.asarray(self.offset + self.factor * values)

    def explains(self, x: FloatArray, y: FloatArray) -> bool:
        """Return whether the prior mean is the outputs y `(n,)` at x `(n, d)`, to rounding."""
        return bool(np.abs(y - self.prior_mean(x)).max() <= _EXACT * np.abs(y).max())

    def prior_mean_gradient(self, x: FloatArray) -> FloatArray:
        """Return the gradient of the prior mean in x `(m, d)` at x `(m, d)`."""
        if self.mean is None:
            return np.zeros_like(x)
        if self.mean_gradient is not None:
            gradient = np.asarray(self.mean_gradient(x), dtype=np.float64)
            if gradient.shape != x.shape or not np.isfinite(gradient).all():
                raise ValueError(
                    f"mean_gradient must return finite values {x.shape}, got shape {gradient.shape}"
                )
            return np.asarray(self.factor * gradient)
        gradient = np.empty_like(x)
        for a in range(x.shape[1]):
            step = np.zeros(x.shape[1])
            step[a] = _GRADIENT_STEP
            gradient[:, a] = (self.prior_mean(x + step) - self.prior_mean(x - step)) / (
                2.0 * _GRADIENT_STEP
            )
        return gradient

    def standardise(self, x: FloatArray, y: FloatArray) -> FloatArray:
        """Return the residuals z `(n,)` of the observations x `(n, d)`, y `(n,)`."""
        return ((np.log(y) if self.log else y) - self.prior_mean(x)) / self.scale

    def unstandardise(
        self, x: FloatArray, mean: FloatArray, stddev: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Return mean and standard deviation of t(y) at x `(m, d)` from those of z, `(m,)` each."""
        return self.prior_mean(x) + self.scale * mean, self.scale * stddev

    def noise_variances(self, y: FloatArray, stddev: FloatArray) -> FloatArray:
        """Return variances of z `(n,)` from standard deviations of y, to first order for the log."""
        unit = self.scale * np.abs(y) if self.log else self.scale
        with np.errstate(over="ignore"):
            return np.asarray(np.minimum(np.square(stddev / unit), _LARGEST_VARIANCE))

    def log_slope(self, y: FloatArray) -> FloatArray:
        """Return `log |dz/dy|` `(n,)`, which turns log densities of z into those of y."""
        return np.asarray(-np.log(self.scale) - (np.log(y) if self.log else np.zeros_like(y)))

    def to_output(self, mean: FloatArray, stddev: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return mean and standard deviation of y, `(m,)` each, from those of t(y), mu and s.

        Under the logarithm, the Gaussian that shares the log-normal's median and one of its quantiles:
        that one standard deviation below, `exp(mu)` and `exp(mu) (1 - exp(-s))`, or that at `low` where it
        is farther below. An acquisition function of a minimised y looks at that side: expected improvements
        are right to a fifth for s up to 0.6 and targets down to half a standard deviation below the
        median, where a Gaussian with the log-normal's mean and variance, swollen by its upper tail, is
        wrong without limit (by a factor of 6 at s = 1, of 3000 at s = 2.5). And where the median is far
        above what is sought, improvements are as improbable as they are: with the quantile one standard
        deviation below, a place with a median of 600 and s = 0.7 would promise less than 20 with a
        probability of 3 % instead of 6e-7. The probability to exceed a limit comes out too low: do not
        transform what has an upper limit to keep.
        """
        if not self.log:
            return mean, stddev
        median = np.exp(np.minimum(mean, _LARGEST_EXPONENT))
        depth = np.maximum(np.maximum(mean - self.low, stddev), _LEAST_DEPTH)
        return median, -median * np.expm1(-depth) * (stddev / depth)

    def gradients_to_output(
        self,
        mean: FloatArray,
        stddev: FloatArray,
        mean_gradient: FloatArray,
        stddev_gradient: FloatArray,
    ) -> tuple[FloatArray, FloatArray]:
        """Return the gradients in x of `to_output`, `(m, d)` each, from those of its arguments."""
        if not self.log:
            return mean_gradient, stddev_gradient
        median, spread = self.to_output(mean, stddev)
        is_deep = mean - self.low > stddev
        depth = np.maximum(np.maximum(mean - self.low, stddev), _LEAST_DEPTH)
        lower = median * np.exp(-depth)
        by_depth = np.where(is_deep, (lower * stddev - spread) / depth, 0.0)
        by_stddev = np.where(is_deep, spread / stddev, lower)
        return (
            median[:, None] * mean_gradient,
            (spread + by_depth)[:, None] * mean_gradient + by_stddev[:, None] * stddev_gradient,
        )
