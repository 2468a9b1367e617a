"""One run: what it knows, and its two steps that take time, made for a worker thread."""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Literal, NamedTuple

from builtin_interfaces.msg import Time
from rclpy.task import Future

from mobo_msgs_py import msg
from mobo_msgs_py.action import EvaluateSetpoint
from mobo_msgs_py.srv import DescribeMachine
from mobo_tuner.core import Optimizer, Problem
from mobo_tuner.ros.conversions import named_values
from mobo_tuner.runs.history import SETPOINT, told_outputs, told_readbacks
from mobo_tuner.runs.records import evaluation_record
from mobo_tuner.runs.run_log import RunLog
from mobo_tuner.tuner.machine_client import Answer
from mobo_tuner.tuner.messages import (
    evaluation_message,
    front_message,
    machine_facts,
    problem_message,
    problem_units,
)
from mobo_tuner.tuner.run.steering import Change, Steering

Source = Literal["initial", "model", "operator"]
SOURCES: dict[Source, int] = {
    "initial": msg.Evaluation.INITIAL,
    "model": msg.Evaluation.MODEL,
    "operator": msg.Evaluation.OPERATOR,
}


class RunError(Exception):
    """A run cannot go on; `code` is one of Tune.Result's constants."""

    def __init__(self, code: int, message: str) -> None:
        super().__init__(message)
        self.code = code


class Suggestion(NamedTuple):
    """Where to measure next, where that comes from, and how long it took to find [s]."""

    setpoint: dict[str, float]
    source: Source
    seconds: float


class Outcome(NamedTuple):
    """The last answer to an evaluation, and how often it was tried."""

    answer: Answer
    attempts: int


@dataclass
class Run:
    """What belongs to one run.

    Attributes:
        run_id: its name.
        budget: evaluations after which it is done.
        hypervolume_goal: at which it is done, too; 0 = none.
        optimizer: used in the worker thread, and read elsewhere while that is idle.
        goal_id: of the Tune goal.
        interrupt: done when the run shall stop; its result says why.
        journal: where it is kept.
        model_input: what the models learn from, SETPOINT or READBACK.
        earlier: evaluations of an earlier run, with which this one begins.
        steering: what operators asked for.
        machine: what it says of itself; None before it was met.
        state_before: where the machine was before the run; None where nobody asked.
        by_client: whether a client asks and tells by itself.
        changeable: whether its problem and budget may be changed.
        evaluating: whether the machine is at it.
        consecutive_failures: at the end of the finished evaluations.
        step_started: when the evaluation before ended, by `time.perf_counter` [s].
    """

    run_id: str
    budget: int
    hypervolume_goal: float
    optimizer: Optimizer
    goal_id: bytes
    interrupt: Future
    journal: RunLog
    model_input: str = SETPOINT
    earlier: Sequence[msg.Evaluation] = ()
    steering: Steering = field(default_factory=Steering)
    machine: DescribeMachine.Response | None = None
    state_before: dict[str, float] | None = None
    by_client: bool = False
    changeable: bool = True
    evaluating: bool = False
    consecutive_failures: int = 0
    step_started: float = field(default_factory=time.perf_counter)

    @property
    def problem(self) -> Problem:
        """What is tuned."""
        return self.optimizer.problem

    @property
    def index(self) -> int:
        """Of the next evaluation, which is the number of finished ones."""
        return len(self.optimizer.dataset)

    @property
    def failed(self) -> int:
        """Number of finished evaluations that are not valid."""
        return sum(not e.valid for e in self.optimizer.dataset.evaluations)

    @property
    def feasible(self) -> int:
        """Number of finished evaluations that are feasible."""
        return sum(e.feasible for e in self.optimizer.dataset.evaluations)

    @property
    def interrupted(self) -> bool:
        """Whether someone asked the run to stop."""
        return self.interrupt.done()

    @property
    def goal_met(self) -> bool:
        """Whether the hypervolume that was asked for is reached."""
        return 0.0 < self.hypervolume_goal <= self.optimizer.hypervolume

    @property
    def finished(self) -> bool:
        """Whether it is done."""
        return self.goal_met or self.index >= self.budget

    def stop(self, reason: str) -> None:
        """Ask the run to stop; the first reason counts."""
        if not self.interrupt.done():
            self.interrupt.set_result(reason)

    def meet(self, machine: DescribeMachine.Response) -> None:
        """Check that a machine suits the problem, and remember what it says of itself.

        Raises:
            ProblemError: it does not suit.
        """
        self.problem.check_machine(*machine_facts(machine))
        self.machine = machine

    def front(self, stamp: Time) -> msg.ParetoFront:
        """The Pareto front as it is now."""
        optimizer = self.optimizer
        return front_message(
            self.problem, optimizer.pareto_front(), optimizer.hypervolume, self.run_id, stamp
        )

    def problem_message(self, stamp: Time) -> msg.Problem:
        """What is tuned, and all that the run can be rebuilt from beside its evaluations."""
        message = problem_message(self.problem, self.run_id, stamp)
        message.records = self.journal.outline
        return message

    def suggest(self) -> Suggestion:
        """Ask the optimiser where to measure next."""
        started = time.perf_counter()
        setpoint = self.optimizer.ask()
        return Suggestion(setpoint, self.optimizer.last_source, time.perf_counter() - started)

    def learn(self, suggested: Suggestion, outcome: Outcome) -> msg.Evaluation:
        """Tell the optimiser and the journal what a suggestion led to, a failed evaluation too."""
        answer = outcome.answer
        outputs = told_outputs(self.problem, answer.diagnostics, answer.error_code)
        readbacks = told_readbacks(self.problem, answer.readbacks, self.model_input)
        evaluation = self.optimizer.tell(suggested.setpoint, outputs, readbacks)
        message = evaluation_message(self.problem, evaluation, self.run_id, answer.stamp)
        message.source = SOURCES[suggested.source]
        message.attempts = outcome.attempts
        message.readbacks = named_values(answer.readbacks, problem_units(self.problem))
        front = self.optimizer.pareto_front()
        message.non_dominated = any(point["index"] == evaluation.index for point in front)
        message.hypervolume = self.optimizer.hypervolume
        message.error_code = answer.error_code
        message.error_msg = answer.error_msg
        message.suggest_seconds = suggested.seconds
        message.machine_seconds = answer.machine_seconds
        now = time.perf_counter()
        message.total_seconds, self.step_started = now - self.step_started, now
        self.journal.append(evaluation_record(message))
        self.journal.save(self.optimizer)
        if answer.error_code != EvaluateSetpoint.Result.CANCELED:  # an operator's wish is no fault
            self.consecutive_failures = 0 if message.valid else self.consecutive_failures + 1
        return message

    def apply(self, change: Change, stamp: float) -> None:
        """Go on with another problem or budget, which the journal keeps.

        Raises:
            ProblemError: the optimiser cannot; nothing is changed.
            OSError: the journal cannot be written.
        """
        if change.problem != self.optimizer.given_problem:
            self.optimizer = self.optimizer.with_problem(change.problem)
        self.budget = change.budget
        self.journal.append(
            {
                "type": "change",
                "stamp": stamp,
                "index": self.index,
                "problem": change.problem.to_dict(),
                "budget": change.budget,
            }
        )
        self.journal.save(self.optimizer)


def missing_diagnostics(problem: Problem, answer: Answer) -> list[str]:
    """The needed diagnostics that an answer lacks."""
    return [
        name
        for name in problem.required_diagnostics
        if not math.isfinite(answer.diagnostics.get(name, (math.nan, math.nan))[0])
    ]
