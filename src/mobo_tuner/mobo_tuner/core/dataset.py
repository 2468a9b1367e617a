"""The evaluations of a run, and the arrays that the models learn from."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from mobo_tuner.core.problem import Array, Problem, ProblemError

Measured = float | tuple[float, float]
"""What is told of a diagnostic: its mean, or its mean and standard deviation."""


@dataclass(frozen=True)
class Evaluation:
    """One evaluation: where the machine was and what it measured.

    `values` and `stddevs` hold the diagnostics that were told, in their own units; NaN stands for
    not measured and for an unknown uncertainty. `readbacks` hold where variables were by their own
    instruments, as far as that was told; where it was, the models learn from it. An evaluation is
    `valid` when every objective and every constrained diagnostic was measured, `feasible` when it is
    valid and meets every constraint.
    """

    index: int
    setpoint: Mapping[str, float]
    values: Mapping[str, float]
    stddevs: Mapping[str, float]
    readbacks: Mapping[str, float]
    valid: bool
    feasible: bool


class Dataset:
    """Evaluations in the order in which they were told.

    Attributes:
        problem: the problem to which they belong.
        evaluations: all of them, failed ones included.
    """

    def __init__(self, problem: Problem) -> None:
        self.problem = problem
        self.evaluations: list[Evaluation] = []
        self._inputs: list[Array] = []

    def __len__(self) -> int:
        return len(self.evaluations)

    def add(
        self,
        setpoint: Mapping[str, float],
        outputs: Mapping[str, Measured | None],
        readbacks: Mapping[str, float] = {},
    ) -> Evaluation:
        """Append one evaluation.

        Args:
            setpoint: every variable, in physical units.
            outputs: diagnostics by name; a pair is (mean, standard deviation); NaN, infinite, None
                or missing means that it was not measured.
            readbacks: of some variables, in physical units; one that is not finite is not known.

        Raises:
            ProblemError: the set-point is not one of the problem's, a readback is of none of its
                variables, or an output is not a number.
        """
        self.problem.normalize(setpoint)
        known = {name: float(value) for name, value in readbacks.items() if math.isfinite(value)}
        x = self.problem.normalize({**setpoint, **known})
        measured = {name: _mean_and_stddev(name, value) for name, value in outputs.items()}
        values = {name: mean for name, (mean, _) in measured.items()}
        valid = all(
            math.isfinite(values.get(name, math.nan)) for name in self.problem.required_diagnostics
        )
        evaluation = Evaluation(
            index=len(self.evaluations),
            setpoint={v.name: float(setpoint[v.name]) for v in self.problem.variables},
            values=values,
            stddevs={name: stddev for name, (_, stddev) in measured.items()},
            readbacks=known,
            valid=valid,
            feasible=valid and self.problem.is_feasible(values),
        )
        self.evaluations.append(evaluation)
        self._inputs.append(x)
        return evaluation

    @property
    def inputs(self) -> Array:
        """Where all evaluations were, normalised, shape ``(n, d)``: readbacks, or set-points."""
        return np.array(self._inputs).reshape(len(self), len(self.problem.variables))

    @property
    def valid(self) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
        """Which evaluations are valid, shape ``(n,)``."""
        return np.array([e.valid for e in self.evaluations], dtype=bool)

    @property
    def feasible(self) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
        """Which evaluations are feasible, shape ``(n,)``."""
        return np.array([e.feasible for e in self.evaluations], dtype=bool)

    @property
    def objectives(self) -> Array:
        """Minimised objectives of all evaluations, shape ``(n, P)``; NaN where not measured."""
        signs = np.array([o.sign for o in self.problem.objectives])
        columns = [self.column(name) for name in self.problem.objective_names]
        return np.column_stack(columns) * signs if columns else np.empty((len(self), 0))

    def column(self, name: str) -> Array:
        """Values of one diagnostic, in its own unit, shape ``(n,)``; NaN where not measured."""
        return np.array([e.values.get(name, math.nan) for e in self.evaluations], dtype=float)

    def stddev_column(self, name: str) -> Array:
        """Standard deviations of one diagnostic, shape ``(n,)``; NaN where unknown."""
        return np.array([e.stddevs.get(name, math.nan) for e in self.evaluations], dtype=float)


def _mean_and_stddev(name: str, value: Measured | None) -> tuple[float, float]:
    if value is None:
        return math.nan, math.nan
    pair = value if isinstance(value, tuple | list) else (value, math.nan)
    if len(pair) != 2:
        raise ProblemError(
            f"output '{name}' must be a number or a pair (mean, standard deviation), not {value!r}"
        )
    try:
        mean, stddev = (float(v) for v in pair)
    except (TypeError, ValueError):
        raise ProblemError(
            f"output '{name}' must be a number or a pair (mean, standard deviation), not {value!r}"
        ) from None
    mean = mean if math.isfinite(mean) else math.nan
    return mean, stddev if math.isfinite(stddev) and stddev >= 0.0 else math.nan
