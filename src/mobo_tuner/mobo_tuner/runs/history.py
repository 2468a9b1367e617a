"""The history of a run from its journal, which is sufficient to replay the run.

Nothing in a journal is trusted: invalid content is reported in one sentence.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

from mobo_tuner.core.dataset import Measured
from mobo_tuner.core.problem import Problem
from mobo_tuner.runs.journal import JournalError, JsonRecord
from mobo_tuner.runs.records import (
    ChangeRecord,
    EndRecord,
    EvaluationRecord,
    ForgetRecord,
    Measurements,
    MoveRecord,
    QueuedRecord,
    Record,
    StartRecord,
    StateRecord,
    Values,
    from_json,
)

SETPOINT, READBACK = "setpoint", "readback"
"""Input of the tuner's models."""

MODEL, INPUTS, OUTPUTS = PRIOR = "prior_mean.model", "prior_mean.inputs", "prior_mean.outputs"
"""Settings of the tuner that say which model predicts the machine."""

MACHINE_ERROR = 4
"""Error code of `Tune.Result`: evaluations failed."""

INVALID_MEASUREMENT = 5
"""Error code of `EvaluateSetpoint.Result`: a diagnostic could not be measured."""

CANCELED = 6
"""Error code of `EvaluateSetpoint.Result`: the evaluation was skipped."""

Step = EvaluationRecord | ChangeRecord | ForgetRecord


class Move(NamedTuple):
    """A move that is not part of an evaluation, and where it ended; None if that is not known."""

    asked: MoveRecord
    ended: StateRecord | None


@dataclass(frozen=True)
class History:
    """A run from its start.

    Attributes:
        start: Its first record.
        records: All others but the end, in their order: steps and queued set-points.
        waiting: Set-points of operators that were not evaluated yet, in their order.
        end: Its last record; None if the run has not ended or was killed.
        before: Where the machine was when the run began; None if unknown.
        moves: Moves that are not part of an evaluation, also those after the end, in their order.
    """

    start: StartRecord
    records: tuple[Step | QueuedRecord, ...]
    waiting: tuple[Values, ...]
    end: EndRecord | None
    before: StateRecord | None = None
    moves: tuple[Move, ...] = ()

    @classmethod
    def from_records(cls, records: Sequence[JsonRecord]) -> History:
        """Return the history of a journal's records; unknown types are skipped.

        Raises:
            JournalError: If a record is not valid or does not follow from those before it.
        """
        builder = _Builder()
        for number, content in enumerate(records, start=1):
            try:
                record = from_json(content)
                if record is not None:
                    builder.add(record)
            except (AttributeError, KeyError, OverflowError, TypeError, ValueError) as error:
                where = f"record {number}, {content.get('type')!r:.20}, of the journal"
                raise JournalError(f"{where} is not valid: {error}") from None
        return builder.history()

    @property
    def run_id(self) -> str:
        """Name of the run."""
        return self.start.run_id

    @property
    def problem(self) -> Problem:
        """Problem at the start."""
        return self.start.problem

    @property
    def settings(self) -> Mapping[str, Any]:
        """Settings of the tuner at the start; empty if unknown."""
        return self.start.settings

    def require_settings(self) -> None:
        """Check that the settings are known, without which no suggestion can be computed again.

        Raises:
            JournalError: If they are unknown.
        """
        if not self.settings:
            raise JournalError(
                f"the settings of run '{self.run_id}' are unknown, because it was rebuilt from a bag without "
                "run_records; it can be neither replayed nor resumed"
            )

    @property
    def model_input(self) -> str:
        """What the models learn from: SETPOINT or READBACK; SETPOINT if unknown."""
        return str(self.settings.get("model_input", SETPOINT))

    @property
    def steps(self) -> tuple[Step, ...]:
        """Evaluations, changes and withdrawals in their order."""
        return tuple(r for r in self.records if not isinstance(r, QueuedRecord))

    @property
    def evaluations(self) -> list[EvaluationRecord]:
        """Evaluations in their order."""
        return [record for record in self.records if isinstance(record, EvaluationRecord)]

    @property
    def changes(self) -> list[ChangeRecord]:
        """Changes in their order."""
        return [record for record in self.records if isinstance(record, ChangeRecord)]

    @property
    def withdrawals(self) -> list[ForgetRecord]:
        """Withdrawals and their ends in their order."""
        return [record for record in self.records if isinstance(record, ForgetRecord)]

    @property
    def places(self) -> tuple[MoveRecord | StateRecord, ...]:
        """Where the machine was and was sent outside evaluations, in the order of the journal."""
        moves = [record for move in self.moves for record in move if record is not None]
        return (*moves,) if self.before is None else (self.before, *moves)

    @property
    def last_problem(self) -> Problem:
        """Problem at the end."""
        changes = self.changes
        return changes[-1].problem if changes else self.problem

    @property
    def budget(self) -> int:
        """Number of evaluations that were allowed at the end; 0 if unknown."""
        changes = self.changes
        return changes[-1].budget if changes else int(self.settings.get("budget", 0))


class Told(NamedTuple):
    """Arguments of `Optimizer.tell` for an evaluation."""

    setpoint: Values
    outputs: Mapping[str, Measured | None]
    readbacks: Values
    failed: bool | None
    time: float | None


