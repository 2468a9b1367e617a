"""One run: what it knows, and its two steps that take time, made for a worker thread."""

from __future__ import annotations

import time
from dataclasses import dataclass, field
from typing import Any, NamedTuple

from builtin_interfaces.msg import Time
from rclpy.task import Future

from mobo_msgs_py import msg
from mobo_tuner.core import Optimizer, Problem
from mobo_tuner.core.optimizer import Source
from mobo_tuner.journal import Journal
from mobo_tuner.ros.conversions import (
    evaluation_message,
    front_message,
    measurements_of,
    named_values,
    problem_units,
    seconds,
    values_of,
)
from mobo_tuner.ros.machine_client import Answer

_SOURCES = {"initial": msg.Evaluation.INITIAL, "model": msg.Evaluation.MODEL}


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


@dataclass
class Run:
    """What belongs to one Tune goal.

    Attributes:
        run_id: its name.
        budget: evaluations after which it is done.
        hypervolume_goal: at which it is done, too; 0 = none.
        optimizer: used in the worker thread, and read elsewhere while that is idle.
        goal_id: of the Tune goal.
        interrupt: done when the run shall stop; its result says why.
        journal: where one is kept.
        index: of the next evaluation, which is the number of finished ones.
        failed, feasible: evaluations among the finished ones.
        consecutive_failures: at the end of the finished ones.
        step_started: when the evaluation before ended, by `time.perf_counter` [s].
    """

    run_id: str
    budget: int
    hypervolume_goal: float
    optimizer: Optimizer
    goal_id: bytes
    interrupt: Future
    journal: Journal | None = None
    index: int = 0
    failed: int = 0
    feasible: int = 0
    consecutive_failures: int = 0
    step_started: float = field(default_factory=time.perf_counter)

    @property
    def problem(self) -> Problem:
        """What is tuned."""
        return self.optimizer.problem

    @property
    def interrupted(self) -> bool:
        """Whether someone asked the run to stop."""
        return self.interrupt.done()

    @property
    def goal_met(self) -> bool:
        """Whether the hypervolume that was asked for is reached."""
        return 0.0 < self.hypervolume_goal <= self.optimizer.hypervolume

    def stop(self, reason: str) -> None:
        """Ask the run to stop; the first reason counts."""
        if not self.interrupt.done():
            self.interrupt.set_result(reason)

    def front(self, stamp: Time) -> msg.ParetoFront:
        """The Pareto front as it is now."""
        optimizer = self.optimizer
        return front_message(
            self.problem, optimizer.pareto_front(), optimizer.hypervolume, self.run_id, stamp
        )

    def suggest(self) -> Suggestion:
        """Ask the optimiser where to measure next."""
        started = time.perf_counter()
        setpoint = self.optimizer.ask()
        return Suggestion(setpoint, self.optimizer.last_source, time.perf_counter() - started)

    def learn(self, suggested: Suggestion, answer: Answer) -> msg.Evaluation:
        """Tell the optimiser and the journal what a suggestion led to, a failed evaluation too."""
        evaluation = self.optimizer.tell(suggested.setpoint, answer.diagnostics)
        message = evaluation_message(self.problem, evaluation, self.run_id, answer.stamp)
        message.source = _SOURCES[suggested.source]
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
        if self.journal is not None:
            self.journal.append(_journal_record(message, suggested.source))
        self.index += 1
        self.failed += not message.valid
        self.feasible += message.feasible
        self.consecutive_failures = 0 if message.valid else self.consecutive_failures + 1
        return message


def _journal_record(message: msg.Evaluation, source: str) -> dict[str, Any]:
    return {
        "type": "evaluation",
        "index": message.index,
        "source": source,
        "stamp": seconds(message.stamp),
        "setpoint": values_of(message.setpoint),
        "readbacks": values_of(message.readbacks),
        "diagnostics": {
            name: list(pair) for name, pair in measurements_of(message.diagnostics).items()
        },
        "valid": message.valid,
        "feasible": message.feasible,
        "error_code": message.error_code,
        "error_msg": message.error_msg,
        "hypervolume": message.hypervolume,
        "suggest_seconds": message.suggest_seconds,
        "machine_seconds": message.machine_seconds,
        "total_seconds": message.total_seconds,
    }
