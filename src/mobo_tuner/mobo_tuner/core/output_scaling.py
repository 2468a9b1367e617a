"""Scaling of an output in its own units to the standardised residual that a Gaussian process models."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, Self

import numpy as np

from mobo_tuner.core.arrays import FloatArray
from mobo_tuner.core.gaussian_process_settings import MeanFunction
from mobo_tuner.core.output_transform import (
    Logarithm,
    SignedLogarithm,
    Transform,
    transform_from_state,
)

LARGEST_OUTPUT = 1e100
"""Largest magnitude of an output."""
_ROUNDING = 1e-12
_EXACT = 1e-9
_GRADIENT_STEP = 1e-5
_SMALLEST_SCALE = 1e-150
_LARGEST_VARIANCE = 1e100
_HEAVY = 10.0
_HEAVY_ABOUT_LIMIT = 3.0


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


def has_heavy_tail_about(y: FloatArray, limit: float) -> bool:
    """Return whether outputs `(n,)` are so unequally far from a limit that a signed logarithm may say more."""
    distance = np.abs(y - limit)
    return bool(distance.max() > _HEAVY_ABOUT_LIMIT * np.median(distance))


@dataclass(frozen=True)
class OutputScaling:
    """`z = (t(y) - m(x)) / scale`, with a transform t and the prior mean m.

    The prior mean is `m(x) = offset + factor * mean(x)`, or `offset` alone without a function.

    Attributes:
        transform: Transform t; None for none.
        offset: Constant part of the prior mean, in units of t(y).
        scale: Standard deviation of `t(y) - m(x)` over the observations, positive.
        mean: Function of the inputs `(n, d) -> (n,)`, if there is one.
        mean_gradient: Gradient of `mean` `(m, d) -> (m, d)`; by default central differences.
        factor: Factor of `mean`.
    """

    transform: Transform | None
    offset: float
    scale: float
    mean: MeanFunction | None = None
    mean_gradient: MeanFunction | None = None
    factor: float = 1.0

    @classmethod
    def of(
        cls,
        x: FloatArray,
        y: FloatArray,
        *,
        offset: float | None = None,
        transform: Transform | None = None,
        mean: MeanFunction | None = None,
        mean_gradient: MeanFunction | None = None,
        scaled: bool = False,
    ) -> OutputScaling:
        """Return the scaling that suits observations.

        If all residuals are the same, to rounding, nothing shows how much the function varies: the
        scale is then their distance from the prior mean or, if that is zero too, 1 / n of the outputs'
        magnitude.

        Args:
            x: Normalised inputs `(n, d)`.
            y: Outputs `(n,)`.
            offset: Constant prior mean, in units of t(y); None for the mean of the data.
            transform: Transform t; None for none.
            mean: Function whose best offset from the outputs is the prior mean, in place of `offset`.
            mean_gradient: Gradient of `mean`.
            scaled: Whether the best factor of `mean` is taken, too.
        """
        values = y if transform is None else transform.apply(y)
        factor = 1.0
        if mean is not None:
            predicted = cls(transform, 0.0, 1.0, mean).prior_mean(x)
            if scaled:
                variance = float(np.var(predicted))
                agreement = float(np.mean((predicted - predicted.mean()) * values))
                factor = agreement / variance if variance > 0.0 else 1.0
            offset = float(np.mean(values - factor * predicted))
        elif offset is None:
            offset = float(np.mean(values))
        unscaled = cls(transform, offset, 1.0, mean, mean_gradient, factor)
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
            "log": False,
            "low": None,
            **({} if self.transform is None else self.transform.get_state()),
            "offset": self.offset,
            "scale": self.scale,
            "factor": self.factor,
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
        transform = transform_from_state(state)
        return cls(transform, float(offset), float(scale), mean, mean_gradient, factor)

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

    def allows(self, y: FloatArray) -> bool:
        """Return whether t is defined for all outputs y `(n,)`."""
        return not isinstance(self.transform, Logarithm) or bool((y > 0.0).all())

    def transformed(self, y: FloatArray) -> FloatArray:
        """Return t(y) `(n,)`."""
        return y if self.transform is None else self.transform.apply(y)

    def output(self, t: FloatArray) -> FloatArray:
        """Return the outputs y of t(y), of any shape."""
        return t if self.transform is None else self.transform.invert(t)

    def unit(self, y: FloatArray) -> FloatArray:
        """Return dy/dt `(n,)`: how much y changes with t(y)."""
        return np.ones_like(y) if self.transform is None else self.transform.unit(y)

    def standardise(self, x: FloatArray, y: FloatArray) -> FloatArray:
        """Return the residuals z `(n,)` of the observations x `(n, d)`, y `(n,)`."""
        return (self.transformed(y) - self.prior_mean(x)) / self.scale

    def unstandardise(
        self, x: FloatArray, mean: FloatArray, stddev: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Return mean and standard deviation of t(y) at x `(m, d)` from those of z, `(m,)` each."""
        return self.prior_mean(x) + self.scale * mean, self.scale * stddev

    def noise_variances(self, y: FloatArray, stddev: FloatArray) -> FloatArray:
        """Return variances of z `(n,)` from standard deviations of y, to first order."""
        unit = self.scale * self.unit(y)
        with np.errstate(over="ignore"):
            return np.asarray(np.minimum(np.square(stddev / unit), _LARGEST_VARIANCE))

    def log_slope(self, y: FloatArray) -> FloatArray:
        """Return `log |dz/dy|` `(n,)`, which turns log densities of z into those of y."""
        return np.asarray(-np.log(self.scale) - np.log(self.unit(y)))

    def to_output(self, mean: FloatArray, stddev: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return mean and standard deviation of y, `(m,)` each, from those of t(y)."""
        if self.transform is None:
            return mean, stddev
        return self.transform.to_output(mean, stddev)

    def gradients_to_output(
        self,
        mean: FloatArray,
        stddev: FloatArray,
        mean_gradient: FloatArray,
        stddev_gradient: FloatArray,
    ) -> tuple[FloatArray, FloatArray]:
        """Return the gradients in x of `to_output`, `(m, d)` each, from those of its arguments."""
        if self.transform is None:
            return mean_gradient, stddev_gradient
        return self.transform.gradients_to_output(mean, stddev, mean_gradient, stddev_gradient)

    def to_reading(
        self, mean: FloatArray, stddev: FloatArray, y: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Return the results of `to_output` that suit to judge one reading y `(m,)` by each of them."""
        if isinstance(self.transform, SignedLogarithm):
            return self.transform.to_reading(mean, stddev, y)
        return self.to_output(mean, stddev)
