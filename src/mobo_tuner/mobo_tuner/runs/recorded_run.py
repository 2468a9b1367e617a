"""A run as its journal tells it: the arrays from which reports are made."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mobo_tuner.core.dataset import Dataset
from mobo_tuner.core.pareto import is_below, is_nondominated
from mobo_tuner.core.problem import Array, Problem
from mobo_tuner.runs.history import History, told_of
from mobo_tuner.runs.journal import JsonRecord

BoolArray = NDArray[np.bool_]

UNFINISHED = "unfinished"  # stop reason of a run without an end: it continues, or was killed


@dataclass(frozen=True)
class RecordedRun:
    """A run of n evaluations in P objectives.

    Attributes:
        run_id: Name of the run.
        problem: Problem at the end.
        settings: Settings of the tuner.
        started: When it started [s since the epoch]; NaN if unknown.
        finished: When it ended; NaN if unknown or if it did not.
        stop_reason: ``budget``, ``hypervolume_goal``, ``canceled``, ``error`` or ``unfinished``.
        error_msg: One sentence after an error; empty otherwise.
        indices: Indices of the evaluations, shape ``(n,)``.
        setpoints: Set-points as they were asked for.
        objectives: Objectives as measured, in their own units, shape ``(n, P)``; NaN if not measured.
        initial, valid, feasible: Kind of each evaluation, shape ``(n,)`` each; by the problem at the end.
        hypervolumes: Hypervolume after each evaluation, shape ``(n,)``.
        suggest_seconds, machine_seconds, total_seconds: Times of each evaluation, shape ``(n,)`` each [s].
    """

    run_id: str
    problem: Problem
    settings: Mapping[str, Any]
    started: float
    finished: float
    stop_reason: str
    error_msg: str
    indices: NDArray[np.int64]
    setpoints: Sequence[Mapping[str, float]]
    objectives: Array
    initial: BoolArray
    valid: BoolArray
    feasible: BoolArray
    hypervolumes: Array
    suggest_seconds: Array
    machine_seconds: Array
    total_seconds: Array

    @classmethod
    def from_records(cls, records: Sequence[JsonRecord]) -> RecordedRun:
        """Build it from the records of a journal.

        Raises:
            JournalError: If a record is not valid.
        """
        history = History.from_records(records)
        evaluations, end = history.evaluations, history.end
        problem = history.last_problem
        valid = np.array([e.valid for e in evaluations], dtype=bool)
        feasible = np.array([e.feasible for e in evaluations], dtype=bool)
        if history.changes:
            dataset = Dataset(problem)
            for evaluation in evaluations:
                dataset.add(*told_of(evaluation, problem, history.model_input))
            valid, feasible = dataset.valid, dataset.feasible
        unknown = (math.nan, math.nan)
        objectives = np.array(
            [
                [e.diagnostics.get(name, unknown)[0] for name in problem.objective_names]
                for e in evaluations
            ],
            dtype=float,
        ).reshape(len(evaluations), len(problem.objectives))
        initial = history.settings.get("initial_evaluations") or 2 * (len(problem.variables) + 1)
        signs = [o.sign for o in problem.objectives]
        problem = problem.with_references(objectives * signs, valid, feasible, initial)

        def column(name: str) -> Array:
            return np.array([getattr(e, name) for e in evaluations], dtype=float)

        return cls(
            run_id=history.run_id,
            problem=problem,
            settings=history.settings,
            started=history.start.stamp,
            finished=end.stamp if end else math.nan,
            stop_reason=end.stop_reason if end else UNFINISHED,
            error_msg=end.error_msg if end else "",
            indices=np.array([e.index for e in evaluations], dtype=np.int64),
            setpoints=[e.setpoint for e in evaluations],
            objectives=objectives,
            initial=np.array([e.source == "initial" for e in evaluations], dtype=bool),
            valid=valid,
            feasible=feasible,
            hypervolumes=column("hypervolume"),
            suggest_seconds=column("suggest_seconds"),
            machine_seconds=column("machine_seconds"),
            total_seconds=column("total_seconds"),
        )

    @property
    def signs(self) -> Array:
        """Factors by which the objectives are multiplied to be minimised, shape ``(P,)``."""
        return np.array([o.sign for o in self.problem.objectives])

    @property
    def front(self) -> NDArray[np.int64]:
        """Rows of the Pareto front: feasible, better than the reference point, not dominated."""
        minimised = self.objectives * self.signs
        rows = np.flatnonzero(self.feasible & is_below(minimised, self.problem.reference_point))
        return rows[is_nondominated(minimised[rows])] if len(rows) else rows

    @property
    def hypervolume(self) -> float:
        """Hypervolume of the front at the end; 0 before the first evaluation."""
        return float(self.hypervolumes[-1]) if len(self.hypervolumes) else 0.0

    @property
    def overhead_seconds(self) -> Array:
        """Time of each evaluation beyond the suggestion and the machine, shape ``(n,)`` [s]."""
        return self.total_seconds - self.suggest_seconds - self.machine_seconds
