"""One run: what it knows and has found, and its steps that take time, made for a worker thread."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

from builtin_interfaces.msg import Time
from rclpy.task import Future

from mobo_msgs_py import msg
from mobo_msgs_py.action import EvaluateSetpoint
from mobo_msgs_py.srv import DescribeMachine
from mobo_tuner.core import Optimizer, Problem
from mobo_tuner.runs.hints import Hints, run_hints, why_barren
from mobo_tuner.runs.history import SETPOINT, place, told, told_of
from mobo_tuner.runs.records import ChangeRecord, EvaluationRecord, ForgetRecord, Source
from mobo_tuner.runs.replay import withdraw
from mobo_tuner.runs.run_log import RunLog
from mobo_tuner.tuner.machine_client import Answer
from mobo_tuner.tuner.messages import (
    evaluation_message,
    front_message,
    machine_facts,
    problem_message,
    run_records_message,
)
from mobo_tuner.tuner.run.steering import Change, Steering
from mobo_tuner.tuner.run.stopping import Progress


class RunError(Exception):
    """A run cannot continue; `code` is one of Tune.Result's constants."""

    def __init__(self, code: int, message: str) -> None:
        super().__init__(message)
        self.code = code


class Suggestion(NamedTuple):
    """Where to measure next, where that comes from, and how long it took to find [s].

    `expected_gain` is that of the hypervolume, as a share of it; NaN if it is not asked for or unknown.
    """

    setpoint: dict[str, float]
    source: Source
    seconds: float
    expected_gain: float = math.nan


class Outcome(NamedTuple):
    """The last answer to an evaluation, and how often it was tried."""

    answer: Answer
    attempts: int


class ContextReading(NamedTuple):
    """The last reading of a context, NaN if there is none, and whether the last evaluation lacks it."""

    name: str
    value: float
    stale: bool


@dataclass(frozen=True)
class Findings:
    """What a run has found so far; never changed, so that any thread may read it.

    Attributes:
        problem: Problem that is tuned, with the reference point that was inferred, if any.
        given_problem: Problem as it was given.
        evaluations: Number of finished evaluations.
        failed: Number of those that failed and were not withdrawn.
        feasible: Number of those that are feasible.
        hypervolume: Hypervolume of the front.
        hypervolume_measured: Hypervolume of the complete readings as they are.
        front: Pareto front, as `Optimizer.pareto_front` gives it without probabilities.
        withdrawn: What was forgotten: the index of an evaluation, and a diagnostic or None for all of it.
        contexts: Last reading of each context.
    """

    problem: Problem
    given_problem: Problem
    evaluations: int
    failed: int
    feasible: int
    hypervolume: float
    hypervolume_measured: float
    front: Sequence[Mapping[str, Any]]
    withdrawn: frozenset[tuple[int, str | None]] = frozenset()
    contexts: tuple[ContextReading, ...] = ()

    @classmethod
    def of(cls, optimizer: Optimizer) -> Findings:
        """Return what an optimiser has found."""
        made = optimizer.dataset.evaluations
        return cls(
            problem=optimizer.problem,
            given_problem=optimizer.given_problem,
            evaluations=len(made),
            failed=sum(e.failed and not e.forgotten for e in made),
            feasible=sum(e.feasible for e in made),
            hypervolume=optimizer.hypervolume,
            hypervolume_measured=optimizer.hypervolume_measured,
            front=tuple(optimizer.pareto_front(probability=False)),
            withdrawn=frozenset(optimizer.dataset.withdrawn),
            contexts=_contexts(optimizer),
        )


def _contexts(optimizer: Optimizer) -> tuple[ContextReading, ...]:
    data, found = optimizer.dataset, []
    for context in optimizer.problem.context:
        index, value = data.last_reading(context.name) or (-1, math.nan)
        found.append(ContextReading(context.name, value, index < len(data.evaluations) - 1))
    return tuple(found)


