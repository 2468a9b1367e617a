"""The evaluations of an earlier run, published again when a run goes on with it."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from builtin_interfaces.msg import Time
from rclpy.duration import Duration

from mobo_msgs_py import msg
from mobo_tuner.core.pareto import is_below, is_nondominated
from mobo_tuner.core.problem import Problem
from mobo_tuner.ros.conversions import named_values
from mobo_tuner.ros.waiting import until
from mobo_tuner.runs.history import Changed, History
from mobo_tuner.runs.journal import Record
from mobo_tuner.runs.records import SOURCE_NAMES
from mobo_tuner.tuner.context import TunerParts
from mobo_tuner.tuner.messages import problem_units

CHUNK = 20  # evaluations that are published before the next wait
ACKNOWLEDGE_TIMEOUT = 2.0  # [s] for the subscribers to have a chunk
_AT_ONCE = Duration(nanoseconds=1)


def earlier_evaluations(history: History, run_id: str) -> list[msg.Evaluation]:
    """The evaluations of a run as they were published, but for the name of the run."""
    steps = iter(history.steps)
    problem = history.problem
    messages: list[msg.Evaluation] = []
    for record in history.records:
        if record["type"] == "queued":
            continue
        step = next(steps)
        if isinstance(step, Changed):
            problem = step.problem
            continue
        message = _evaluation(problem, record, run_id)
        message.non_dominated = _is_on_front(problem, [*messages, message])
        messages.append(message)
    return messages


async def repeat(evaluations: Sequence[msg.Evaluation], parts: TunerParts) -> None:
    """Publish evaluations again, no faster than they are taken."""
    for start in range(0, len(evaluations), CHUNK):
        for message in evaluations[start : start + CHUNK]:
            parts.publishers.evaluation(message)
        await until(
            parts.node,
            lambda: parts.publishers.acknowledged(_AT_ONCE),
            timeout=ACKNOWLEDGE_TIMEOUT,
        )


def _evaluation(problem: Problem, record: Record, run_id: str) -> msg.Evaluation:
    units = problem_units(problem)
    measured = {
        name: (_known(mean), _known(stddev))
        for name, (mean, stddev) in record["diagnostics"].items()
    }
    means = {name: mean for name, (mean, _) in measured.items()}
    stddevs = {name: stddev for name, (_, stddev) in measured.items()}
    objectives = {o.name: means.get(o.name, math.nan) for o in problem.objectives}
    return msg.Evaluation(
        stamp=_stamp(record["stamp"]),
        run_id=run_id,
        index=record["index"],
        source=SOURCE_NAMES.index(record["source"]),
        attempts=min(record["attempts"], 2**16 - 1),
        setpoint=named_values(record["setpoint"], units),
        readbacks=named_values(_all_known(record["readbacks"]), units),
        diagnostics=named_values(means, units, stddevs),
        objectives=named_values(objectives, units, stddevs),
        valid=record["valid"],
        feasible=record["feasible"],
        hypervolume=_known(record["hypervolume"]),
        error_code=min(record["error_code"], 2**16 - 1),
        error_msg=record["error_msg"],
        suggest_seconds=_known(record["suggest_seconds"]),
        machine_seconds=_known(record["machine_seconds"]),
        total_seconds=_known(record["total_seconds"]),
    )


def _is_on_front(problem: Problem, messages: Sequence[msg.Evaluation]) -> bool:
    """Whether the last evaluation is on the front that all of them make."""
    if not messages[-1].feasible:
        return False
    rows = [
        [
            o.sign * next(n.value for n in m.diagnostics if n.name == o.name)
            for o in problem.objectives
        ]
        for m in messages
        if m.feasible and {o.name for o in problem.objectives} <= {n.name for n in m.diagnostics}
    ]
    values = np.array(rows)
    if not len(values) or not is_below(values[-1:], problem.reference_point)[0]:
        return False
    return bool(is_nondominated(values)[-1])


def _stamp(seconds: Any) -> Time:
    whole = math.floor(_known(seconds)) if math.isfinite(_known(seconds)) else 0
    if not 0 <= whole < 2**31:
        return Time()
    nanoseconds = min(round((_known(seconds) - whole) * 1e9), 999_999_999)
    return Time(sec=whole, nanosec=nanoseconds)


def _all_known(values: Mapping[str, Any]) -> dict[str, float]:
    return {name: _known(value) for name, value in values.items()}


def _known(value: Any) -> float:
    """A journal's null is not a number."""
    return math.nan if value is None else float(value)
