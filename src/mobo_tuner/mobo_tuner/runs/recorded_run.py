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
from mobo_tuner.core.problem import Array, Problem, ProblemError
from mobo_tuner.runs.history import History
from mobo_tuner.runs.journal import JournalError, Record

BoolArray = NDArray[np.bool_]

UNFINISHED = "unfinished"  # stop reason of a run without an end: it goes on, or was killed


@dataclass(frozen=True)
class RecordedRun:
    """A run of n evaluations in P objectives.

    Attributes:
        run_id: its name.
        problem: what was tuned, as it was in the end.
        settings: what the tuner was set to.
        started: when it started [s since the epoch]; NaN if unknown.
        finished: when it ended; NaN if unknown or if it did not.
        stop_reason: ``budget``, ``hypervolume_goal``, ``canceled``, ``error`` or ``unfinished``.
        error_msg: one sentence after an error; empty otherwise.
        indices: of the evaluations, shape ``(n,)``.
        setpoints: as they were asked for.
        objectives: as measured, in their own units, shape ``(n, P)``; NaN where not measured.
        initial, valid, feasible: of what kind each evaluation is, shape ``(n,)`` each; by the problem
            as it was in the end.
        hypervolumes: after each evaluation, shape ``(n,)``.
        suggest_seconds, machine_seconds, total_seconds: of each evaluation, shape ``(n,)`` each.
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
    def from_records(cls, records: Sequence[Record]) -> RecordedRun:
        """Build it from the records of a journal.

        Raises:
            JournalError: a record lacks what it should hold.
        """
        start = records[0]
        evaluations = [record for record in records if record["type"] == "evaluation"]
        ends = [record for record in records if record["type"] == "end"]
        end: Record = ends[-1] if ends else {"stop_reason": UNFINISHED}
        changes = [record for record in records if record["type"] == "change"]
        try:
            problem = Problem.from_dict((changes[-1] if changes else start)["problem"])
            valid = np.array([e["valid"] for e in evaluations], dtype=bool)
            feasible = np.array([e["feasible"] for e in evaluations], dtype=bool)
            if changes:
                valid, feasible = _judge_anew(records, problem)
            objectives = [
                [_mean(e["diagnostics"].get(name)) for name in problem.objective_names]
                for e in evaluations
            ]
            values = np.array(objectives, dtype=float).reshape(
                len(evaluations), len(problem.objectives)
            )
            settings = start.get("settings") or {}
            initial = settings.get("initial_evaluations") or 2 * (len(problem.variables) + 1)
            signs = [o.sign for o in problem.objectives]
            problem = problem.with_references(values * signs, valid, feasible, initial)
            return cls(
                run_id=str(start["run_id"]),
                problem=problem,
                settings=settings,
                started=_number(start.get("stamp")),
                finished=_number(end.get("stamp")),
                stop_reason=str(end["stop_reason"]),
                error_msg=str(end.get("error_msg") or ""),
                indices=np.array([e["index"] for e in evaluations], dtype=np.int64),
                setpoints=[e["setpoint"] for e in evaluations],
                objectives=values,
                initial=np.array([e["source"] == "initial" for e in evaluations], dtype=bool),
                valid=valid,
                feasible=feasible,
                hypervolumes=_column(evaluations, "hypervolume"),
                suggest_seconds=_column(evaluations, "suggest_seconds"),
                machine_seconds=_column(evaluations, "machine_seconds"),
                total_seconds=_column(evaluations, "total_seconds"),
            )
        except JournalError:
            raise
        except KeyError as error:
            raise JournalError(f"a record of the journal lacks {error}") from None
        except ProblemError as error:
            raise JournalError(f"the journal holds no problem: {error}") from None
        except (AttributeError, TypeError, ValueError) as error:
            raise JournalError(f"a record of the journal is not as it should be: {error}") from None

    @property
    def signs(self) -> Array:
        """By which the objectives are multiplied to be minimised, shape ``(P,)``."""
        return np.array([o.sign for o in self.problem.objectives])

    @property
    def front(self) -> NDArray[np.int64]:
        """Rows of the Pareto front: feasible, better than the reference point, not dominated."""
        minimised = self.objectives * self.signs
        rows = np.flatnonzero(self.feasible & is_below(minimised, self.problem.reference_point))
        return rows[is_nondominated(minimised[rows])] if len(rows) else rows

    @property
    def hypervolume(self) -> float:
        """Of the front at the end; 0 before the first evaluation."""
        return float(self.hypervolumes[-1]) if len(self.hypervolumes) else 0.0

    @property
    def overhead_seconds(self) -> Array:
        """What an evaluation took beyond the suggestion and the machine, shape ``(n,)`` [s]."""
        return self.total_seconds - self.suggest_seconds - self.machine_seconds


def _judge_anew(records: Sequence[Record], problem: Problem) -> tuple[BoolArray, BoolArray]:
    """Which evaluations are valid, and which feasible, where the problem was changed amid them."""
    dataset = Dataset(problem)
    for told in History.from_records(records).evaluations:
        dataset.add(told.setpoint, told.outputs)
    return dataset.valid, dataset.feasible


def _column(evaluations: Sequence[Record], key: str) -> Array:
    return np.array([_number(e[key]) for e in evaluations], dtype=float)


def _mean(measured: Any) -> float:
    """The mean of a diagnostic's pair (mean, standard deviation)."""
    return math.nan if measured is None else _number(measured[0])


def _number(value: Any) -> float:
    """A journal holds null for what is not finite."""
    return math.nan if value is None else float(value)
