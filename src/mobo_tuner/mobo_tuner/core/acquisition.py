"""Acquisition functions over normalised inputs, multiplied together as logarithms.

An acquisition function alpha(x) >= 0 is the value of a candidate x in [-1, 1]^d according to the
models' predictions. Constraints and proximal biasing are factors of it, and any two functions can be
multiplied:

    candidate_value = ExpectedHypervolumeImprovement(models, front) * ProbabilityOfFeasibility(...)

All values are logarithms, so that a product of many small numbers neither underflows nor loses its
gradient. If alpha is exactly zero, its logarithm is minus infinity and the gradient zero.

Every objective is minimised, so that the signs of the paper's formulas for maximisation change.

.. [Roussel2021] R. Roussel, A. Hanuka, A. Edelen, "Multiobjective Bayesian optimization for online
   accelerator tuning", Phys. Rev. Accel. Beams 24, 062801 (2021).
.. [Srinivas2010] N. Srinivas, A. Krause, S. M. Kakade, M. Seeger, "Gaussian process optimization in
   the bandit setting: no regret and experimental design", ICML (2010).
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar, Protocol, Self

import numpy as np
from numpy.typing import ArrayLike

from mobo_tuner.core.arrays import FloatArray, as_points
from mobo_tuner.core.registry import Registry

if TYPE_CHECKING:
    from mobo_tuner.core.hypervolume import BoxDecomposition

_LOG_DENSITY_AT_ZERO = -0.5 * math.log(2.0 * math.pi)
_SERIES_BELOW = -100.0
_LOST_BELOW = -650.0  # a logarithm: what is less is lost to underflow, wholly or in part


class Model(Protocol):
    """A model that predicts one quantity: a normal distribution at each normalised input."""

    def predict(self, X: FloatArray, /) -> tuple[FloatArray, FloatArray]:  # noqa: N803
        """Return mean and standard deviation, `(m, d) -> (m,), (m,)`, in the quantity's units."""
        ...

    def predict_with_gradient(
        self,
        X: FloatArray,  # noqa: N803
        /,
    ) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Return mean, standard deviation and their gradients, `(m,), (m,), (m, d), (m, d)`."""
        ...


class Predictions:
    """The predictions of models for one batch of inputs; each model is evaluated once.

    Args:
        inputs: Normalised inputs `(m, d)`.

    Attributes:
        inputs: Normalised inputs `(m, d)`.
    """

    def __init__(self, inputs: ArrayLike) -> None:
        self.inputs = as_points(inputs, "inputs")
        self._moments: dict[int, tuple[FloatArray, FloatArray]] = {}
        self._gradients: dict[int, tuple[FloatArray, FloatArray, FloatArray, FloatArray]] = {}

    def of(self, model: Model) -> tuple[FloatArray, FloatArray]:
        """Return mean and standard deviation, `(m,)` each."""
        key = id(model)
        if key not in self._moments:
            self._moments[key] = model.predict(self.inputs)
        return self._moments[key]

    def with_gradient(self, model: Model) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Return mean, standard deviation, `(m,)` each, and their gradients, `(m, d)` each."""
        key = id(model)
        if key not in self._gradients:
            self._gradients[key] = model.predict_with_gradient(self.inputs)
        return self._gradients[key]


class AcquisitionFunction(ABC):
    """The logarithm of a function alpha(x) >= 0; `*` gives the product of two functions."""

    def log_value(self, inputs: ArrayLike) -> FloatArray:
        """Return log alpha, `(m, d) -> (m,)`; minus infinity if alpha is zero."""
        return self.log_value_from(Predictions(inputs))

    def log_value_with_gradient(self, inputs: ArrayLike) -> tuple[FloatArray, FloatArray]:
        """Return log alpha and its gradient, `(m, d) -> (m,), (m, d)`; the latter is zero if alpha is."""
        return self.log_value_with_gradient_from(Predictions(inputs))

    @abstractmethod
    def log_value_from(self, predictions: Predictions) -> FloatArray:
        """Return log alpha `(m,)` at the inputs of `predictions`."""

    @abstractmethod
    def log_value_with_gradient_from(
        self, predictions: Predictions
    ) -> tuple[FloatArray, FloatArray]:
        """Return log alpha `(m,)` and its gradient `(m, d)` at the inputs of `predictions`."""

    def __mul__(self, other: AcquisitionFunction) -> Product:
        """Return the product of the two, which uses the same predictions for both."""
        return Product([self, other])


