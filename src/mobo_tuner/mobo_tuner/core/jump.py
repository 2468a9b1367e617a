"""When did a machine change at once, as after a repair or a new calibration?"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cache

import numpy as np
from numpy.typing import NDArray

from mobo_tuner.core.arrays import FloatArray
from mobo_tuner.core.context import ContextInputs
from mobo_tuner.core.context_kernel import Contextual
from mobo_tuner.core.dataset import Dataset
from mobo_tuner.core.evidence import NEGLIGIBLE_NOISE, Hypothesis, trained_gain
from mobo_tuner.core.gaussian_process_settings import GaussianProcessSettings
from mobo_tuner.core.kernels import Kernel
from mobo_tuner.core.linear_algebra import single_blas_thread
from mobo_tuner.core.training import SUBSET, NegativeLogPosterior, held_parameters

_LONG = float(np.log(30.0))  # time scale of a function that changes by jumps only, in units of time
_FEWEST = 5  # evaluations before and after a jump that say anything of it
_STRIDE = 8  # evaluations between those that are tried first
_OPEN = 2  # evaluations by which the best one without a training may be off
_HOPELESS = -10.0  # log evidence of an output, without a training, below which there is no jump
_JUMPS = (
    10.0  # log evidence of all outputs from which on the machine is taken to have changed at once
)


class JumpEvidence:
    """Log evidence that a function changed at once, against one that changes as was believed so far.

    Args:
        settings: Settings of the training.
        kernel: Covariance function of d inputs, the last of them time.
        x: Inputs `(n, d)`; the latest observations are looked at.
        z: Standardised outputs less the prior mean `(n,)`.
        extra: Known variances of z `(n,)`.
        parameters: Trained hyperparameters `(k + 2,)`, with any time scale if time was no input.
        timed: Whether it was.
    """

    def __init__(
        self,
        settings: GaussianProcessSettings,
        kernel: Contextual,
        x: FloatArray,
        z: FloatArray,
        extra: FloatArray,
        parameters: FloatArray,
        timed: bool,
    ) -> None:
        self._settings, self._kernel, self._x = settings, kernel, x[-SUBSET:]
        self._z, self._extra = z[-SUBSET:], extra[-SUBSET:]
        self._free = held_parameters(settings, kernel, 1.0)[1]
        self._scale = kernel.size - 1  # position of the time scale
        self._kept = np.arange(len(parameters)) != (len(parameters) if timed else self._scale)
        inputs = self._x if timed else self._x[:, :-1]
        self._former = self._objective(kernel if timed else kernel.without_last(), inputs)
        self._trained = parameters
        self._without = self._former(parameters[self._kept])[0]
        noises = [parameters[-1], NEGLIGIBLE_NOISE] if self._free[-1] else [parameters[-1]]
        # A function that takes what changed for detail has short length-scales.
        self._default = kernel.default_parameters()
        self._starts = [
            np.concatenate([shape[: self._scale], [_LONG, parameters[-2], noise]])
            for shape in (parameters, self._default)
            for noise in noises
        ]

    def _objective(self, kernel: Kernel, x: FloatArray) -> NegativeLogPosterior:
        weak = self._settings.prior == "weak"
        return NegativeLogPosterior(kernel, x, self._z, self._extra, weak, noisy=True)

    def _jumping(self, times: FloatArray) -> NegativeLogPosterior:
        return self._objective(self._kernel, np.column_stack([self._x[:, :-1], times[-SUBSET:]]))

    def rough(self, times: FloatArray) -> float:
        """Return the gain in the marginal likelihood, without a training.

        Args:
            times: Times of all observations `(n,)`, much of which passes in the jump.
        """
        objective = self._jumping(times)
        return len(self._z) * (self._without - min(objective(p)[0] for p in self._starts))

    def full(self, times: FloatArray) -> float:
        """Return the gain in the highest marginal likelihood, or, if less, in the left-out densities.

        Args:
            times: As for `rough`.
        """
        jumping = self._jumping(times)
        start = min(self._starts, key=lambda p: jumping(p)[0])
        kept = self._kept
        plain = [self._trained[kept], np.append(self._default, self._trained[-2:])[kept]]
        return trained_gain(
            self._settings,
            Hypothesis(jumping, [start], self._free),
            Hypothesis(self._former, plain, self._free[kept]),
        )


@single_blas_thread()
def find_jump(
    context: ContextInputs,
    data: Dataset,
    outputs: Sequence[tuple[JumpEvidence, NDArray[np.intp]]],
) -> float | None:
    """Return when the machine changed at once, after the last time that it did [s]; None if it did not.

    Args:
        context: Inputs beside the variables.
        data: Evaluations.
        outputs: Evidence of each output, and which evaluations it rests on.
    """
    moments = np.unique(data.times)
    after = int(np.searchsorted(moments, context.jumps[-1:]).max(initial=0))
    candidates = np.arange(max(after, len(moments) - SUBSET) + _FEWEST, len(moments))
    outputs = [(evidence, rows) for evidence, rows in outputs if len(rows) >= 2 * _FEWEST]
    if len(candidates) == 0 or not outputs:
        return None

    def times(position: int) -> FloatArray:
        jumps = (*context.jumps, float(moments[position]))
        return replace(context, jumps=jumps).times(data)

    @cache
    def rough(position: int) -> float:
        at = times(position)
        return sum((evidence.rough(at[rows]) for evidence, rows in outputs), 0.0)

    def full(position: int) -> float:
        at = times(position)
        return sum(max(evidence.full(at[rows]), 0.0) for evidence, rows in outputs)

    coarse = max(candidates[::_STRIDE], key=rough)
    best = max(candidates[np.abs(candidates - coarse) < _STRIDE], key=rough)
    if best > len(moments) - _FEWEST or rough(best) < _HOPELESS * len(outputs):
        return None
    if full(best) <= _JUMPS:
        return None
    # Hyperparameters that were trained with other eras leave it open by one evaluation or two.
    near = candidates[np.abs(candidates - best) <= _OPEN]
    return float(moments[max(near, key=full)])
