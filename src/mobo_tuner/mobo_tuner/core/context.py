"""Inputs of the models that nobody sets: when an evaluation was measured."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Self

import numpy as np

from mobo_tuner.core.dataset import Dataset
from mobo_tuner.core.kernels import LONGEST_TIME_SCALE
from mobo_tuner.core.problem import Array

_TIME_UNIT = 100  # evaluations in a unit of time, if none is given


@dataclass(frozen=True)
class Context:
    """Time as an input of the models, or none.

    Attributes:
        timed: Whether time is an input, which is then the last one.
        latest: Latest time at the last training [s].
        unit: Unit of time [s].
    """

    timed: bool
    latest: float = 0.0
    unit: float = 1.0

    @classmethod
    def of(cls, timed: bool, times: Array, unit: float) -> Self:
        """Return the context of models that are trained now.

        Args:
            timed: Whether time is an input.
            times: When each evaluation was measured ``(n,)`` [s].
            unit: Time in which the machine changes noticeably [s]; 0 for the order of magnitude in
                which that would matter to a run.
        """
        if not unit:
            steps = np.diff(np.sort(times))
            unit = _TIME_UNIT * (float(np.median(steps)) if len(steps) else 1.0)
        return cls(timed, float(times.max(initial=-math.inf)), unit or 1.0)

    def times(self, data: Dataset) -> Array:
        """Return when each evaluation was measured ``(n,)``, before the last training, in units of time."""
        # What is older than any time scale would only cost digits.
        return np.maximum((data.times - self.latest) / self.unit, -LONGEST_TIME_SCALE)

    def inputs(self, data: Dataset) -> Array:
        """Return the inputs of the models ``(n, d)``."""
        return np.column_stack([data.inputs, self.times(data)]) if self.timed else data.inputs

    def now(self, data: Dataset, held: int) -> float:
        """Return the latest time of the first `held` evaluations, in units of time."""
        return float(self.times(data)[:held].max(initial=-math.inf))
