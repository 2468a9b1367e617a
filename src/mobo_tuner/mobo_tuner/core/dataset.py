"""The evaluations of a run, and the arrays that the models learn from."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mobo_tuner.core.problem import FARTHEST, LARGEST, Array, Problem, ProblemError, as_float
from mobo_tuner.core.values import as_integer, as_number

Measured = float | tuple[float, float]
"""Measured value of a diagnostic: its mean, or its mean and standard deviation."""


BoolArray = NDArray[np.bool_]


@dataclass(frozen=True)
class Evaluation:
    """One evaluation: where the machine was and what it measured.

    Attributes:
        index: Number of evaluations that were told before.
        setpoint: Every variable, in physical units, and the fidelity.
        values: Diagnostics that were told, in their own units; NaN where not measured.
        stddevs: Their standard deviations; NaN where unknown.
        readbacks: Readbacks of variables, as far as they were told; the models learn from them in
            place of the set-point's values.
        time: When it was measured [s]; where no time was told, 1 s after the evaluation before.
        reported_failed: What the machine reported; None where it reported nothing and the values decide.
        failed: Whether the machine reported a failure or, without a report, measured no objective and
            no constrained diagnostic.
        complete: Whether every objective and every constrained diagnostic was measured.
        feasible: Whether it is complete, meets every constraint and is of the highest fidelity: what a
            cheaper one reads says nothing for sure of that.
        forgotten: Whether it was withdrawn as a whole.
        forgotten_names: Diagnostics that were withdrawn from it.
    """

    index: int
    setpoint: Mapping[str, float]
    values: Mapping[str, float]
    stddevs: Mapping[str, float]
    readbacks: Mapping[str, float]
    time: float
    reported_failed: bool | None
    failed: bool
    complete: bool
    feasible: bool
    forgotten: bool = False
    forgotten_names: frozenset[str] = frozenset()

    @property
    def valid(self) -> bool:
        """Whether anything can be learned from it: neither failed nor withdrawn."""
        return not (self.failed or self.forgotten)

    def value(self, name: str) -> float:
        """Return one diagnostic as it counts: NaN where not measured, failed or withdrawn."""
        if not self.valid or name in self.forgotten_names:
            return math.nan
        return self.values.get(name, math.nan)


class Dataset:
    """Evaluations in the order in which they were told.

    Attributes:
        problem: Problem to which they belong.
        evaluations: All evaluations, including failed ones.
    """

    def __init__(self, problem: Problem) -> None:
        self.problem = problem
        self.evaluations: list[Evaluation] = []
        self._inputs: list[Array] = []
        self._targets: list[Array] = []
        # Made since the last change:
        self._arrays: dict[tuple[str, str], NDArray[Any]] = {}
        self._results: dict[Callable[[Dataset], bool], bool] = {}

    def __len__(self) -> int:
        return len(self.evaluations)

    def copy(self) -> Dataset:
        """Return a dataset with the same evaluations, to which others can be added."""
        other = Dataset(self.problem)
        other.evaluations = list(self.evaluations)
        other._inputs, other._targets = list(self._inputs), list(self._targets)
        return other

    def add(
        self,
        setpoint: Mapping[str, float],
        outputs: Mapping[str, Measured | None],
        readbacks: Mapping[str, float] = {},
        failed: bool | None = None,
        time: float | None = None,
    ) -> Evaluation:
        """Append one evaluation.

        Args:
            setpoint: Every variable, in physical units.
            outputs: Diagnostics by name; a pair is (mean, standard deviation); NaN, infinite, None,
                missing or a sentinel (`Problem.is_reading`) means not measured.
            readbacks: Some variables' readbacks, in physical units; one that is not finite, or
                farther from the bounds than a set-point may be, is not known.
            failed: Whether the machine reported a failure; None lets the outputs decide: the
                evaluation failed if no objective and no constrained diagnostic was measured.
            time: When it was measured, from any fixed moment on [s]; None for 1 s after the evaluation
                before.

        Raises:
            ProblemError: If the set-point is not one of the problem's, a readback is of none of its
                variables, or an output is not a number.
        """
        target = self.problem.normalize(setpoint)
        fidelity = self.problem.fidelity_of(setpoint)
        x, known = self._location(target, readbacks)
        if not isinstance(outputs, Mapping):
            raise ProblemError(f"the outputs must be a mapping of names, not {outputs!r:.60}")
        measured = {name: self._measured(name, value) for name, value in outputs.items()}
        when = self._time(time)
        if failed is not None and not isinstance(failed, bool | np.bool_):
            raise ProblemError(f"failed is {failed!r:.60}; True, False and None are allowed")
        for name, result in self.problem.derive({**setpoint, **known}, measured).items():
            measured[name] = (result.value, result.stddev)
        values = {name: mean for name, (mean, _) in measured.items()}
        if failed is None:
            required = self.problem.required_diagnostics
            inferred = not any(
                math.isfinite(values.get(name, math.nan))
                for name in required
                if name not in self.problem.known_before
            )
        else:
            failed = inferred = bool(failed)
        evaluation = self._judged(
            Evaluation(
                index=len(self.evaluations),
                setpoint={v.name: float(setpoint[v.name]) for v in self.problem.variables}
                | fidelity,
                values=values,
                stddevs={name: stddev for name, (_, stddev) in measured.items()},
                readbacks=known,
                time=when,
                reported_failed=failed,
                failed=inferred,
                complete=False,
                feasible=False,
            )
        )
        self.evaluations.append(evaluation)
        self._inputs.append(x)
        self._targets.append(target)
        return evaluation

    def forget(self, index: int, name: str | None = None) -> None:
        """Withdraw an evaluation, or one diagnostic of it: it counts as never measured.

        Args:
            index: Index of the evaluation.
            name: Diagnostic to withdraw; the whole evaluation without it.

        Raises:
            ProblemError: If there is no such evaluation or it has no such diagnostic.
        """
        evaluation = self._evaluation(index, name)
        if name is None:
            changed = replace(evaluation, forgotten=True)
        else:
            names = {name, *self._derived_from([name])}
            changed = replace(evaluation, forgotten_names=evaluation.forgotten_names | names)
        self.evaluations[index] = self._judged(changed)

    def unforget(self, index: int, name: str | None = None) -> None:
        """Take back what `forget` withdrew: one diagnostic, or all of an evaluation.

        Arguments and errors are those of `forget`.
        """
        evaluation = self._evaluation(index, name)
        if name is None:
            changed = replace(evaluation, forgotten=False, forgotten_names=frozenset())
        else:
            others = evaluation.forgotten_names - {name, *self._derived_from([name])}
            changed = replace(evaluation, forgotten_names=others | self._derived_from(others))
        self.evaluations[index] = self._judged(changed)

    @property
    def withdrawn(self) -> list[tuple[int, str | None]]:
        """Withdrawn evaluations and diagnostics: index, and the diagnostic's name or None for all of it."""
        whole: list[tuple[int, str | None]] = [
            (e.index, None) for e in self.evaluations if e.forgotten
        ]
        return whole + [(e.index, n) for e in self.evaluations for n in sorted(e.forgotten_names)]

    def _derived_from(self, names: Collection[str]) -> frozenset[str]:
        """Return the derived quantities with one of the names in their formulas."""
        return frozenset(d.name for d in self.problem.derived if set(d.names) & set(names))

    def _evaluation(self, index: int, name: str | None) -> Evaluation:
        """Return an evaluation of which `name` was told."""
        if not self.evaluations:
            raise ProblemError(f"index is {index!r:.60}; there is no evaluation yet")
        evaluation = self.evaluations[as_integer("index", index, 0, len(self) - 1)]
        if name is not None and not (isinstance(name, str) and name in evaluation.values):
            raise ProblemError(
                f"name is {name!r}; evaluation {index} has {', '.join(evaluation.values) or 'none'}"
            )
        return evaluation

    def _judged(self, evaluation: Evaluation) -> Evaluation:
        """Return the evaluation with what follows from its values."""
        values = {name: evaluation.value(name) for name in self.problem.required_diagnostics}
        self._arrays.clear()
        self._results.clear()
        complete = all(math.isfinite(value) for value in values.values())
        feasible = complete and self.problem.is_feasible(values)
        if self.problem.fidelity:
            feasible = feasible and self.problem.fidelity.is_highest(evaluation.setpoint)
        return replace(evaluation, complete=complete, feasible=feasible)

    def _location(
        self, target: Array, readbacks: Mapping[str, float]
    ) -> tuple[Array, dict[str, float]]:
        """Return where the machine was, normalised, and the readbacks that are known."""
        x = target.copy()
        if not isinstance(readbacks, Mapping):
            raise ProblemError(f"the readbacks must be a mapping of names, not {readbacks!r:.60}")
        known = {}
        for name, value in readbacks.items():
            if name not in self.problem.variable_names:
                raise ProblemError(
                    f"the readback '{name}' is unknown; allowed are "
                    f"{', '.join(self.problem.variable_names)}"
                )
            readback = as_float(f"readback {name}", value)
            j = self.problem.variable_names.index(name)
            where = self.problem.variables[j].normalize(readback)
            if abs(where) <= 2.0 * FARTHEST:
                known[name] = readback
                x[j] = where
        return x, known

    def _time(self, time: float | None) -> float:
        """Return the time of the next evaluation."""
        if time is None:
            return self.evaluations[-1].time + 1.0 if self.evaluations else 0.0
        return as_number("time", time)

    def _measured(self, name: str, value: Measured | None) -> tuple[float, float]:
        """Return mean and standard deviation; NaN if not measured or unknown."""
        if not isinstance(name, str):
            raise ProblemError(f"the name of an output must be text, not {name!r:.60}")
        if value is None:
            return math.nan, math.nan
        pair = value if isinstance(value, tuple | list) else (value, math.nan)
        if len(pair) != 2:
            raise ProblemError(
                f"output '{name}' must be a number or a pair (mean, standard deviation), not a list "
                f"of {len(pair)}"
            )
        mean, stddev = (math.nan if v is None else as_float(f"output '{name}'", v) for v in pair)
        mean = mean if self.problem.is_reading(name, mean) else math.nan
        return mean, stddev if 0.0 <= stddev <= LARGEST else math.nan

    @property
    def inputs(self) -> Array:
        """Normalised inputs of all evaluations ``(n, d)``: readbacks where known, else set-points."""
        return self._once("inputs", lambda: self._matrix(self._inputs))

    @property
    def targets(self) -> Array:
        """Normalised set-points of all evaluations ``(n, d)``."""
        return self._once("targets", lambda: self._matrix(self._targets))

    def lack(self, setpoint: Mapping[str, float]) -> Array:
        """Return how far a set-point is from the highest fidelity ``(f,)``, see `Fidelity.lack`."""
        fidelity = self.problem.fidelity
        return fidelity.lack(fidelity.of(setpoint)) if fidelity else np.empty(0)

    @property
    def lacks(self) -> Array:
        """How far each evaluation is from the highest fidelity ``(n, f)``, see `Fidelity.lack`."""
        return self._once(
            "lacks",
            lambda: np.array([self.lack(e.setpoint) for e in self.evaluations]).reshape(
                len(self), len(self.lack({}))
            ),
        )

    @property
    def highest(self) -> BoolArray:
        """Whether each evaluation is of the highest fidelity ``(n,)``."""
        fidelity = self.problem.fidelity
        if fidelity is None:
            return np.ones(len(self), dtype=bool)
        return self._once("highest", lambda: self._flags(lambda e: fidelity.is_highest(e.setpoint)))

    @property
    def times(self) -> Array:
        """When each evaluation was measured ``(n,)`` [s]."""
        return self._once("times", lambda: np.array([e.time for e in self.evaluations]))

    @property
    def failed(self) -> BoolArray:
        """Whether each evaluation failed and was not withdrawn ``(n,)``."""
        return self._once(
            "failed",
            lambda: np.array([e.failed and not e.forgotten for e in self.evaluations], dtype=bool),
        )

    @property
    def forgotten(self) -> BoolArray:
        """Whether each evaluation was withdrawn as a whole ``(n,)``."""
        return self._once("forgotten", lambda: self._flags(lambda e: e.forgotten))

    @property
    def valid(self) -> BoolArray:
        """Whether each evaluation neither failed nor was withdrawn ``(n,)``."""
        return self._once("valid", lambda: self._flags(lambda e: e.valid))

    @property
    def complete(self) -> BoolArray:
        """Whether each evaluation has every objective and constrained diagnostic ``(n,)``."""
        return self._once("complete", lambda: self._flags(lambda e: e.complete))

    @property
    def feasible(self) -> BoolArray:
        """Whether each evaluation is complete and meets every constraint ``(n,)``."""
        return self._once("feasible", lambda: self._flags(lambda e: e.feasible))

    @property
    def objectives(self) -> Array:
        """Minimised objectives of all evaluations ``(n, P)``; NaN where not measured."""
        signs = np.array([o.sign for o in self.problem.objectives])
        columns = [self.column(name) for name in self.problem.objective_names]
        return np.column_stack(columns) * signs if columns else np.empty((len(self), 0))

    def column(self, name: str) -> Array:
        """Return the values of one diagnostic in its unit ``(n,)``; NaN where it does not count."""
        return self._once(
            "column", lambda: np.array([e.value(name) for e in self.evaluations], dtype=float), name
        )

    def stddev_column(self, name: str) -> Array:
        """Return the standard deviations of one diagnostic ``(n,)``; NaN where unknown."""
        return self._once(
            "stddev",
            lambda: np.array(
                [e.stddevs.get(name, math.nan) for e in self.evaluations], dtype=float
            ),
            name,
        )

    def lasting(self, name: str) -> Array:
        """Return the values of one diagnostic, which last until the next reading ``(n,)``.

        Readings of failed evaluations count, too. The first one also counts for those before it; all are
        NaN if there is none.
        """
        return self._once("lasting", lambda: self._lasting(name), name)

    def _lasting(self, name: str) -> Array:
        values = np.array(
            [
                math.nan
                if e.forgotten or name in e.forgotten_names
                else e.values.get(name, math.nan)
                for e in self.evaluations
            ],
            dtype=float,
        )
        known = np.flatnonzero(np.isfinite(values))
        if len(known):
            latest = np.searchsorted(known, np.arange(len(values)), side="right") - 1
            values = values[known[np.maximum(latest, 0)]]
        return values

    def last_reading(self, name: str) -> tuple[int, float] | None:
        """Return the index and the value of the last reading of one diagnostic; None if there is none."""
        for e in reversed(self.evaluations):
            value = math.nan if name in e.forgotten_names else e.values.get(name, math.nan)
            if math.isfinite(value) and not e.forgotten:
                return e.index, value
        return None

    def once(self, function: Callable[[Dataset], bool]) -> bool:
        """Return the result of a function of this dataset, computed once until something changes."""
        if function not in self._results:
            self._results[function] = function(self)
        return self._results[function]

    def _once(self, kind: str, make: Callable[[], NDArray[Any]], name: str = "") -> NDArray[Any]:
        """Return an array that is made once until something changes; it is read-only."""
        if (kind, name) not in self._arrays:
            array = make()
            array.setflags(write=False)
            self._arrays[kind, name] = array
        return self._arrays[kind, name]

    def _flags(self, flag: Callable[[Evaluation], bool]) -> BoolArray:
        return np.array([flag(e) for e in self.evaluations], dtype=bool)

    def _matrix(self, rows: list[Array]) -> Array:
        return np.array(rows).reshape(len(rows), len(self.problem.variables))
