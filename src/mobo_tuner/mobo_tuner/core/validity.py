"""The probability that an evaluation is valid: not failed, not missing, not NaN.

A Gaussian process classifier: a latent Gaussian process f, prior mean m, and

    p(valid | x) = Phi(f(x))

with the Gaussian cumulative distribution function Phi, its posterior by Laplace's approximation,
`[Rasmussen2006]_` sections 3.4 to 3.6 and 5.5.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import lapack
from scipy.special import betaln, expit, log_expit, log_ndtr, ndtri

from mobo_tuner.core.arrays import FloatArray
from mobo_tuner.core.kernels import Kernel, Matern52, as_inputs, squared_distances
from mobo_tuner.core.linear_algebra import (
    cholesky,
    inverse_triangle,
    single_blas_thread,
)
from mobo_tuner.core.one_hot import OneHot
from mobo_tuner.core.posterior import RELATIVE_JITTER, Gradients, TriangularPosterior
from mobo_tuner.core.training import train_lbfgs

# Whatever the kernel of the models: the priors below are those of its length-scales.
_KERNEL = Matern52
_LENGTH_SCALE_PRIOR = (float(np.log(2.0)), 1.0)
_VARIANCE_PRIOR = (float(np.log(50.0)), 1.2)
_VARIANCE_BOUNDS = (float(np.log(0.1)), float(np.log(1e4)))
_NEWTON_STEPS = 50
_NEWTON_TOLERANCE = 1e-12
_TRAINING_STEPS = 30
_TRAINING_TOLERANCE = 1e-3
_TRAINING_GROWTH = 1.1
_LOG_THRESHOLD = float(np.log(0.8))
_WEIGHT_STEEPNESS = 10.0
_CAUSE_LOG_ODDS = 2.0  # before any evaluation: most failures of a machine have a cause


class ValidityModel:
    """Probability of a valid evaluation over inputs normalised to [-1, 1].

    Where nothing has failed yet, it is one everywhere. Otherwise it returns, far from all
    observations, to a value between a half and the share of valid ones. Laplace's approximation
    is fast and cautious: where all evaluations are valid, it may still say 0.8.

    A failure teaches where evaluations fail only as far as it repeats there: `log_weight` weighs the
    evidence of a cause in x against that of chance and of bursts, in which a machine that is off or
    tripped fails wherever it is set.

    To steer an optimiser, multiply its acquisition function by the weight, not by the probability:
    the edge of what works is where improvements look largest, as nothing is known beyond, and
    there a probability of a few percent is outbid again and again.
    """

    def __init__(self, one_hot: OneHot | None = None, fidelities: int = 0) -> None:
        self._one_hot = one_hot
        self._fidelities = fidelities
        self._parameters: FloatArray | None = None
        self._trained = 0  # number of evaluations at the last training
        self._posterior: _LaplacePosterior | None = None
        self._d: int | None = None

    def fit(self, x: ArrayLike, valid: ArrayLike) -> ValidityModel:
        """Learn from all evaluations so far.

        Hyperparameters are trained, from the last ones, when there are a tenth more evaluations
        than at the last training: some tens of steps of O(n^3). Otherwise a few such steps.

        Args:
            x: Normalised inputs `(n, d)`, n >= 1.
            valid: Whether each evaluation was valid, booleans `(n,)`, in the order of measuring.

        Returns:
            The model itself.

        Raises:
            ValueError: If an argument has the wrong shape or type, or an input is not finite.
        """
        inputs, outcomes = _checked_outcomes(x, valid, self._d)
        self._d = inputs.shape[1]
        self._posterior = None
        if outcomes.all():
            return self
        inputs = self._seen(inputs)
        kernel = _KERNEL(inputs.shape[1])
        with single_blas_thread():
            if self._parameters is None or len(outcomes) >= _TRAINING_GROWTH * self._trained:
                likelihood = _LaplaceLikelihood(kernel, inputs, outcomes)
                start = likelihood.prior_mean if self._parameters is None else self._parameters
                self._parameters, _ = train_lbfgs(
                    likelihood,
                    start[None],
                    likelihood.bounds(),
                    np.ones(len(start), dtype=np.bool_),
                    _TRAINING_TOLERANCE,
                    _TRAINING_STEPS,
                )
                self._trained = len(outcomes)
            self._posterior = _LaplacePosterior(kernel, self._parameters, inputs, outcomes)
        return self

    def predict_log_probability(self, x: ArrayLike) -> FloatArray:
        """Return the log probability `(m,)` that an evaluation at x `(m, d)` is valid; O(m n^2)."""
        inputs = self._checked(x)
        if self._posterior is None:
            return np.zeros(len(inputs))
        with single_blas_thread():
            mean, stddev = self._posterior.predict(self._seen(inputs))
        return np.asarray(log_ndtr((self._posterior.offset + mean) / np.hypot(1.0, stddev)))

    def predict_log_probability_with_gradient(self, x: ArrayLike) -> tuple[FloatArray, FloatArray]:
        """Return the result of `predict_log_probability` and its gradient in x `(m, d)`."""
        inputs = self._checked(x)
        if self._posterior is None:
            return np.zeros(len(inputs)), np.zeros(np.shape(x))
        with single_blas_thread():
            mean, stddev, gradients = self._posterior.predict_with_gradient(self._seen(inputs))
        if self._one_hot is not None:
            gradients = Gradients(*map(self._one_hot.pull_back, gradients))
        spread = np.hypot(1.0, stddev)
        ratio = (self._posterior.offset + mean) / spread
        ratio_gradient = (
            gradients.mean - (ratio * stddev / spread)[:, None] * gradients.stddev
        ) / spread[:, None]
        by_inputs = _hazard(ratio)[:, None] * ratio_gradient
        return np.asarray(log_ndtr(ratio)), by_inputs[:, : np.shape(x)[1]]

    def log_weight(self, x: ArrayLike) -> FloatArray:
        """Return the logarithm `(m,)` of the acquisition function's factor at x `(m, d)`.

        `1 - q + q r / (1 + (0.8 / r)^10)`, with the probability q that failures have a cause in x
        and r the probability that an evaluation at x is valid, over the highest one at an evaluated
        point: r itself where it is above 0.8, and vanishing quickly below. Failures by chance or in
        bursts, for which q is small, do not narrow the search.
        """
        log_ratio = self.predict_log_probability(x)
        if self._posterior is None:
            return log_ratio
        log_ratio = log_ratio - self._posterior.highest
        lack = _WEIGHT_STEEPNESS * (_LOG_THRESHOLD - log_ratio)
        return self._with_chance(log_ratio - np.logaddexp(0.0, lack))

    def log_weight_with_gradient(self, x: ArrayLike) -> tuple[FloatArray, FloatArray]:
        """Return the result of `log_weight` and its gradient in x `(m, d)`."""
        log_ratio, gradient = self.predict_log_probability_with_gradient(x)
        if self._posterior is None:
            return log_ratio, gradient
        log_ratio = log_ratio - self._posterior.highest
        lack = _WEIGHT_STEEPNESS * (_LOG_THRESHOLD - log_ratio)
        caused = log_ratio - np.logaddexp(0.0, lack)
        weight = self._with_chance(caused)
        share = np.exp(self._posterior.log_caused + caused - weight)
        slope = share * (1.0 + _WEIGHT_STEEPNESS * expit(lack))
        return weight, slope[:, None] * gradient

    def _with_chance(self, log_weight: FloatArray) -> FloatArray:
        """Mix the factor `(m,)` for failures with a cause in x and that for all others, one."""
        assert self._posterior is not None
        log_caused, log_elsewhere = self._posterior.log_caused, self._posterior.log_elsewhere
        return np.asarray(np.logaddexp(log_elsewhere, log_caused + log_weight))

    def get_state(self) -> dict[str, Any]:
        """Return the hyperparameters as data for JSON, without the evaluations."""
        parameters = None if self._parameters is None else self._parameters.tolist()
        return {"d": self._d, "parameters": parameters, "trained": self._trained}

    @classmethod
    def from_state(
        cls,
        state: dict[str, Any],
        x: ArrayLike = (),
        valid: ArrayLike = (),
        one_hot: OneHot | None = None,
        fidelities: int = 0,
    ) -> ValidityModel:
        """Return the model that `get_state` came from, bitwise, given the evaluations of its last `fit`.

        Args:
            state: State from `get_state`, also after a conversion to JSON and back.
            x: Normalised inputs `(n, d)`.
            valid: Whether each evaluation was valid, booleans `(n,)`.
            one_hot: How the kernel sees unordered inputs, again.
            fidelities: Number of the last inputs that are zero in predictions, again.

        Raises:
            ValueError: If the evaluations do not suit the state.
        """
        model = cls(one_hot, fidelities)
        if state["d"] is None:
            return model
        inputs, outcomes = _checked_outcomes(x, valid, state["d"])
        model._d, model._trained = state["d"], state["trained"]
        if state["parameters"] is not None:
            model._parameters = np.array(state["parameters"])
        if outcomes.all():
            return model
        if model._parameters is None:
            raise ValueError("valid must be all true, as in the state's evaluations")
        with single_blas_thread():
            seen = model._seen(inputs)
            model._posterior = _LaplacePosterior(
                _KERNEL(seen.shape[1]), model._parameters, seen, outcomes
            )
        return model

    def _seen(self, x: FloatArray) -> FloatArray:
        """Return inputs as the kernel sees them, with a column for each unordered choice."""
        return x if self._one_hot is None else self._one_hot.expand(x)

    def _checked(self, x: ArrayLike) -> FloatArray:
        if self._d is None:
            raise ValueError("the validity model has no evaluations yet: call fit first")
        if not self._fidelities or np.shape(x)[-1] == self._d:
            return as_inputs(x, self._d)
        inputs = as_inputs(x, self._d - self._fidelities)
        return np.hstack([inputs, np.zeros((len(inputs), self._fidelities))])


def _checked_outcomes(
    x: ArrayLike, valid: ArrayLike, d: int | None
) -> tuple[FloatArray, NDArray[np.bool_]]:
    inputs = as_inputs(x, d).copy()
    outcomes = np.array(valid)
    if outcomes.shape != (len(inputs),) or outcomes.dtype != np.bool_ or len(inputs) == 0:
        raise ValueError(
            f"valid must be a boolean for each of {len(inputs)} rows of x, at least one, "
            f"got {outcomes.dtype} {outcomes.shape}"
        )
    return inputs, outcomes


def _hazard(z: FloatArray) -> FloatArray:
    """Return `d log Phi(z) / dz`, without overflow."""
    return np.asarray(np.exp(-0.5 * z * z - 0.5 * np.log(2.0 * np.pi) - log_ndtr(z)))


class _Mode:
    """The maximum of the posterior of the latent function f at the observations.

    It is found by Newton's method, `[Rasmussen2006]_` Algorithm 3.1.

    Attributes:
        signs: Sign of each outcome `(n,)`, +1 if valid, else -1.
        offset: Prior mean.
        z: Signs times the latent function `(n,)`.
        weights: Gradient of the log likelihood there `(n,)`, `K^-1 (f - offset)`.
        root: Square root of the likelihood's negative second derivative `(n,)`.
        lower: Cholesky factor of `I + root K root` `(n, n)`.
        fit: Log posterior density, up to a constant.
    """

    def __init__(
        self, covariance: FloatArray, valid: NDArray[np.bool_], start: FloatArray | None = None
    ) -> None:
        n = len(valid)
        tolerance = _NEWTON_TOLERANCE * n
        self.signs = np.where(valid, 1.0, -1.0)
        # The share of valid ones with one of either kind added, of which there may be none.
        self.offset = float(ndtri((np.count_nonzero(valid) + 1.0) / (n + 2.0)))
        solution = np.zeros(n) if start is None else start
        self._evaluate(covariance, solution)
        for _ in range(_NEWTON_STEPS):
            target = self.root**2 * (covariance @ solution) + self.weights
            inner, _ = lapack.dpotrs(self.lower, self.root * (covariance @ target), lower=1)
            direction = target - self.root * inner - solution
            before, step = self.fit, 1.0
            self._evaluate(covariance, solution + direction)
            while self.fit < before - tolerance and step > 1e-3:
                step *= 0.5
                self._evaluate(covariance, solution + step * direction)
            solution = solution + step * direction
            if self.fit < before + tolerance:
                return

    @property
    def evidence(self) -> float:
        """Laplace's approximation of the log evidence, `[Rasmussen2006]_` Eq. (3.32)."""
        return self.fit - float(np.log(np.diagonal(self.lower)).sum())

    def _evaluate(self, covariance: FloatArray, solution: FloatArray) -> None:
        rise = covariance @ solution
        self.z = self.signs * (self.offset + rise)
        hazard = _hazard(self.z)
        self.fit = float(log_ndtr(self.z).sum() - 0.5 * solution @ rise)
        self.weights = self.signs * hazard
        self.root = np.sqrt(np.maximum(hazard * (self.z + hazard), 0.0))
        scaled = self.root[:, None] * covariance * self.root
        scaled.flat[:: len(solution) + 1] += 1.0
        self.lower, _ = cholesky(scaled)


