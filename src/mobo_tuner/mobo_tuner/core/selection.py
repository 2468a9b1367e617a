"""The evaluations that models learn from, where there are too many for all of them."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from mobo_tuner.core.dataset import Dataset
from mobo_tuner.core.exploration import spread_out
from mobo_tuner.core.pareto import is_nondominated
from mobo_tuner.core.problem import Array

_MOST_ROWS = 500  # evaluations that a model learns from
_LEAST_ROWS = 100
_SECONDS_OF_ALL = 0.5  # time budget of a suggestion from which on models learn from as many


class Selection:
    """Choice of the evaluations that matter most.

    The models' costs grow as the cube of the evaluations, and those of a prediction as the square.

    Args:
        seconds: Time budget of a suggestion [s]; infinite if there is none.
    """

    def __init__(self, seconds: float) -> None:
        self._is_hurried = math.isfinite(seconds)
        self._most = _MOST_ROWS
        if seconds < _SECONDS_OF_ALL:
            self._most = max(round(_MOST_ROWS * math.sqrt(seconds / _SECONDS_OF_ALL)), _LEAST_ROWS)
        self._last: tuple[bytes, NDArray[np.intp]] = (b"", np.empty(0, dtype=np.intp))

    def of_outputs(self, data: Dataset, inputs: Array, rows: NDArray[np.intp]) -> NDArray[np.intp]:
        """Return the evaluations from which the model of an output learns, in their order.

        These are all, or the last ones, points of the front, and what fills the space best.

        Args:
            data: Evaluations.
            inputs: Inputs of the models ``(n, d)``.
            rows: Evaluations in which the output was measured.
        """
        if len(rows) <= self._most:
            return rows
        objectives, feasible = data.objectives[rows], data.feasible[rows]
        key = b"".join(part.tobytes() for part in (rows, inputs[rows], objectives, feasible))
        if self._last[0] != key:  # it is the same for most outputs
            good = rows[is_nondominated(objectives) & feasible]
            last = rows[-self._most // 4 :]
            self._last = key, spread_out(inputs, rows, [last, good], self._most)
        return self._last[1]

    def of_failures(self, data: Dataset, count: int) -> NDArray[np.intp]:
        """Return the evaluations from which the model of validity learns.

        Args:
            data: Evaluations.
            count: Number of evaluations that it may know.
        """
        rows = np.flatnonzero(~data.forgotten[:count])
        if len(rows) <= self._most // 2 or (len(rows) <= self._most and not self._is_hurried):
            return rows
        most = self._most // 2 if self._is_hurried else self._most
        return spread_out(data.inputs, rows, [rows[data.failed[rows]]], most)
