"""Training of hyperparameters: the marginal likelihood with its gradient, and two ways to climb it.

.. [Kingma2015] D. P. Kingma, J. Ba, "Adam: a method for stochastic optimization", ICLR 2015.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import lapack
from scipy.optimize import minimize

from mobo_tuner.core.arrays import FloatArray
from mobo_tuner.core.gaussian_process_settings import GaussianProcessSettings
from mobo_tuner.core.kernels import Kernel, squared_distances
from mobo_tuner.core.linear_algebra import cholesky, inverse_lower
from mobo_tuner.core.posterior import RELATIVE_JITTER, Posterior

_NOISE_PRIOR = (float(np.log(1e-4)), 2.0)
_WIDE_NOISE_PRIOR = (float(np.log(1e-2)), 2.5)
_VARIANCE_PRIOR_STDDEV = float(np.sqrt(2.0))
_RESTART_SPREAD = 0.7
_BLOCK = 64

CLEAR_NOISE = float(np.log(0.03))
"""Logarithm of the variance of noise that is plain to see, as a share of that of the outputs."""
TOLERANCE = 1e-2
"""Gain in the log likelihood below which a training is done."""
CLEAR_EVIDENCE = 6.0
"""Least gain in log density for which optional hyperparameters are used."""
_EVIDENCE_PER_PARAMETER = 0.4  # by chance it grows to 0.2 for each of them
_DECISIVE_EVIDENCE = 3.0  # the same of the observations that decide
SUBSET = 128
"""Number of observations on which many starts are compared."""

Objective = Callable[[FloatArray], tuple[float, FloatArray]]


class NegativeLogPosterior:
    """Minus the log marginal likelihood and priors of the hyperparameters, divided by n.

        -log p(z) = z^T K^-1 z / 2 + log det K / 2 + n log(2 pi) / 2,
        K_ij = s^2 (g(r_ij^2) + 1e-10 delta_ij) + (noise + extra_i) delta_ij

    `[Rasmussen2006]_` Eq. (5.8), its gradient Eq. (5.9).

    Hyperparameters `(k + 2,)`: the kernel's k shape parameters, `log s^2`, `log noise` (variances).

    Args:
        kernel: Covariance function of d inputs.
        x: Normalised inputs `(n, d)`.
        z: Standardised outputs less the prior mean `(n,)`.
        extra: Known noise variances `(n,)`, in the units of z squared.
        weak_prior: Whether to add the kernel's prior, a log-normal prior of the noise around 1e-4, and
            one of the signal variance around the mean square of z.
        noisy: Whether the machine is known to be noisy: then the prior of the noise is wide.
    """

    def __init__(
        self,
        kernel: Kernel,
        x: FloatArray,
        z: FloatArray,
        extra: FloatArray,
        weak_prior: bool,
        noisy: bool = False,
    ) -> None:
        self.kernel, self.x, self.z, self.extra, self.weak_prior = kernel, x, z, extra, weak_prior
        self.log_mean_square = float(np.log(max(float(np.mean(z * z)), 1e-6)))
        self._shape_prior = kernel.prior()
        prior = _WIDE_NOISE_PRIOR if noisy else _NOISE_PRIOR
        self._prior_mean = np.array([self.log_mean_square, prior[0]])
        self._prior_stddev = np.array([_VARIANCE_PRIOR_STDDEV, prior[1]])

    def __call__(self, parameters: FloatArray) -> tuple[float, FloatArray]:
        """Return value and gradient `(k + 2,)`; O(n^3 + n^2 d)."""
        n = len(self.z)
        shape, variance, noise = parameters[:-2], np.exp(parameters[-2]), np.exp(parameters[-1])
        covariance, slope = self._upper_triangles(shape, float(variance))
        diagonal = noise + self.extra
        covariance.flat[:: n + 1] += diagonal
        lower, jitter = cholesky(covariance)
        diagonal = diagonal + jitter

        inverse = inverse_lower(lower)
        inverse_diagonal = np.diagonal(inverse).copy()
        weights, _ = lapack.dpotrs(lower, self.z, lower=1)
        fit = float(self.z @ weights)
        value = 0.5 * fit + float(np.log(np.diagonal(lower)).sum()) + 0.5 * n * np.log(2.0 * np.pi)

        gradient = np.empty_like(parameters)
        contraction = inverse.T
        for rows, columns in _row_blocks(n):
            contraction[rows, columns] -= np.multiply.outer(weights[rows], weights[columns])
            contraction[rows, columns] *= slope[rows, columns]
        gradient[:-2] = self.kernel.gradient(shape, self.x, contraction)
        # s^2 dK/ds^2 = K - diagonal spares the traces a matrix product.
        gradient[-2] = 0.5 * (
            n - inverse_diagonal @ diagonal - fit + (weights * weights) @ diagonal
        )
        gradient[-1] = 0.5 * noise * float((inverse_diagonal - weights * weights).sum())
        if self.weak_prior:
            penalty, by_shape = self._shape_prior.penalty(shape)
            deviation = (parameters[-2:] - self._prior_mean) / self._prior_stddev
            value += penalty + 0.5 * float(deviation @ deviation)
            gradient[:-2] += by_shape
            gradient[-2:] += deviation / self._prior_stddev
        return value / n, gradient / n

    def _upper_triangles(self, shape: FloatArray, variance: float) -> tuple[FloatArray, FloatArray]:
        """Return the kernel's covariance, and s^2 times its slope with a diagonal of zeros, `(n, n)` each.

        They are computed in blocks that fit the processor's cache, and right of the diagonal only.
        """
        n = len(self.z)
        covariance, slope = np.zeros((n, n)), np.zeros((n, n))
        scaled = self.x @ self.kernel.factor(shape)
        for rows, columns in _row_blocks(n):
            profile, block = self.kernel.profile(squared_distances(scaled[rows], scaled[columns]))
            np.multiply(profile, variance, out=covariance[rows, columns])
            np.multiply(block, variance, out=slope[rows, columns])
            slope[rows, rows] = np.triu(slope[rows, rows], 1)
        covariance.flat[:: n + 1] = variance * (1.0 + RELATIVE_JITTER)
        return covariance, slope

    def noise_penalty(self, log_noise: float) -> float:
        """Return minus the log density of the prior of `log noise`, up to a constant."""
        if not self.weak_prior:
            return 0.0
        return 0.5 * float(((log_noise - self._prior_mean[1]) / self._prior_stddev[1]) ** 2)

    def bounds(self, minimum_noise: float) -> FloatArray:
        """Return the lowest and highest allowed hyperparameters `(k + 2, 2)`."""
        others = [
            self.log_mean_square + np.log([1e-3, 1e4]),
            np.log([minimum_noise, max(1.0, 2.0 * minimum_noise)]),
        ]
        return np.vstack([self.kernel.bounds(), others])

    def default_parameters(self) -> FloatArray:
        """Return the start of a first training `(k + 2,)`."""
        return np.append(self.kernel.default_parameters(), [self.log_mean_square, _NOISE_PRIOR[0]])


def left_out_gains(
    objective: NegativeLogPosterior,
    parameters: FloatArray,
    other: NegativeLogPosterior,
    other_parameters: FloatArray,
) -> FloatArray:
    """Return the gains in the left-out log densities `(n,)` over those of another model, at most one for each."""
    densities = [
        Posterior(
            model.kernel,
            p[:-2],
            float(np.exp(p[-2])),
            model.x,
            model.z,
            float(np.exp(p[-1])) + model.extra,
        ).leave_one_out_log_density
        for model, p in ((objective, parameters), (other, other_parameters))
    ]
    return np.clip(densities[0] - densities[1], -1.0, 1.0)


def _row_blocks(n: int) -> Iterator[tuple[slice, slice]]:
    """Yield blocks of rows of an `(n, n)` matrix, with the columns from their diagonal on."""
    for start in range(0, n, _BLOCK):
        yield slice(start, min(start + _BLOCK, n)), slice(start, n)


def train_lbfgs(
    objective: Objective,
    starts: FloatArray,
    bounds: FloatArray,
    free: NDArray[np.bool_],
    tolerance: float,
    iterations: int = 100,
    deadline: float = np.inf,
) -> tuple[FloatArray, float]:
    """Return the best hyperparameters and their value by L-BFGS-B from every start.

    Args:
        objective: Function that returns value and gradient `(k,)` at a vector `(k,)`.
        starts: Starts `(r, k)`, r >= 1.
        bounds: Lowest and highest allowed values `(k, 2)`.
        free: Whether each of the k may move `(k,)`; the others stay as in the first start.
        tolerance: Gain in the value (relative to it, if it is above 1) below which a start is done, or
            a tenth of the largest derivative at which it is.
        iterations: Highest number of iterations from each start.
        deadline: Time at which to stop with the best so far [s], of `time.monotonic`.
    """
    best, best_value = np.array(starts[0]), np.inf
    if not free.any():
        return best, objective(best)[0]
    lowest, lowest_value = best[free], np.inf

    def restricted(moving: FloatArray) -> tuple[float, FloatArray]:
        nonlocal lowest, lowest_value
        if time.monotonic() > deadline:
            raise _OutOfTimeError
        parameters = best.copy()
        parameters[free] = moving
        value, gradient = objective(parameters)
        if value < lowest_value:
            lowest, lowest_value = moving.copy(), value
        return value, gradient[free]

    limits = bounds[free]
    for start in starts:
        try:
            result = minimize(
                restricted,
                np.clip(start[free], limits[:, 0], limits[:, 1]),
                jac=True,
                method="L-BFGS-B",
                bounds=limits,
                options={"maxiter": iterations, "ftol": tolerance, "gtol": 10.0 * tolerance},
            )
        except _OutOfTimeError:
            if lowest_value < best_value:
                best[free], best_value = lowest, lowest_value
            break
        if result.fun < best_value:
            best[free] = result.x
            best_value = float(result.fun)
    return best, best_value


class _OutOfTimeError(Exception):
    """The time for the training is over."""


def train_adam(
    objective: Objective,
    start: FloatArray,
    bounds: FloatArray,
    free: NDArray[np.bool_],
    rate: float,
    steps: int,
    deadline: float = np.inf,
) -> tuple[FloatArray, float]:
    """Return hyperparameters and their value after a number of Adam steps, `[Kingma2015]_` Algorithm 1.

    The arguments are those of `train_lbfgs`, but for one start `(k,)`, the learning rate and the
    number of steps. A step that leaves the bounds ends on them.
    """
    parameters = np.clip(start, bounds[:, 0], bounds[:, 1])
    parameters[~free] = start[~free]
    mean, square = np.zeros_like(start), np.zeros_like(start)
    for step in range(1, steps + 1):
        if time.monotonic() > deadline:
            break
        gradient = np.where(free, objective(parameters)[1], 0.0)
        mean += 0.1 * (gradient - mean)
        square += 0.001 * (gradient * gradient - square)
        change = (mean / (1.0 - 0.9**step)) / (np.sqrt(square / (1.0 - 0.999**step)) + 1e-8)
        moved = np.clip(parameters - rate * change, bounds[:, 0], bounds[:, 1])
        parameters = np.where(free, moved, parameters)
    return parameters, objective(parameters)[0]


def held_parameters(
    settings: GaussianProcessSettings, kernel: Kernel, scale: float
) -> tuple[FloatArray, NDArray[np.bool_]]:
    """Return the hyperparameters that the settings hold, and which ones are free, `(k + 2,)` each.

    Args:
        settings: Settings, with the held values in normalised inputs and the output's units.
        kernel: Covariance function of d inputs.
        scale: Size of one standardised unit in the output's units.

    Raises:
        ValueError: If the held length-scales or precision matrix are not of d inputs.
    """
    held = np.zeros(kernel.size + 2)
    free = np.ones(kernel.size + 2, dtype=np.bool_)
    shape = settings.held_shape(kernel)
    if shape is not None:
        free[: len(shape)] = False
        held[: len(shape)] = shape
    if settings.variance is not None:
        free[-2] = False
        held[-2] = np.clip(np.log(settings.variance) - 2.0 * np.log(scale), -200.0, 200.0)
    if not isinstance(settings.noise, str):
        free[-1] = False
        held[-1] = np.log(settings.minimum_noise)
    return held, free


class Task(NamedTuple):
    """What a training needs to know of one output.

    Attributes:
        settings: Settings: held values, bounds, kind of training.
        kernel: Covariance function of d inputs, with k shape parameters.
        scale: Size of one unit of z in the output's units.
        x: Normalised inputs `(n, d)`.
        z: Standardised outputs less the prior mean `(n,)`.
        extra: Known variances of z `(n,)`.
        noisy: Whether the machine is known to be noisy.
        decisive: Which observations optional hyperparameters must also predict better `(n,)`; None for all.
    """

    settings: GaussianProcessSettings
    kernel: Kernel
    scale: float
    x: FloatArray
    z: FloatArray
    extra: FloatArray
    noisy: bool = False
    decisive: NDArray[np.bool_] | None = None


def train(
    task: Task,
    former: FloatArray | None,
    rng: np.random.Generator,
    restarts: int,
    deadline: float = np.inf,
) -> FloatArray:
    """Return the hyperparameters `(k + 2,)` for standardised observations, trained as the settings say.

    Those that are optional for the kernel keep their default, see `train_optional`. If there is only one
    observation, z is all zero, or every hyperparameter is held, there is nothing to learn: the start is
    returned.

    Args:
        task: What is trained.
        former: Hyperparameters of the last training, from which this one starts, if any.
        rng: Random number generator of the other starts.
        restarts: Number of the other starts.
        deadline: Time at which to stop with the best so far [s], of `time.monotonic`.
    """
    settings, kernel, scale, x, z, extra, noisy, _ = task
    objective = NegativeLogPosterior(kernel, x, z, extra, settings.prior == "weak", noisy)
    held, free = held_parameters(settings, kernel, scale)
    bounds = objective.bounds(settings.minimum_noise)
    default = objective.default_parameters()
    optional = _optional(kernel)
    held[optional] = default[optional]
    free &= ~optional
    start = default if former is None else former
    start = np.where(free, np.clip(start, bounds[:, 0], bounds[:, 1]), held)
    if len(z) < 2 or not free.any() or time.monotonic() > deadline:
        return start
    if not z.any():
        # Alike so far: nothing says how far the function varies, so that its scale stays one.
        return np.where(free, np.append(default[:-2], [0.0, bounds[-1, 0]]), held)
    if settings.training == "adam":
        steps = settings.adam_steps if former is None else settings.adam_retraining_steps
        return train_adam(objective, start, bounds, free, settings.adam_rate, steps, deadline)[0]
    drawn = np.tile(default, (restarts, 1))
    moving = np.flatnonzero(~optional)
    drawn[:, moving] += _RESTART_SPREAD * rng.standard_normal((restarts, len(moving)))
    starts = np.vstack([start, np.where(free, drawn, held)])
    if noisy and free[-1]:
        clear = np.where(free, np.append(default[:-1], CLEAR_NOISE), held)
        starts = np.vstack([starts, clear])
    if len(z) > SUBSET and (former is None or restarts > 0):
        starts = _best_start(objective, starts, bounds, free, former is not None, deadline)
    tolerance = TOLERANCE / len(z)
    return train_lbfgs(objective, starts, bounds, free, tolerance, deadline=deadline)[0]


def train_optional(
    task: Task, plain: FloatArray, former: FloatArray | None, deadline: float = np.inf
) -> FloatArray:
    """Return the hyperparameters `(k + 2,)` with the kernel's optional ones trained, if that is clearly better.

    It is if the observations, with the priors, are more probable by `CLEAR_EVIDENCE`, or more where there are many
    optional ones, and if they are so when each is predicted from all others and counts for at most one, so that no
    wild reading decides, and some of it comes from those that are decisive; else `plain` itself is returned. With
    more than `SUBSET` observations, a subset of them must say so first.

    Args:
        task: What is trained.
        plain: Hyperparameters that `train` returned for it.
        former: Hyperparameters in use so far, whose optional ones the training starts from.
        deadline: Time at which to stop with the best so far [s], of `time.monotonic`.
    """
    settings, kernel, scale, x, z, extra, noisy, decisive = task
    free = held_parameters(settings, kernel, scale)[1]
    optional = free & _optional(kernel)
    if not optional.any() or not z.any() or time.monotonic() > deadline:
        return plain
    least = max(CLEAR_EVIDENCE, _EVIDENCE_PER_PARAMETER * int(optional.sum()))
    start = plain if former is None else np.where(optional, former, plain)
    every = slice(None)
    some = slice(None, None, -(-len(z) // SUBSET))
    for part in (every,) if len(z) <= SUBSET else (some, every):
        objective = NegativeLogPosterior(
            kernel, x[part], z[part], extra[part], settings.prior == "weak", noisy
        )
        n = len(objective.z)
        bounds = objective.bounds(settings.minimum_noise)
        start, value = train_lbfgs(
            objective, start[None], bounds, free, TOLERANCE / n, deadline=deadline
        )
        if n * (objective(plain)[0] - value) < least:
            return plain
        gains = left_out_gains(objective, start, objective, plain)
        if gains.sum() < CLEAR_EVIDENCE:
            return plain
        if decisive is not None and gains[decisive[part]].sum() < _DECISIVE_EVIDENCE:
            return plain
    return start


def _optional(kernel: Kernel) -> NDArray[np.bool_]:
    """Return which of the hyperparameters `(k + 2,)` are optional."""
    return np.append(kernel.optional, [False, False])


def _best_start(
    objective: NegativeLogPosterior,
    starts: FloatArray,
    bounds: FloatArray,
    free: NDArray[np.bool_],
    keep_first: bool,
    deadline: float,
) -> FloatArray:
    """Return the best one `(1, k)` of the starts `(r, k)`, improved on a subset of the observations.

    With `keep_first`, the first is not changed. If every start were trained on all observations, each
    would cost as much as the winner.
    """
    part = slice(None, None, -(-len(objective.z) // SUBSET))
    subset = NegativeLogPosterior(
        objective.kernel,
        objective.x[part],
        objective.z[part],
        objective.extra[part],
        objective.weak_prior,
    )
    tolerance = TOLERANCE / len(subset.z)
    improved = [
        start
        if keep_first and i == 0
        else train_lbfgs(subset, start[None], bounds, free, tolerance, deadline=deadline)[0]
        for i, start in enumerate(starts)
    ]
    if time.monotonic() > deadline:
        return np.array(improved[-1:])
    best = int(np.argmin([objective(start)[0] for start in improved]))
    return np.array(improved[best : best + 1])