def told(
    problem: Problem,
    setpoint: Values,
    diagnostics: Measurements,
    readbacks: Values,
    error_code: int,
    model_input: str,
    stamp: float,
) -> Told:
    """Return the arguments for an evaluation; readbacks only if the models learn from them."""
    time = stamp if math.isfinite(stamp) else None
    outputs = dict(diagnostics)
    known: Values = {}
    if model_input != SETPOINT:
        known = {name: readbacks[name] for name in problem.variable_names if name in readbacks}
    derived = problem.derive(place(setpoint, known), diagnostics)
    values = {name: mean for name, (mean, _) in diagnostics.items()}
    values |= {name: result.value for name, result in derived.items()}
    return Told(setpoint, outputs, known, _failed(problem, values, error_code), time)


def place(setpoint: Values, readbacks: Values) -> dict[str, float]:
    """Return where the machine was: readbacks where known, else the set-point."""
    known = {name: value for name, value in readbacks.items() if math.isfinite(value)}
    return {**setpoint, **known}


def _failed(problem: Problem, values: Values, error_code: int) -> bool | None:
    """Return whether the machine reported a failure; None lets the outputs decide.

    If one diagnostic could not be measured, the models still learn the others.
    """
    names = {*problem.required_diagnostics, *problem.measured_diagnostics} - problem.known_before
    measured = {math.isfinite(values.get(name, math.nan)) for name in names}
    partly = measured == {True, False}
    return None if not error_code or (error_code == INVALID_MEASUREMENT and partly) else True


def told_of(record: EvaluationRecord, problem: Problem, model_input: str) -> Told:
    """Return the arguments for a recorded evaluation and a problem."""
    return told(
        problem,
        record.setpoint,
        record.diagnostics,
        record.readbacks,
        record.error_code,
        model_input,
        record.stamp,
    )


class _Builder:
    """Puts records together and checks that each follows from those before."""

    def __init__(self) -> None:
        self._start: StartRecord | None = None
        self._records: list[Step | QueuedRecord] = []
        self._waiting: list[Values] = []
        self._end: EndRecord | None = None
        self._before: StateRecord | None = None
        self._moves: list[Move] = []
        self._count = 0

    def history(self) -> History:
        """Return the history of what was added."""
        if self._start is None:
            raise JournalError("the journal has no start record")
        return History(
            self._start,
            tuple(self._records),
            tuple(self._waiting),
            self._end,
            self._before,
            tuple(self._moves),
        )

    def add(self, record: Record) -> None:
        """Add one record.

        Raises:
            ValueError: If it does not follow from those before.
        """
        if isinstance(record, StartRecord):
            if self._start is not None:
                raise ValueError("a second start")
            _check_settings(record.settings)
            self._start = record
            self._problem = record.problem
            return
        if self._start is None:
            raise ValueError("it precedes the start")
        if isinstance(record, EndRecord):
            self._end = record
            return
        if isinstance(record, MoveRecord):  # nothing was measured
            self._moves.append(Move(record, None))
            return
        if isinstance(record, StateRecord):
            self._add_state(record)
            return
        if isinstance(record, EvaluationRecord):
            self._check_index(record.index)
            self._problem.normalize(record.setpoint)
            self._take_from_queue(record)
            self._count += 1
        elif isinstance(record, ChangeRecord):
            self._check_index(record.index)
            if set(record.problem.setpoint_names) != set(self._problem.setpoint_names):
                raise ValueError("its variables are not those of the start")
            self._problem = record.problem
        elif isinstance(record, ForgetRecord):
            self._check_index(record.index)
            if record.evaluation >= self._count:
                raise ValueError(f"it withdraws evaluation {record.evaluation} of {self._count}")
        else:
            self._problem.normalize(record.setpoint)
            self._waiting.append(record.setpoint)
        self._records.append(record)

    def _add_state(self, record: StateRecord) -> None:
        """Take note of where the machine was: at the end of the last move, or when the run began."""
        if self._moves and self._moves[-1].ended is None:
            self._moves[-1] = self._moves[-1]._replace(ended=record)
        elif not self._moves and self._before is None and record.readbacks:
            self._before = record

    def _check_index(self, index: int) -> None:
        if index != self._count:
            raise ValueError(f"its index is {index} instead of {self._count}")

    def _take_from_queue(self, record: EvaluationRecord) -> None:
        """Remove an operator's set-point, and those before it in the queue, which were dropped."""
        if record.source == "operator" and record.setpoint in self._waiting:
            del self._waiting[: self._waiting.index(record.setpoint) + 1]


def _check_settings(settings: Mapping[str, Any]) -> None:
    if not settings:
        return
    model_input = settings.get("model_input")
    if model_input not in (SETPOINT, READBACK):
        raise ValueError(f"model_input is {model_input!r:.40}; {SETPOINT}, {READBACK} are allowed")
    budget = settings.get("budget", 0)
    if isinstance(budget, bool) or not isinstance(budget, int) or budget < 0:
        raise ValueError(f"budget is {budget!r:.40}; an integer of at least 0 is allowed")
