"""One run: what it knows, and its two steps that take time, made for a worker thread."""

from __future__ import annotations

import time
from dataclasses import dataclass, field
from typing import Any, NamedTuple

from rclpy.task import Future

from mobo_msgs_py import msg
from mobo_tuner.core import Optimizer
from mobo_tuner.core.optimizer import Source
from mobo_tuner.journal import Journal
from mobo_tuner.ros.conversions import (
    evaluation_message,
    measurements_of,
    named_values,
    problem_units,
    seconds,
    values_of,
)
from mobo_tuner.ros.machine_client import Answer

_SOURCES = {"initial": msg.Evaluation.INITIAL, "model": msg.Evaluation.MODEL}


class Suggestion(NamedTuple):
    """Where to measure next, where that comes from, and how long it took to find [s]."""

    setpoint: dict[str, float]
    source: Source
    seconds: float


@dataclass
class Run:
    """What belongs to one Tune goal."""

    run_id: str
    budget: int
    hypervolume_goal: float
    optimizer: Optimizer
    goal_id: bytes
    interrupt: Future  # done when the run shall stop; its result says why
    journal: Journal | None = None
    index: int = 0
    consecutive_failures: int = 0
    step_started: float = field(default_factory=time.perf_counter)

    @property
    def interrupted(self) -> bool:
        """Whether someone asked the run to stop."""
        return self.interrupt.done()

    def suggest(self) -> Suggestion:
        """Ask the optimiser where to measure next."""
        started = time.perf_counter()
        setpoint = self.optimizer.ask()
        return Suggestion(setpoint, self.optimizer.last_source, time.perf_counter() - started)

    def learn(self, suggested: Suggestion, answer: Answer) -> msg.Evaluation:
        """Tell the optimiser and the journal what a suggestion led to, a failed evaluation too."""
        evaluation = self.optimizer.tell(suggested.setpoint, answer.diagnostics)
        message = evaluation_message(self.optimizer.problem, evaluation, self.run_id, answer.stamp)
        message.source = _SOURCES[suggested.source]
        message.readbacks = named_values(answer.readbacks, problem_units(self.optimizer.problem))
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
