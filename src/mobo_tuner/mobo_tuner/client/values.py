"""Values that a `TunerClient` returns, made from the tuner's messages."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any

from mobo_msgs_py import msg
from mobo_tuner.core.problem import (
    Constraint,
    Context,
    Limit,
    Objective,
    Observable,
    Problem,
    Variable,
)
from mobo_tuner.errors import UserError
from mobo_tuner.parameter_spec import NULL
from mobo_tuner.ros.conversions import values_of
from mobo_tuner.runs.records import PAUSED_DURING, EvaluationRecord, Source, from_message


class ErrorCode(StrEnum):
    """Kind of a failed request."""

    NO_TUNER = "no_tuner"  # none was found
    TUNER_LOST = "tuner_lost"  # it fell silent
    NO_ANSWER = "no_answer"  # it did not answer in time
    REFUSED = "refused"  # by the tuner, with its reason
    INVALID_VALUE = "invalid_value"  # it cannot be sent at all
    INVALID_GOAL = "invalid_goal"  # this and the rest are the codes of the actions' results
    MACHINE_UNAVAILABLE = "machine_unavailable"
    MACHINE_LOST = "machine_lost"
    MACHINE_ERROR = "machine_error"
    CANCELED = "canceled"
    INTERNAL = "internal"


class TunerError(UserError):
    """A request to the tuner failed; the message is one sentence.

    Attributes:
        code: Kind of the error.
    """

    def __init__(self, code: ErrorCode, message: str) -> None:
        super().__init__(message)
        self.code = code


@dataclass(frozen=True)
class ContextReading:
    """Last reading of a context.

    Attributes:
        name: Name of the context.
        value: Its value [`unit`]; NaN = it was never measured.
        unit: Its unit.
        stale: Whether the last evaluation did not measure it.
    """

    name: str
    value: float
    unit: str = ""
    stale: bool = False


@dataclass(frozen=True)
class Status:
    """State of the tuner.

    Attributes:
        state: "idle", "waiting", "suggesting", "evaluating", "canceling", "paused" or "moving".
        run_id: Id of the active or last run, to which the counts belong; empty before the first.
        evaluations: Number of finished evaluations.
        budget: Number of evaluations after which the run ends.
        failed: Number of invalid ones among the finished evaluations.
        feasible: Number of feasible ones among the finished evaluations.
        hypervolume: Hypervolume of the Pareto front.
        hypervolume_measured: Hypervolume of the complete readings as they are.
        phase: Phase of the machine's operation, e.g. "ramping".
        fraction: Completed fraction of the phase [0..1].
        stop_reason: Stop reason of the last run; empty during a run.
        message: Message for people, such as the reason of a pause or wait until it ends; empty = none.
        last_failure: Last failure of the run, in one sentence; empty = none.
        contexts: Last reading of each context, for which predictions hold.
        hints: What keeps the run from progress, one sentence each with what to do.
        front_size: Number of points on the Pareto front.
        recorder: What the recorder does, in one sentence; empty = none was found.
        free_space: Space left on the disk that keeps the runs [byte]; NaN = unknown.
    """

    state: str
    run_id: str = ""
    evaluations: int = 0
    budget: int = 0
    failed: int = 0
    feasible: int = 0
    hypervolume: float = 0.0
    hypervolume_measured: float = 0.0
    phase: str = ""
    fraction: float = 0.0
    stop_reason: str = ""
    message: str = ""
    last_failure: str = ""
    contexts: tuple[ContextReading, ...] = ()
    hints: tuple[str, ...] = ()
    front_size: int = 0
    recorder: str = ""
    free_space: float = math.nan

    @property
    def asks(self) -> bool:
        """Whether an operator must decide on the evaluation in flight: resume = try again, skip or stop."""
        return self.state == "paused" and self.message.startswith(PAUSED_DURING)


@dataclass(frozen=True)
class Evaluation(EvaluationRecord):
    """One evaluation as it is recorded, with further data for clients.

    Attributes:
        run_id: Id of the run.
        objectives: Means of the objectives, in their units; NaN = not measured.
        units: Units of variables and diagnostics.
    """

    run_id: str
    objectives: Mapping[str, float]
    units: Mapping[str, str]

    def stddev(self, name: str) -> float:
        """Return the standard deviation of a diagnostic, in its unit; NaN = unknown."""
        return self.diagnostics.get(name, (math.nan, math.nan))[1]


@dataclass(frozen=True)
class Point:
    """A point of a run: of its Pareto front, measured or predicted, or another one.

    Attributes:
        index: Index of its evaluation; None if it is predicted, or the state before the run.
        setpoint: Its set-point, by variable.
        objectives: Its objectives, by name, as far as they are known.
        stddevs: Their standard deviations; NaN = unknown.
        predicted: Names of the objectives that were not measured there.
    """

    index: int | None
    setpoint: Mapping[str, float]
    objectives: Mapping[str, float]
    stddevs: Mapping[str, float]
    predicted: tuple[str, ...] = ()


@dataclass(frozen=True)
class Front:
    """A Pareto front.

    Attributes:
        run_id: Id of the run that it belongs to.
        points: Its points.
        hypervolume: Its hypervolume against the reference point.
        hypervolume_measured: Hypervolume of the complete readings as they are; NaN if it is predicted.
        reference_point: Worst value of interest of each objective.
        units: Units of objectives and variables.
    """

    run_id: str
    points: tuple[Point, ...]
    hypervolume: float
    hypervolume_measured: float
    reference_point: Mapping[str, float]
    units: Mapping[str, str]


@dataclass(frozen=True)
class RunResult:
    """Result of a run.

    Attributes:
        run_id: Id of the run.
        front: Pareto front at the end.
        evaluations: Number of finished evaluations.
        stop_reason: "budget", "hypervolume_goal", "time", "stagnation", "little_expected", "stopped",
            "canceled" or "error".
        error: Error that ended the run; None if it succeeded.
    """

    run_id: str
    front: Front
    evaluations: int
    stop_reason: str
    error: TunerError | None


@dataclass(frozen=True)
class WorkingPoints:
    """The measured Pareto front and, if requested, the predicted one."""

    measured: Front
    predicted: Front | None


@dataclass(frozen=True)
class Movement:
    """Progress of a move to a working point.

    Attributes:
        phase: Phase of the machine's operation, e.g. "ramping".
        evaluations: Number of evaluations spent on holding the point.
        readbacks: Readbacks of the variables, as far as known.
    """

    phase: str
    evaluations: int
    readbacks: Mapping[str, float]


@dataclass(frozen=True)
class Arrival:
    """Result of a move to a working point.

    Attributes:
        run_id: Id of the run of the point.
        point: Chosen point.
        readbacks: Readbacks of the variables.
        units: Units of variables and diagnostics.
        evaluations: Number of evaluations spent on holding the point.
        measured: Means of what was measured at the point, by name; empty if nothing was.
        remark: What was not done as it should, such as why nothing was measured; empty if everything was.
    """

    run_id: str
    point: Point
    readbacks: Mapping[str, float]
    units: Mapping[str, str]
    evaluations: int
    measured: Mapping[str, float] = field(default_factory=dict)
    remark: str = ""


@dataclass(frozen=True)
class Suggestion:
    """Set-point to measure next.

    Attributes:
        run_id: Id of the run to which the evaluation belongs.
        index: Index of the evaluation.
        setpoint: Every variable, in its unit.
        source: Source of the set-point, "initial" or "model".
    """

    run_id: str
    index: int
    setpoint: Mapping[str, float]
    source: Source


_STATES = {
    msg.TunerStatus.IDLE: "idle",
    msg.TunerStatus.WAITING: "waiting",
    msg.TunerStatus.SUGGESTING: "suggesting",
    msg.TunerStatus.EVALUATING: "evaluating",
    msg.TunerStatus.CANCELING: "canceling",
    msg.TunerStatus.PAUSED: "paused",
    msg.TunerStatus.MOVING: "moving",
}


def status_of(message: msg.TunerStatus) -> Status:
    """Return a status from its message."""
    return Status(
        state=_STATES.get(message.state, "unknown"),
        run_id=message.run_id,
        evaluations=message.evaluations,
        budget=message.budget,
        failed=message.failed,
        feasible=message.feasible,
        hypervolume=message.hypervolume,
        hypervolume_measured=message.hypervolume_measured,
        phase=message.phase,
        fraction=message.fraction,
        stop_reason=message.stop_reason,
        message=message.message,
        last_failure=message.last_failure,
        contexts=tuple(
            ContextReading(c.name, c.value, c.unit, c.name in message.stale_contexts)
            for c in message.contexts
        ),
        hints=tuple(message.hints),
        front_size=message.front_size,
        recorder=message.recorder,
        free_space=message.free_space,
    )


def evaluation_of(message: msg.Evaluation) -> Evaluation:
    """Return an evaluation from its message.

    Raises:
        ValueError: If its source is unknown.
    """
    named = (*message.setpoint, *message.diagnostics, *message.objectives)
    return Evaluation(
        **vars(from_message(message)),
        run_id=message.run_id,
        objectives=values_of(message.objectives),
        units=units_of(named),
    )


def point_of(message: msg.ParetoPoint, *, evaluated: bool = True) -> Point:
    """Return a point from its message; one that is not that of an evaluation has no index."""
    return Point(
        index=message.index if evaluated else None,
        setpoint=values_of(message.setpoint),
        objectives=values_of(message.objectives),
        stddevs={item.name: item.stddev for item in message.objectives},
        predicted=tuple(message.predicted),
    )


def front_of(message: msg.ParetoFront, *, predicted: bool = False) -> Front:
    """Return a front from its message."""
    setpoint = message.points[0].setpoint if message.points else ()
    return Front(
        run_id=message.run_id,
        points=tuple(point_of(point, evaluated=not predicted) for point in message.points),
        hypervolume=message.hypervolume,
        hypervolume_measured=message.hypervolume_measured,
        reference_point=values_of(message.reference_point),
        units=units_of((*message.reference_point, *setpoint)),
    )


def problem_of(message: msg.Problem) -> Problem:
    """Return a problem from its message, as the tuner checked it."""
    return Problem(
        variables=tuple(
            Variable(
                v.name,
                v.min,
                v.max,
                v.unit,
                v.cost,
                step=v.step,
                choices=tuple(choice.value for choice in v.choices),
                choice_names=tuple(choice.name for choice in v.choices if choice.name),
                scale="log" if v.scale == msg.Variable.LOG else "linear",
                fixed=v.fixed_value if v.fixed else None,
                approach=v.approach,
            )
            for v in message.variables
        ),
        objectives=tuple(
            Objective(
                o.name,
                o.reference,
                "maximize" if o.direction == msg.Objective.MAXIMIZE else "minimize",
                o.unit,
                (o.truncation_min, o.truncation_max) if o.truncated else None,
                goal=_goal_of(o),
            )
            for o in message.objectives
        ),
        constraints=tuple(
            Constraint(c.name, c.min, c.max, c.unit, c.critical) for c in message.constraints
        ),
        observables=tuple(Observable(o.name, o.unit) for o in message.observables),
        limits=tuple(
            Limit(
                limit.name,
                tuple((each.name, each.value) for each in limit.coefficients),
                limit.min,
                limit.max,
            )
            for limit in message.limits
        ),
        context=tuple(Context(c.name, c.min, c.max, c.unit) for c in message.contexts),
    )


def _goal_of(objective: msg.Objective) -> float | None:
    """Return the goal of an objective, if it has one."""
    if not objective.has_goal:
        return None
    minimised = objective.direction == msg.Objective.MINIMIZE
    return float(objective.truncation_min if minimised else objective.truncation_max)


def named(values: Mapping[str, float | tuple[float, float]], what: str) -> list[msg.NamedValue]:
    """Return values by name as messages; a pair is a mean and its standard deviation.

    Raises:
        TunerError: If a value is not a number.
    """
    messages = []
    for name, value in values.items():
        mean, stddev = value if isinstance(value, tuple) and len(value) == 2 else (value, math.nan)
        messages.append(
            msg.NamedValue(
                name=str(name),
                value=number(mean, f"{what} {name}"),
                stddev=number(stddev, f"the standard deviation of {what} {name}"),
            )
        )
    return messages


def number(value: Any, what: str) -> float:
    """Return a number of any kind as a float.

    Raises:
        TunerError: If it is not a number.
    """
    try:
        if not isinstance(value, bool | str | bytes):
            return float(value)
    except (TypeError, ValueError, OverflowError):
        pass
    raise TunerError(ErrorCode.INVALID_VALUE, f"{what} is {value!r}; a number is allowed")


def count(value: Any, what: str) -> int:
    """Return an integer in the range of messages.

    Raises:
        TunerError: If it is not an integer, or out of range.
    """
    if isinstance(value, bool) or not hasattr(value, "__index__") or not 0 <= value < 2**32:
        raise TunerError(
            ErrorCode.INVALID_VALUE, f"{what} is {value!r}; an integer of at least 0 is allowed"
        )
    return int(value)


def units_of(named: Iterable[msg.NamedValue]) -> dict[str, str]:
    """Return the units of those named values that have one."""
    return {item.name: item.unit for item in named if item.unit}


def parameter_value(name: str, value: Any) -> Any:
    """Return a value for a ROS parameter: the numbers of a list have one type, and None is "null".

    Raises:
        TunerError: If no ROS parameter can have it.
    """
    if hasattr(value, "tolist"):  # of numpy
        value = value.tolist()
    if value is None:  # which unsets a parameter; ROS itself would delete it
        return NULL
    if isinstance(value, bool | str | float):
        return value
    if isinstance(value, int) and abs(value) < 2**63:
        return value
    if isinstance(value, Sequence) and value:
        kinds = {type(item) for item in value}
        if kinds == {int, float}:
            return [float(item) for item in value]
        if kinds in ({bool}, {str}, {float}) or (kinds == {int} and max(map(abs, value)) < 2**63):
            return list(value)
    raise TunerError(
        ErrorCode.INVALID_VALUE,
        f"{name} is {value!r}; a number, true or false, text, or a list of one of these is allowed",
    )