class Product(AcquisitionFunction):
    """The product of acquisition functions and factors, as in `[Roussel2021]_` Eqs. (9) and (10)."""

    def __init__(self, factors: Sequence[AcquisitionFunction]) -> None:
        if not factors:
            raise ValueError("factors must contain at least one acquisition function")
        self._factors = tuple(factors)

    def log_value_from(self, predictions: Predictions) -> FloatArray:
        """Return the sum of the factors' logarithms."""
        total = np.zeros(len(predictions.inputs))
        for factor in self._factors:
            total += factor.log_value_from(predictions)
        return total

    def log_value_with_gradient_from(
        self, predictions: Predictions
    ) -> tuple[FloatArray, FloatArray]:
        """Return the sums of the factors' logarithms and of their gradients."""
        total = np.zeros(len(predictions.inputs))
        total_gradient = np.zeros_like(predictions.inputs)
        for factor in self._factors:
            log_value, gradient = factor.log_value_with_gradient_from(predictions)
            total += log_value
            total_gradient += gradient
        total_gradient[np.isneginf(total)] = 0.0
        return total, total_gradient


class Average(AcquisitionFunction):
    """The mean of acquisition functions, such as those of draws of what is uncertain.

    Args:
        functions: At least one acquisition function.
    """

    def __init__(self, functions: Sequence[AcquisitionFunction]) -> None:
        if not functions:
            raise ValueError("functions must contain at least one acquisition function")
        self._functions = tuple(functions)

    def log_value_from(self, predictions: Predictions) -> FloatArray:
        """Return the logarithm of the mean."""
        log_values = np.array([each.log_value_from(predictions) for each in self._functions])
        most = _finite_or_zero(log_values.max(axis=0))
        return most + _log(np.exp(log_values - most).mean(axis=0))

    def log_value_with_gradient_from(
        self, predictions: Predictions
    ) -> tuple[FloatArray, FloatArray]:
        """Return the logarithm of the mean, and its gradient."""
        results = [each.log_value_with_gradient_from(predictions) for each in self._functions]
        log_values = np.array([log_value for log_value, _ in results])
        most = _finite_or_zero(log_values.max(axis=0))
        shares = np.exp(log_values - most)
        total = shares.sum(axis=0)
        gradient = np.einsum("km,kmd->md", shares, np.array([each for _, each in results]))
        gradient /= np.where(total > 0.0, total, 1.0)[:, None]
        return most + _log(total / len(results)), gradient


@dataclass(frozen=True)
class Knowledge:
    """The data from which an acquisition function of the objectives is built; all are minimised.

    For a function of a single objective, P is 1: the problem's only objective, or the weighted sum
    of all.

    Attributes:
        models: Models of the P objectives.
        values: Objectives of the feasible evaluations `(n, P)`; n may be 0.
        reference: Reference point `(P,)`.
        beta: Weight of the uncertainty, at least 0.
        front: Callable that builds and returns the boxes below the reference point that the
            evaluations do not dominate.
        truncation: Truncation box (A, B), `(P,)` each, with B the reference point; or None.
        tails: Whether improvements that underflow are needed, see `ExpectedHypervolumeImprovement`.
    """

    models: tuple[Model, ...]
    values: FloatArray
    reference: FloatArray
    beta: float
    front: Callable[[], BoxDecomposition]
    truncation: tuple[FloatArray, FloatArray] | None = None
    tails: bool = True


class ObjectiveAcquisition(AcquisitionFunction):
    """An acquisition function of the objectives, which can be chosen by its name.

    Attributes:
        single_objective: Whether the function takes a single objective, so that a problem with
            several objectives needs weights.
    """

    single_objective: ClassVar[bool] = False

    @classmethod
    @abstractmethod
    def of(cls, knowledge: Knowledge) -> Self:
        """Return the acquisition function for the given data."""


ACQUISITION_FUNCTIONS = Registry[ObjectiveAcquisition](
    "acquisition", "mobo_tuner.acquisition_functions", ObjectiveAcquisition
)