class _LaplaceLikelihood:
    """Minus the log evidence and priors of the hyperparameters `(d + 1,)`, log l and `log s^2`.

    A log-normal prior of the length-scales around twice the square root of d, so that few
    observations tell of half-spaces rather than of islands, and one of the variance around 50: most
    failures are certain where they happen.
    """

    def __init__(self, kernel: Kernel, x: FloatArray, valid: NDArray[np.bool_]) -> None:
        self.kernel, self.x, self.valid = kernel, x, valid
        self._start: FloatArray | None = None  # the last mode is near the next one
        d = kernel.d
        self.prior_mean = np.append(
            np.full(d, _LENGTH_SCALE_PRIOR[0] + 0.5 * np.log(d)), _VARIANCE_PRIOR[0]
        )
        self._prior_stddev = np.append(np.full(d, _LENGTH_SCALE_PRIOR[1]), _VARIANCE_PRIOR[1])

    def bounds(self) -> FloatArray:
        """Return the lowest and highest allowed hyperparameters `(d + 1, 2)`."""
        return np.vstack([self.kernel.bounds(), _VARIANCE_BOUNDS])

    def __call__(self, parameters: FloatArray) -> tuple[float, FloatArray]:
        """Return value and gradient `(d + 1,)`; O(n^3).

        `[Rasmussen2006]_` Algorithm 5.1, but with a plus in its s_2, as finite differences confirm.
        """
        shape, variance = parameters[:-1], np.exp(parameters[-1])
        covariance, slope = _covariance(self.kernel, shape, variance, self.x)
        mode = _Mode(covariance, self.valid, self._start)
        self._start = mode.weights
        a, root = mode.weights, mode.root
        value = -mode.evidence

        triangle = inverse_triangle(mode.lower) * root
        whole = triangle.T @ triangle
        explained = triangle @ covariance
        remaining = np.diagonal(covariance) - np.einsum("ij,ij->j", explained, explained)
        hazard = mode.signs * a
        third = a * ((mode.z + hazard) * (mode.z + 2.0 * hazard) - 1.0)
        implicit = 0.5 * remaining * third
        implicit = implicit - whole @ (covariance @ implicit)
        contraction = 0.5 * whole - np.multiply.outer(a, 0.5 * a + implicit)
        contraction = 0.5 * (contraction + contraction.T)

        gradient = np.empty_like(parameters)
        gradient[-1] = (contraction * covariance).sum()
        contraction *= variance * slope
        np.fill_diagonal(contraction, 0.0)
        gradient[:-1] = self.kernel.gradient(shape, self.x, contraction)
        deviation = (parameters - self.prior_mean) / self._prior_stddev
        return value + 0.5 * float(deviation @ deviation), gradient + deviation / self._prior_stddev


