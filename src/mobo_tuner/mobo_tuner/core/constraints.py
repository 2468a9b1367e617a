"""The probability that a constraint is met, as a factor of an acquisition function."""

from __future__ import annotations

import math

import numpy as np
from scipy.special import erfcx, ndtr

from mobo_tuner.core.acquisition import AcquisitionFunction, Model, Predictions
from mobo_tuner.core.arrays import FloatArray
from mobo_tuner.core.validity import ValidityModel

_LOG_DENSITY_AT_ZERO = -0.5 * math.log(2.0 * math.pi)
_NARROW = 1e-5
_CERTAIN_FROM = 1e100


class ProbabilityOfFeasibility(AcquisitionFunction):
    """Pr[lower <= g(x) <= upper] for a modelled quantity g, `[Roussel2021]_` Eq. (8).

    Its logarithm is finite and has a slope towards feasibility at any distance, so that a product of
    these factors alone also leads to a first feasible point.
    """

    def __init__(self, model: Model, lower: float = -math.inf, upper: float = math.inf) -> None:
        """Set the limits.

        Args:
            model: Model of the constrained quantity; may be that of an objective.
            lower: Lower limit in the quantity's units; minus infinity for none.
            upper: Upper limit in the quantity's units; infinity for none.

        Raises:
            ValueError: If `lower` is not below `upper`, or neither is finite.
        """
        if not lower < upper:
            raise ValueError(f"lower must be below upper, not {lower} and {upper}")
        if math.isinf(lower) and math.isinf(upper):
            raise ValueError("lower or upper must be finite")
        self._model = model
        self._lower = float(lower)
        self._upper = float(upper)

    def log_value_from(self, predictions: Predictions) -> FloatArray:
        """Return log P_g `(m,)`."""
        mean, stddev = predictions.of(self._model)
        return log_probability_between(mean, stddev, self._lower, self._upper)[0]

    def log_value_with_gradient_from(
        self, predictions: Predictions
    ) -> tuple[FloatArray, FloatArray]:
        """Return log P_g `(m,)` and its gradient `(m, d)`."""
        mean, stddev, mean_gradient, stddev_gradient = predictions.with_gradient(self._model)
        log_value, by_mean, by_stddev = log_probability_between(
            mean, stddev, self._lower, self._upper
        )
        return log_value, by_mean[:, None] * mean_gradient + by_stddev[:, None] * stddev_gradient


class ValidityWeight(AcquisitionFunction):
    """A weight that keeps the search in the region of valid evaluations. It is not in the paper.

    A plain probability, as for a constraint, is not enough: a failed evaluation contains no
    information on the objectives, so that the predicted improvement just beyond a boundary would
    never decrease.
    """

    def __init__(self, model: ValidityModel) -> None:
        """Set the model.

        Args:
            model: Model fitted to all evaluations, valid or not.
        """
        self._model = model

    def log_value_from(self, predictions: Predictions) -> FloatArray:
        """Return the logarithm of the weight, `(m,)`."""
        return self._model.log_weight(predictions.inputs)

    def log_value_with_gradient_from(
        self, predictions: Predictions
    ) -> tuple[FloatArray, FloatArray]:
        """Return the logarithm of the weight, `(m,)`, and its gradient, `(m, d)`."""
        return self._model.log_weight_with_gradient(predictions.inputs)


def violation(values: FloatArray, lower: float, upper: float) -> FloatArray:
    """Return by how much values `(n,)` miss the limits; 0 where they are met."""
    return np.maximum(np.maximum(lower - values, values - upper), 0.0)


def log_probability_between(
    mean: FloatArray, stddev: FloatArray, lower: float, upper: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return log Pr[lower <= g <= upper] for normal g, and its derivatives.

    Args:
        mean: Means `(m,)`.
        stddev: Standard deviations `(m,)`; for zero, the probability is 0 or 1 and the derivatives
            are zero.
        lower: Lower limit, below `upper`; minus infinity for none.
        upper: Upper limit; infinity for none.

    Returns:
        The logarithm and its derivatives in mean and stddev, `(m,)` each.
    """
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        a = (lower - mean) / stddev
        b = (upper - mean) / stddev
        width = (upper - lower) / stddev  # far from the limits b - a would round to zero
    nearest = np.minimum(np.abs(a), np.abs(b))
    certain = (stddev == 0.0) | ~(nearest < _CERTAIN_FROM)
    a = np.where(certain, -1.0, a)
    b = np.where(certain, 1.0, b)
    # An interval on the right is mirrored to the left, where the tail of Phi is accurate.
    mirrored = a > 0.0
    left = np.where(mirrored, -b, a)
    right = np.where(mirrored, -a, b)
    log_value, by_shift, by_scale = _log_mass(left, right, np.where(certain, 2.0, width))
    by_shift = np.where(mirrored, -by_shift, by_shift)
    scale = np.where(certain, 1.0, stddev)
    met = (lower <= mean) & (mean <= upper)
    return (
        np.where(certain, np.where(met, 0.0, -np.inf), log_value),
        np.where(certain, 0.0, by_shift / scale),
        np.where(certain, 0.0, by_scale / scale),
    )


def _log_mass(
    a: FloatArray, b: FloatArray, width: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return log p, p = Phi(b) - Phi(a), and its slopes under shifting and scaling, `(m,)` each.

    Here a <= 0 and `width` is b - a > 0. The slopes are (phi(a) - phi(b)) / p and
    (a phi(a) - b phi(b)) / p.
    """
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        # Both in the left tail: p = phi(b) (M(-b) - M(-a) phi(a)/phi(b)), M the Mills ratio.
        b_tail = np.minimum(b, 0.0)
        shrink = np.exp(0.5 * width * (b_tail + a))
        in_units_of_density = _mills(-b_tail) - np.where(shrink > 0.0, shrink * _mills(-a), 0.0)
        log_tail = _LOG_DENSITY_AT_ZERO - 0.5 * b_tail * b_tail + np.log(in_units_of_density)
        # On both sides of zero: one minus the two tails.
        missing = ndtr(-np.maximum(b, 0.0)) + ndtr(a)
        log_body = np.log1p(-missing)

        in_tail = b <= 0.0
        at_b = np.where(in_tail, 1.0 / in_units_of_density, _density(b) / (1.0 - missing))
        at_a = np.where(in_tail, shrink / in_units_of_density, _density(a) / (1.0 - missing))
        at_a_times_a = np.where(at_a > 0.0, a * at_a, 0.0)
        at_b_times_b = np.where(at_b > 0.0, b * at_b, 0.0)

        middle = 0.5 * (a + b)
        narrow = width * (1.0 + np.maximum(np.abs(a), np.abs(b))) < _NARROW
        log_narrow = np.log(width) + _LOG_DENSITY_AT_ZERO - 0.5 * middle * middle
    return (
        np.where(narrow, log_narrow, np.where(in_tail, log_tail, log_body)),
        np.where(narrow, middle, at_a - at_b),
        np.where(narrow, middle * middle - 1.0, at_a_times_a - at_b_times_b),
    )


def _mills(x: FloatArray) -> FloatArray:
    """Return Q(x) / phi(x) for x >= 0."""
    ratio: FloatArray = math.sqrt(0.5 * math.pi) * erfcx(x * math.sqrt(0.5))
    return ratio


def _density(z: FloatArray) -> FloatArray:
    density: FloatArray = np.exp(_LOG_DENSITY_AT_ZERO - 0.5 * z * z)
    return density