@dataclass
class Run:
    """What belongs to one run.

    Attributes:
        run_id: Name of the run.
        budget: Evaluations after which it is done.
        optimizer: Optimiser; from the start of the run only the worker thread touches it. What it has
            found is read from `found`.
        interrupt: Done when the run must stop; its result is the reason.
        log: Records of the run.
        hypervolume_goal: Hypervolume at which it is done, too; 0 = none.
        model_input: What the models learn from, SETPOINT or READBACK.
        records: Evaluations so far, those of a resumed run included, each with the problem at that time.
        steering: Pending requests of operators.
        machine: Description of the machine; None before the first contact.
        state_before: Where the machine was before the run; None if it is unknown.
        by_client: Whether a client asks and tells by itself.
        holds: Run whose working point this one holds, and which learns its evaluations, too; None if there is
            none.
        changeable: Whether its problem and budget may be changed.
        present: Where the machine was at the start, if the first evaluation must be there.
        begun: Number of evaluations that have begun.
        evaluating: Whether an evaluation is in flight, also while it waits for its next attempt.
        obstructed: Whether that evaluation waits until the machine is back, allows to move, or an operator
            resumes.
        consecutive_failures: Number of failed evaluations at the end of the finished ones.
        step_started: End of the previous evaluation, by `time.perf_counter` [s].
        progress: Recent gains, and the time so far.
        found: What the run has found so far.
        hints: What keeps it from getting anywhere, each with what to do.
        inherited: Number of evaluations with which it begins, those of an earlier run.
    """

    run_id: str
    budget: int
    optimizer: Optimizer
    interrupt: Future
    log: RunLog
    hypervolume_goal: float = 0.0
    model_input: str = SETPOINT
    records: list[tuple[Problem, EvaluationRecord]] = field(default_factory=list)
    steering: Steering = field(default_factory=Steering)
    machine: DescribeMachine.Response | None = None
    state_before: dict[str, float] | None = None
    by_client: bool = False
    holds: Run | None = None
    changeable: bool = True
    present: Mapping[str, float] | None = None
    begun: int = 0
    evaluating: bool = False
    obstructed: bool = False
    consecutive_failures: int = 0
    step_started: float = field(default_factory=time.perf_counter)
    progress: Progress = field(default_factory=Progress)
    found: Findings = field(init=False)
    hints: tuple[str, ...] = ()
    inherited: int = field(init=False)
    _shown: Hints = field(default_factory=Hints)

    def __post_init__(self) -> None:
        self.found = Findings.of(self.optimizer)
        self.inherited = len(self.records)

    @property
    def problem(self) -> Problem:
        """Problem that is tuned."""
        return self.found.problem

    @property
    def index(self) -> int:
        """Index of the next evaluation, which is the number of finished ones."""
        return self.found.evaluations

    @property
    def upcoming(self) -> int:
        """Index of the first evaluation that has not begun; the one before it may be in flight."""
        return max(self.begun, self.index)

    @property
    def interrupted(self) -> bool:
        """Whether the run was asked to stop."""
        return self.interrupt.done()

    @property
    def finished(self) -> bool:
        """Whether the budget is spent or the hypervolume goal is reached."""
        goal_met = 0.0 < self.hypervolume_goal <= self.found.hypervolume
        return goal_met or self.index >= self.budget

    @property
    def barren(self) -> str:
        """Reason why its own evaluations are of no use; empty if one is, or none was made or all were withdrawn."""
        withdrawn = {index for index, name in self.found.withdrawn if name is None}
        own = [r for _, r in self.records[self.inherited :] if r.index not in withdrawn]
        return why_barren(own, self.problem.required_diagnostics)

    def stop(self, reason: str) -> None:
        """Ask the run to stop; the first reason counts."""
        if not self.interrupt.done():
            self.interrupt.set_result(reason)

    def meet(self, machine: DescribeMachine.Response) -> None:
        """Check that a machine suits the problem, and remember its description.

        Raises:
            ProblemError: If it does not suit.
        """
        machine_facts(machine).check(self.problem)
        self.machine = machine

    # ------------------------------------------------------------------ messages

    def front_message(self, stamp: Time) -> msg.ParetoFront:
        """Return the Pareto front as it is now."""
        found = self.found
        volumes = (found.hypervolume, found.hypervolume_measured)
        return front_message(found.problem, found.front, volumes, self.run_id, stamp)

    def problem_message(self, stamp: Time) -> msg.Problem:
        """Return the problem as it is now."""
        return problem_message(self.problem, self.run_id, stamp)

    def records_message(self, stamp: Time) -> msg.RunRecords:
        """Return how the run was set up and changed so far."""
        return run_records_message(self.log.outline, self.run_id, stamp)

    def evaluation_message(self, record: EvaluationRecord) -> msg.Evaluation:
        """Return an evaluation of the problem as it is now."""
        return evaluation_message(self.problem, record, self.run_id)

    # ------------------------------------------------------------------ in the worker thread

    def suggest(self, expecting: bool = False) -> Suggestion:
        """Ask the optimiser where to measure next.

        Args:
            expecting: Whether the expected gain is wanted, too.
        """
        started = time.perf_counter()
        if self.present is not None and not self.index:
            return Suggestion(dict(self.present), "operator", 0.0)
        setpoint = self.optimizer.ask()
        gain = self.optimizer.expected_gain(setpoint) if expecting else math.nan
        seconds = time.perf_counter() - started
        return Suggestion(setpoint, self.optimizer.last_source, seconds, gain)

    def learn(self, suggestion: Suggestion, outcome: Outcome) -> EvaluationRecord:
        """Tell the optimiser and the journal what a suggestion led to, a failed evaluation too.

        While the journal cannot be written, its record waits in memory; `log.trouble` says so.
        """
        answer = outcome.answer
        evaluation = self.optimizer.tell(
            *told(
                self.problem,
                suggestion.setpoint,
                answer.diagnostics,
                answer.readbacks,
                answer.error_code,
                self.model_input,
                answer.stamp,
            )
        )
        self.found = found = Findings.of(self.optimizer)
        now = time.perf_counter()
        record = EvaluationRecord(
            index=evaluation.index,
            source=suggestion.source,
            attempts=outcome.attempts,
            stamp=answer.stamp,
            setpoint=evaluation.setpoint,
            readbacks=answer.readbacks,
            diagnostics={n: (v, evaluation.stddevs[n]) for n, v in evaluation.values.items()},
            valid=evaluation.valid,
            feasible=evaluation.feasible,
            non_dominated=any(point["index"] == evaluation.index for point in found.front),
            hypervolume=found.hypervolume,
            hypervolume_measured=found.hypervolume_measured,
            error_code=answer.error_code,
            error_msg=answer.error_msg,
            suggest_seconds=suggestion.seconds,
            machine_seconds=answer.machine_seconds,
            total_seconds=now - self.step_started,
        )
        self.step_started = now
        self.log.keep(record)
        if self.holds is not None:
            self.holds.learn_from(record)
        self.progress.note(record)
        self.records.append((self.problem, record))
        self._look_for_hints()
        if answer.error_code != EvaluateSetpoint.Result.CANCELED:  # skipping is not a failure
            self.consecutive_failures = self.consecutive_failures + 1 if record.failed else 0
        return record

    def learn_from(self, record: EvaluationRecord) -> None:
        """Tell the optimiser and the journal an evaluation of another run, judged by this one's problem.

        It counts as an operator's, because the method of this run did not suggest it.
        """
        told = self.optimizer.tell(*told_of(record, self.problem, self.model_input))
        self.found = found = Findings.of(self.optimizer)
        kept = replace(
            record,
            index=told.index,
            source="operator",
            valid=told.valid,
            feasible=told.feasible,
            non_dominated=any(point["index"] == told.index for point in found.front),
            hypervolume=found.hypervolume,
            hypervolume_measured=found.hypervolume_measured,
        )
        self.log.keep(kept)
        self.records.append((self.problem, kept))

    def apply(self, change: Change, stamp: float) -> None:
        """Continue with another problem or budget, which the journal keeps.

        Raises:
            ProblemError: If the optimiser cannot; nothing is changed.
        """
        if change.problem != self.found.given_problem:
            self.optimizer = self.optimizer.with_problem(change.problem)
        self.budget = change.budget
        self.found = Findings.of(self.optimizer)
        self.progress.count_again(self.found.hypervolume)
        self._look_for_hints()
        self.log.keep(ChangeRecord(stamp, self.index, change.problem, change.budget))

    def withdraw(self, request: ForgetRecord) -> None:
        """Forget an evaluation or a diagnostic of it, or learn it again, which the journal keeps.

        Raises:
            ProblemError: If there is no such evaluation, or it has no such diagnostic.
        """
        record = replace(request, index=self.index)
        withdraw(self.optimizer, record)
        self.found = Findings.of(self.optimizer)
        self.progress.count_again(self.found.hypervolume)
        self._look_for_hints()
        self.log.keep(record)

    def _look_for_hints(self) -> None:
        machine = self.machine.variables if self.machine is not None else ()
        forgotten = {index for index, name in self.found.withdrawn if name is None}
        found = run_hints(
            self.problem,
            [record for _, record in self.records if record.index not in forgotten],
            [point["setpoint"] for point in self.found.front],
            {v.name: (v.min, v.max) for v in machine},
            self.optimizer.hints(),
        )
        self.hints = self._shown.update(found, self.index)

    def save(self) -> None:
        """Keep the optimiser's state beside the journal."""
        self.log.save(self.optimizer)


def checked(run: Run, setpoint: Mapping[str, float], answer: Answer, who: str) -> Answer:
    """Return an answer without an error, or with the error that its values are.

    Args:
        run: Run to whose problem it belongs.
        setpoint: Set-point that was evaluated.
        answer: Answer without an error.
        who: Name of what measured, for the error.
    """
    problem, unknown = run.problem, (math.nan, math.nan)
    names = problem.measured_diagnostics
    reason = ""
    if not any(math.isfinite(answer.diagnostics.get(name, unknown)[0]) for name in names):
        reason = f"the {who} measured none of {', '.join(names)}"
    else:
        readbacks = answer.readbacks if run.model_input != SETPOINT else {}
        derived = problem.derive(place(setpoint, readbacks), answer.diagnostics)
        undefined = [derived[n].reason for n in problem.required_diagnostics if n in derived]
        reason = next(filter(None, undefined), "")
    if not reason:
        return answer
    return replace(answer, error_code=EvaluateSetpoint.Result.INVALID_MEASUREMENT, error_msg=reason)