class _LaplacePosterior(TriangularPosterior):
    """The latent process given the outcomes, less its prior mean `offset`.

    `[Rasmussen2006]_` Eq. (3.21) and (3.24).

    Attributes:
        highest: Logarithm of the highest probability at an observation.
        log_caused: Logarithm of the probability that failures have a cause in x, by the evidence of
            the process against that of one probability everywhere and that of bursts.
        log_elsewhere: Logarithm of the probability that they have none.
    """

    def __init__(
        self, kernel: Kernel, parameters: FloatArray, x: FloatArray, valid: NDArray[np.bool_]
    ) -> None:
        self.kernel = kernel
        self.variance = float(np.exp(parameters[-1]))
        self.factor = kernel.factor(parameters[:-1])
        self.scaled = x @ self.factor
        covariance, _ = _covariance(kernel, parameters[:-1], self.variance, x)
        mode = _Mode(covariance, valid)
        self.offset = mode.offset
        self.weights = mode.weights
        self.inverse = np.asfortranarray(inverse_triangle(mode.lower) * mode.root)
        mean, stddev = self.predict(x)
        self.highest = float(log_ndtr((self.offset + mean) / np.hypot(1.0, stddev)).max())
        by_chance = float(log_ndtr(mode.signs * mode.offset).sum())
        elsewhere = np.logaddexp(by_chance, _log_evidence_of_bursts(valid))
        odds = _CAUSE_LOG_ODDS + mode.evidence - elsewhere
        self.log_caused, self.log_elsewhere = (float(v) for v in log_expit([odds, -odds]))


def _log_evidence_of_bursts(valid: NDArray[np.bool_]) -> float:
    """Return the log evidence of outcomes `(n,)` that depend on the one before, not on x.

    They are a Markov chain of two states, each of which lasts with a probability that is uniform
    beforehand.
    """
    before, lasts = valid[:-1], valid[1:] == valid[:-1]
    evidence = -np.log(2.0)
    for state in (before, ~before):
        evidence += betaln(np.sum(state & lasts) + 1, np.sum(state & ~lasts) + 1)
    return float(evidence)


def _covariance(
    kernel: Kernel, shape: FloatArray, variance: float, x: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return the covariance matrix of the observations and the kernel's slope, `(n, n)` each."""
    scaled = x @ kernel.factor(shape)
    profile, slope = kernel.profile(squared_distances(scaled, scaled))
    covariance = variance * profile
    covariance.flat[:: len(x) + 1] = variance * (1.0 + RELATIVE_JITTER)
    return covariance, slope
