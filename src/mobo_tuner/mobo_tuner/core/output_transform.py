"""Transforms t of an output y before it is modelled: its logarithm, or a signed logarithm about a limit."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from mobo_tuner.core.arrays import FloatArray

_LARGEST_EXPONENT = 600.0
_LEAST_DEPTH = 1e-300
_NEAR = 1e-4  # size of t(y) up to which a series is more exact


@dataclass(frozen=True)
class Logarithm:
    """`t(y) = log y`.

    Attributes:
        low: Logarithm of a low output, of which `to_output` keeps the probability; infinite for none.
    """

    low: float = math.inf

    def apply(self, y: FloatArray) -> FloatArray:
        """Return log y `(n,)`."""
        return np.asarray(np.log(y))

    def invert(self, t: FloatArray) -> FloatArray:
        """Return the outputs exp t `(n,)`."""
        return np.asarray(np.exp(t))

    def unit(self, y: FloatArray) -> FloatArray:
        """Return dy/dt `(n,)`: y itself."""
        return np.abs(y)

    def to_output(self, mean: FloatArray, stddev: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return mean and standard deviation of y, `(m,)` each, from those of t(y), mu and s.

        It is the Gaussian that shares the log-normal's median and one of its quantiles: that one standard
        deviation below, `exp(mu)` and `exp(mu) (1 - exp(-s))`, or that at `low` where it is farther below.
        An acquisition function of a minimised y looks at that side: expected improvements are right to a
        fifth for s up to 0.6 and targets down to half a standard deviation below the median, where a
        Gaussian with the log-normal's mean and variance, swollen by its upper tail, is wrong without limit
        (by a factor of 6 at s = 1, of 3000 at s = 2.5). And where the median is far above what is sought,
        improvements are as improbable as they are: with the quantile one standard deviation below, a place
        with a median of 600 and s = 0.7 would promise less than 20 with a probability of 3 % instead of
        6e-7. The probability to exceed a limit comes out too low: what has a limit to keep takes a
        `SignedLogarithm`.
        """
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

    def get_state(self) -> dict[str, Any]:
        """Return what `transform_from_state` needs, as data for JSON."""
        return {"log": True, "low": self.low}


@dataclass(frozen=True)
class SignedLogarithm:
    """`t(y) = sign(y - limit) log(1 + |y - limit| / width)`, which is linear near the limit.

    Attributes:
        limit: Limit of y, where t is 0.
        width: Distance from the limit at which t is log 2, positive.
    """

    limit: float
    width: float

    def apply(self, y: FloatArray) -> FloatArray:
        """Return t(y) `(n,)`."""
        excess = y - self.limit
        return np.asarray(np.sign(excess) * np.log1p(np.abs(excess) / self.width))

    def invert(self, t: FloatArray) -> FloatArray:
        """Return the outputs y `(n,)` of t(y), finite ones."""
        return np.asarray(self.limit + np.sign(t) * self.width * np.expm1(self._size(t)))

    def unit(self, y: FloatArray) -> FloatArray:
        """Return dy/dt `(n,)`."""
        return np.asarray(self.width + np.abs(y - self.limit))

    def to_output(self, mean: FloatArray, stddev: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return mean and standard deviation of y, `(m,)` each, from those of t(y).

        It is the Gaussian that shares the median, and the probability to exceed the limit.
        """
        return self.invert(mean), stddev * self._secant(mean)

    def to_reading(
        self, mean: FloatArray, stddev: FloatArray, y: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Return the Gaussians of y that share the median, and the probability to exceed a reading each."""
        median, difference = self.invert(mean), mean - self.apply(y)
        apart = np.abs(difference) > _NEAR
        secant = (median - y) / np.where(apart, difference, 1.0)
        return median, stddev * np.where(apart, secant, self.unit(y))

    def gradients_to_output(
        self,
        mean: FloatArray,
        stddev: FloatArray,
        mean_gradient: FloatArray,
        stddev_gradient: FloatArray,
    ) -> tuple[FloatArray, FloatArray]:
        """Return the gradients in x of `to_output`, `(m, d)` each, from those of its arguments."""
        size = self._size(mean)
        some = np.maximum(size, _NEAR)
        bend = (np.exp(some) * some - np.expm1(some)) / some**2
        bend = np.where(size < _NEAR, 0.5 + size / 3.0, bend) * np.sign(mean) * self.width
        by_mean = self.width * np.exp(size)
        return (
            by_mean[:, None] * mean_gradient,
            self._secant(mean)[:, None] * stddev_gradient
            + (stddev * bend)[:, None] * mean_gradient,
        )

    def get_state(self) -> dict[str, Any]:
        """Return what `transform_from_state` needs, as data for JSON."""
        return {"log": False, "low": None, "limit": self.limit, "width": self.width}

    def _size(self, t: FloatArray) -> FloatArray:
        """Return |t| `(n,)`, at most what still has a finite output."""
        return np.minimum(np.abs(t), _LARGEST_EXPONENT - max(math.log(self.width), 0.0))

    def _secant(self, t: FloatArray) -> FloatArray:
        """Return by how much y changes from the limit to where t is so large, in units of t `(n,)`."""
        size = self._size(t)
        some = np.maximum(size, _NEAR)
        return self.width * np.where(size < _NEAR, 1.0 + 0.5 * size, np.expm1(some) / some)


Transform = Logarithm | SignedLogarithm


def transform_from_state(state: Mapping[str, Any]) -> Transform | None:
    """Return the transform that its `get_state` came from; None if there was none.

    Raises:
        ValueError: If a number is out of range.
    """
    if state["log"]:
        return Logarithm(math.inf if state.get("low") is None else float(state["low"]))
    if state.get("limit") is None:
        return None
    limit, width = float(state["limit"]), float(state["width"])
    if not (math.isfinite(limit) and 0.0 < width < math.inf):
        raise ValueError(f"limit is {limit}, width {width}")
    return SignedLogarithm(limit, width)