@ACQUISITION_FUNCTIONS.register("ei")
class ExpectedImprovement(ObjectiveAcquisition):
    """Expected improvement E[max(best - f, 0)], `[Roussel2021]_` Eq. (1).

    Its logarithm is finite at any distance from the best value.
    """

    single_objective = True

    def __init__(self, model: Model, best: float) -> None:
        """Set the value to improve on.

        Args:
            model: Model of the minimised objective.
            best: Lowest value so far, in the objective's units.
        """
        self._model = model
        self._best = _finite(best, "best")

    @classmethod
    def of(cls, knowledge: Knowledge) -> Self:
        """Return the improvement on the best value so far, or on the reference if there is none."""
        values = knowledge.values if len(knowledge.values) else knowledge.reference
        return cls(knowledge.models[0], float(values.min()))

    def log_value_from(self, predictions: Predictions) -> FloatArray:
        """Return log alpha `(m,)`."""
        return self._from_moments(*predictions.of(self._model))[0]

    def log_value_with_gradient_from(
        self, predictions: Predictions
    ) -> tuple[FloatArray, FloatArray]:
        """Return log alpha `(m,)` and its gradient `(m, d)`."""
        mean, stddev, mean_gradient, stddev_gradient = predictions.with_gradient(self._model)
        log_value, by_mean, by_stddev = self._from_moments(mean, stddev)
        return log_value, by_mean[:, None] * mean_gradient + by_stddev[:, None] * stddev_gradient

    def _from_moments(
        self, mean: FloatArray, stddev: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return log alpha and its derivatives in mean and stddev, `(m,)` each.

        With z = (best - mean) / stddev, alpha = stddev h(z), h(z) = phi(z) + z Phi(z), h' = Phi.
        """
        gain = self._best - mean
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            z = gain / stddev
            log_h, slope = _log_expected_shortfall(z)
            log_value = np.log(stddev) + log_h
            by_mean = -slope / stddev
            by_stddev = (1.0 - z * slope) / stddev
            certain = ~np.isfinite(log_value + by_mean + by_stddev)
            log_gain = np.where(gain > 0.0, np.log(np.maximum(gain, 0.0)), -np.inf)
            by_gain = np.where(gain > 0.0, -1.0 / gain, 0.0)
        return (
            np.where(certain, log_gain, log_value),
            np.where(certain, by_gain, by_mean),
            np.where(certain, 0.0, by_stddev),
        )


@ACQUISITION_FUNCTIONS.register("ucb")
class UpperConfidenceBound(ObjectiveAcquisition):
    """max(reference - (mean - sqrt(beta) stddev), 0), `[Roussel2021]_` Eq. (2) for minimisation.

    The paper's function has no zero, which a product with a probability needs. Here it is relative
    to a reference, above which a value is worth nothing; its maximum is at the same place. It is the
    UCB-HVI of one objective with an empty front.
    """

    single_objective = True

    def __init__(self, model: Model, beta: float, reference: float) -> None:
        """Set exploration and reference.

        Args:
            model: Model of the minimised objective.
            beta: Weight of the uncertainty, at least 0; a larger value explores more.
            reference: Value above which nothing is gained, in the objective's units. With the best
                value so far only improvements count, with the largest value so far everything.
        """
        self._model = model
        self._width = math.sqrt(_at_least_zero(beta, "beta"))
        self._reference = _finite(reference, "reference")

    @classmethod
    def of(cls, knowledge: Knowledge) -> Self:
        """Return the bound relative to the reference point."""
        return cls(knowledge.models[0], knowledge.beta, float(knowledge.reference[0]))

    def log_value_from(self, predictions: Predictions) -> FloatArray:
        """Return log alpha `(m,)`."""
        mean, stddev = predictions.of(self._model)
        return _log(self._reference - (mean - self._width * stddev))

    def log_value_with_gradient_from(
        self, predictions: Predictions
    ) -> tuple[FloatArray, FloatArray]:
        """Return log alpha `(m,)` and its gradient `(m, d)`."""
        mean, stddev, mean_gradient, stddev_gradient = predictions.with_gradient(self._model)
        value = self._reference - (mean - self._width * stddev)
        return _log_with_gradient(value, self._width * stddev_gradient - mean_gradient)


class _HypervolumeAcquisition(ObjectiveAcquisition):
    """Base of the acquisition functions on the hypervolume: models, front, truncation box."""

    def __init__(
        self,
        models: Sequence[Model],
        decomposition: BoxDecomposition,
        truncation: tuple[ArrayLike, ArrayLike] | None,
    ) -> None:
        reference = decomposition.reference
        if len(models) != len(reference):
            raise ValueError(
                f"models must be one for each of {len(reference)} objectives, not {len(models)}"
            )
        self._models = tuple(models)
        self._decomposition = decomposition
        self._lower: FloatArray | None = None
        if truncation is not None:
            lower, upper = (np.asarray(corner, dtype=np.float64) for corner in truncation)
            if not np.array_equal(upper, reference):
                raise ValueError(
                    f"truncation must end at B = {reference}, the reference point, not at {upper}"
                )
            if lower.shape != upper.shape or not (lower < upper).all():
                raise ValueError(f"truncation must have A < B in every objective, not A = {lower}")
            self._lower = lower

    def _moments(self, predictions: Predictions) -> tuple[FloatArray, FloatArray]:
        """Return mean and standard deviation, `(m, P)` each."""
        moments = [predictions.of(model) for model in self._models]
        return _columns([mean for mean, _ in moments]), _columns([stddev for _, stddev in moments])

    def _moments_with_gradient(
        self, predictions: Predictions
    ) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Return mean and standard deviation, `(m, P)` each, and gradients, `(m, P, d)` each."""
        moments = [predictions.with_gradient(model) for model in self._models]
        mean, stddev, mean_gradient, stddev_gradient = (
            _columns(list(each)) for each in zip(*moments, strict=True)
        )
        return mean, stddev, mean_gradient, stddev_gradient


@ACQUISITION_FUNCTIONS.register("ehvi")
class ExpectedHypervolumeImprovement(_HypervolumeAcquisition):
    """Expected hypervolume improvement, exact for any number of objectives.

    `[Roussel2021]_` Eq. (3) (eqn:EHVI); with a truncation box Eq. (6).
    """

    def __init__(
        self,
        models: Sequence[Model],
        decomposition: BoxDecomposition,
        truncation: tuple[ArrayLike, ArrayLike] | None = None,
        tails: bool = True,
    ) -> None:
        """Set models and front.

        Args:
            models: Models of the P minimised objectives.
            decomposition: Decomposition for the front; points added to it later also count.
            truncation: Truncation box (A, B), `(P,)` each, inside which a prediction counts. B must
                be the reference point of `decomposition`; A may contain minus infinity.
            tails: Whether improvements that underflow are computed in logarithms, which takes a few
                times as long; without it they count as zero.

        Raises:
            ValueError: If the numbers of objectives differ or the box is not allowed.
        """
        super().__init__(models, decomposition, truncation)
        self._lost_below = _LOST_BELOW if tails else -math.inf

    @classmethod
    def of(cls, knowledge: Knowledge) -> Self:
        """Return the expected improvement of the front so far."""
        return cls(knowledge.models, knowledge.front(), knowledge.truncation, knowledge.tails)

    def log_value_from(self, predictions: Predictions) -> FloatArray:
        """Return log alpha `(m,)`."""
        mean, stddev = self._moments(predictions)
        log_value = _log(self._decomposition.expected_improvement(mean, stddev, self._lower))
        lost = log_value < self._lost_below
        if lost.any():
            log_value[lost] = self._decomposition.log_expected_improvement_with_gradient(
                mean[lost], stddev[lost], self._lower
            )[0]
        return log_value

    def log_value_with_gradient_from(
        self, predictions: Predictions
    ) -> tuple[FloatArray, FloatArray]:
        """Return log alpha `(m,)` and its gradient `(m, d)`."""
        mean, stddev, mean_gradient, stddev_gradient = self._moments_with_gradient(predictions)
        value, by_mean, by_stddev = self._decomposition.expected_improvement_with_gradient(
            mean, stddev, self._lower
        )
        gradient = np.einsum("mp,mpd->md", by_mean, mean_gradient)
        gradient += np.einsum("mp,mpd->md", by_stddev, stddev_gradient)
        log_value, gradient = _log_with_gradient(value, gradient)
        lost = log_value < self._lost_below
        if lost.any():
            log_value[lost], by_mean, by_stddev = (
                self._decomposition.log_expected_improvement_with_gradient(
                    mean[lost], stddev[lost], self._lower
                )
            )
            gradient[lost] = np.einsum("mp,mpd->md", by_mean, mean_gradient[lost])
            gradient[lost] += np.einsum("mp,mpd->md", by_stddev, stddev_gradient[lost])
        return log_value, gradient


@ACQUISITION_FUNCTIONS.register("ucb_hvi")
class UpperConfidenceBoundHypervolumeImprovement(_HypervolumeAcquisition):
    """UCB-HVI: the improvement by mean - sqrt(beta) stddev, `[Roussel2021]_` Eq. (4).

    With a truncation box, it is zero if that optimistic point is outside the box, Eq. (7).
    """

    def __init__(
        self,
        models: Sequence[Model],
        decomposition: BoxDecomposition,
        beta: float,
        truncation: tuple[ArrayLike, ArrayLike] | None = None,
    ) -> None:
        """Set models, front and exploration.

        Args:
            models: Models of the P minimised objectives.
            decomposition: Decomposition for the front; points added to it later also count.
            beta: Weight of the uncertainty, at least 0; a larger value explores more.
            truncation: Truncation box, as for `ExpectedHypervolumeImprovement`.

        Raises:
            ValueError: If the numbers of objectives differ, the box is not allowed or beta is
                negative.
        """
        super().__init__(models, decomposition, truncation)
        self._width = math.sqrt(_at_least_zero(beta, "beta"))

    @classmethod
    def of(cls, knowledge: Knowledge) -> Self:
        """Return the optimistic improvement of the front so far."""
        return cls(knowledge.models, knowledge.front(), knowledge.beta, knowledge.truncation)

    def log_value_from(self, predictions: Predictions) -> FloatArray:
        """Return log alpha `(m,)`."""
        mean, stddev = self._moments(predictions)
        return _log(self._decomposition.improvement(mean - self._width * stddev, self._lower))

    def log_value_with_gradient_from(
        self, predictions: Predictions
    ) -> tuple[FloatArray, FloatArray]:
        """Return log alpha `(m,)` and its gradient `(m, d)`."""
        mean, stddev, mean_gradient, stddev_gradient = self._moments_with_gradient(predictions)
        value, by_point = self._decomposition.improvement_with_gradient(
            mean - self._width * stddev, self._lower
        )
        point_gradient = mean_gradient - self._width * stddev_gradient
        return _log_with_gradient(value, np.einsum("mp,mpd->md", by_point, point_gradient))


def beta_schedule(n_evaluations: int, n_variables: int, delta: float = 0.1) -> float:
    """Return 2 log(d t^2 pi^2 / (6 delta)), a beta that grows with the number of evaluations t.

    `[Srinivas2010]_` Theorem 1, with the number of variables d instead of the number of candidates.
    It is meant for UCB; its values are far above the 0.01 of `[Roussel2021]_`.

    Args:
        n_evaluations: Number of evaluations t.
        n_variables: Number of variables d.
        delta: Probability that the bound does not hold.

    Raises:
        ValueError: If an argument is not allowed.
    """
    if n_evaluations < 1 or n_variables < 1 or not 0.0 < delta < 1.0:
        raise ValueError(
            "n_evaluations and n_variables must be at least 1 and delta between 0 and 1, not "
            f"{n_evaluations}, {n_variables} and {delta}"
        )
    return 2.0 * math.log(n_variables * n_evaluations**2 * math.pi**2 / (6.0 * delta))


def _log_expected_shortfall(z: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return log h(z) and its derivative Phi/h, h(z) = phi(z) + z Phi(z), for any z `(m,)`.

    In the left tail h/phi = 1 - |z| M with the Mills ratio M = Phi/phi; far out, its series is used.
    """
    # They take a fifth of a second to import, which a check of settings can spare.
    from scipy.special import erfcx, ndtr

    tail = np.minimum(z, -1.0)
    mills = math.sqrt(0.5 * math.pi) * erfcx(-tail * math.sqrt(0.5))
    ratio = 1.0 + tail * mills
    inverse = 1.0 / (tail * tail)
    series = inverse * (1.0 - 3.0 * inverse * (1.0 - 5.0 * inverse * (1.0 - 7.0 * inverse)))
    ratio = np.where(tail < _SERIES_BELOW, series, ratio)
    log_tail = _LOG_DENSITY_AT_ZERO - 0.5 * tail * tail + np.log(ratio)

    body = np.maximum(z, -1.0)
    mass = ndtr(body)
    h = np.exp(_LOG_DENSITY_AT_ZERO - 0.5 * body * body) + body * mass
    in_tail = z < -1.0
    return np.where(in_tail, log_tail, np.log(h)), np.where(in_tail, mills / ratio, mass / h)


def _log(value: FloatArray) -> FloatArray:
    """Return the logarithm of the positive part."""
    with np.errstate(divide="ignore"):
        log_value: FloatArray = np.log(np.maximum(value, 0.0))
    return log_value


def _log_with_gradient(value: FloatArray, gradient: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the logarithm of the positive part `(m,)` and its gradient `(m, d)`."""
    positive = (value > 0.0)[:, None]
    divisor = np.where(positive, value[:, None], 1.0)
    return _log(value), np.where(positive, gradient / divisor, 0.0)


def _columns(arrays: Sequence[FloatArray]) -> FloatArray:
    return np.stack(arrays, axis=1)


def _finite_or_zero(values: FloatArray) -> FloatArray:
    return np.where(np.isfinite(values), values, 0.0)


def _finite(value: float, name: str) -> float:
    if not math.isfinite(value):
        raise ValueError(f"{name} must be finite, not {value}")
    return float(value)


def _at_least_zero(value: float, name: str) -> float:
    if not 0.0 <= value < math.inf:
        raise ValueError(f"{name} must be finite and at least 0, not {value}")
    return float(value)
