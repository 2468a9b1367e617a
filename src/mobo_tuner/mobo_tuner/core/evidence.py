"""Log evidence of noise and of drift in the observations of one output."""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mobo_tuner.core.arrays import FloatArray
from mobo_tuner.core.context_kernel import Contextual
from mobo_tuner.core.gaussian_process_settings import GaussianProcessSettings
from mobo_tuner.core.kernels import Kernel
from mobo_tuner.core.training import (
    CLEAR_NOISE,
    SUBSET,
    TOLERANCE,
    NegativeLogPosterior,
    held_parameters,
    left_out_gains,
    train_lbfgs,
)

_STEPS = 30  # of a training
NEGLIGIBLE_NOISE = float(np.log(1e-5))  # variance, as a share of that of the outputs
_NOISE_LEVELS = np.log([3e-4, 3e-3, 3e-2, 3e-1])  # the same, to look at first
_PLATEAU = 0.25  # share of readings that are alike from which on noise is not plain to see
_LEAST_FOR_DRIFT = 8  # observations that say anything of time
_TIME_SCALES = np.log([0.2, 1.0, 5.0])  # to look at first, in the unit of time


class NoiseEvidence(NamedTuple):
    """Log evidence of noise, and whether the noise is plain to see.

    What a model takes for noise although there is none, such as a steep flank, is far less.
    """

    log: float
    is_clear: bool


def noise_evidence(
    settings: GaussianProcessSettings,
    kernel: Kernel,
    x: FloatArray,
    z: FloatArray,
    extra: FloatArray,
    parameters: FloatArray,
) -> NoiseEvidence:
    """Return the evidence of noise against a noiseless function, roughly where it is not positive.

    It is computed in full only if some level of noise is better than none without a training. In 420
    trials with and without noise that took a third of the time and lost at most 0.5 of an evidence.

    It is the gain in the highest marginal likelihood, or, if that is less, the gain in the densities
    of the observations under their predictions from all others, of which each counts for at most one:
    a kink or a step of a noiseless function spoils a few predictions, noise spoils them all.

    Args:
        settings: Settings of the training.
        kernel: Covariance function of d inputs.
        x: Normalised inputs `(n, d)`.
        z: Standardised outputs less the prior mean `(n,)`.
        extra: Known variances of z `(n,)`.
        parameters: Trained hyperparameters `(k + 2,)`.
    """
    if settings.noise != "learned" or len(z) < 3 or not z.any():
        return NoiseEvidence(0.0, False)
    part = slice(None, None, -(-len(z) // SUBSET))
    objective = NegativeLogPosterior(
        kernel, x[part], z[part], extra[part], settings.prior == "weak", noisy=True
    )
    n = len(objective.z)
    bounds = objective.bounds(float(np.exp(NEGLIGIBLE_NOISE)))
    free = ~np.append(kernel.optional & (parameters[:-2] == 0.0), [False, False])
    default = objective.default_parameters()
    noisy, noiseless = (
        np.array([np.append(p[:-1], noise) for p in (parameters, default)])
        for noise in (CLEAR_NOISE, NEGLIGIBLE_NOISE)
    )
    tolerance = TOLERANCE / n
    penalty = objective.noise_penalty(NEGLIGIBLE_NOISE)

    def lowest(starts: Iterable[FloatArray]) -> float:
        return min(objective(np.clip(p, bounds[:, 0], bounds[:, 1]))[0] for p in starts)

    without = lowest(noiseless)
    learned = lowest([np.append(p[:-1], noise) for p in noiseless for noise in _NOISE_LEVELS])
    most = n * (without - learned) - penalty
    if most <= 0.0:  # no noise explains the observations any better
        return NoiseEvidence(most, False)
    noisy_best, learned = train_lbfgs(objective, noisy, bounds, free, tolerance, _STEPS)
    most = n * (without - learned) - penalty
    if most <= 0.0:  # the training below only lowers what there is without noise
        return NoiseEvidence(most, False)
    free[-1] = False
    noiseless_best, without = train_lbfgs(objective, noiseless, bounds, free, tolerance, _STEPS)
    gain = float(left_out_gains(objective, noisy_best, objective, noiseless_best).sum())
    # Readings that are exactly alike in many places are those of a plateau, not of noise.
    alike = np.unique(z, return_counts=True)[1].max() > _PLATEAU * len(z)
    return NoiseEvidence(
        min(n * (without - learned) - penalty, gain),
        bool(noisy_best[-1] >= CLEAR_NOISE and not alike),
    )


def drift_evidence(
    settings: GaussianProcessSettings,
    kernel: Contextual,
    x: FloatArray,
    z: FloatArray,
    extra: FloatArray,
    parameters: FloatArray,
) -> float:
    """Return the log evidence that a function changes with time, roughly where it is not positive.

    It is the gain in the highest marginal likelihood over that of a function of the other inputs, both
    with noise, or, if that is less, the gain in the densities of the observations under their
    predictions from all others, of which each counts for at most one, as for `noise_evidence`. It is
    computed in full only if some time scale is better than none without a training.

    Args:
        settings: Settings of the training.
        kernel: Covariance function of d inputs, the last of them time.
        x: Inputs `(n, d)`.
        z: Standardised outputs less the prior mean `(n,)`.
        extra: Known variances of z `(n,)`.
        parameters: Hyperparameters `(k + 2,)` to start from, with any time scale.
    """
    if len(z) < _LEAST_FOR_DRIFT or not z.any():
        return 0.0
    rows = slice(None, None, -(-len(z) // SUBSET))
    x, z, extra = x[rows], z[rows], extra[rows]
    weak, n, at = settings.prior == "weak", len(z), kernel.size - 1
    timed = NegativeLogPosterior(kernel, x, z, extra, weak, noisy=True)
    steady = NegativeLogPosterior(kernel.without_last(), x[:, :-1], z, extra, weak, noisy=True)
    free = held_parameters(settings, kernel, 1.0)[1]
    noises = [parameters[-1], *_NOISE_LEVELS[:3]] if free[-1] else [parameters[-1]]
    # A function that takes what changed for detail has short length-scales, with which time explains little.
    levels = [
        np.concatenate([shape, [scale, parameters[-2], noise]])
        for shape in (parameters[:at], kernel.default_parameters()[:at])
        for scale in _TIME_SCALES
        for noise in noises
    ]
    levels.sort(key=lambda level: timed(level)[0])
    most = n * (min(steady(np.delete(p, at))[0] for p in levels) - timed(levels[0])[0])
    if most <= 0.0:
        return most

    plain = np.delete(parameters, at)
    clear = np.append(plain[:-1], noises[-1])
    return trained_gain(
        settings,
        Hypothesis(timed, levels[:1], free),
        Hypothesis(steady, [plain, clear], np.delete(free, at)),
    )


class Hypothesis(NamedTuple):
    """What a function may be: its posterior, hyperparameters `(k + 2,)` to start from, and which are free."""

    objective: NegativeLogPosterior
    starts: list[FloatArray]
    free: NDArray[np.bool_]

    def trained(self, settings: GaussianProcessSettings) -> tuple[FloatArray, float]:
        """Return the best hyperparameters `(k + 2,)`, and their value."""
        bounds = self.objective.bounds(settings.minimum_noise)
        starts = np.clip(self.starts, bounds[:, 0], bounds[:, 1])
        tolerance = TOLERANCE / len(self.objective.z)
        return train_lbfgs(self.objective, starts, bounds, self.free, tolerance, _STEPS)


def trained_gain(settings: GaussianProcessSettings, new: Hypothesis, former: Hypothesis) -> float:
    """Return the gain in the highest marginal likelihood, or, if that is less, in the left-out densities.

    Each observation counts for at most one in these, as for `noise_evidence`.

    Args:
        settings: Settings of the training.
        new: Hypothesis that may explain the observations better.
        former: The other one, of the same observations.
    """
    parameters, value = new.trained(settings)
    former_parameters, former_value = former.trained(settings)
    gain = len(new.objective.z) * (former_value - value)
    if gain <= 0.0:
        return gain
    gains = left_out_gains(new.objective, parameters, former.objective, former_parameters)
    return min(gain, float(gains.sum()))
