"""The records of a run: start, evaluations, changes, queued set-points, moves and end.

A journal holds them as JSON objects, a bag holds the evaluations as messages; all conversions, in both
directions, are in this module. A new field of an evaluation is a field of `EvaluationRecord` with one of
the types in `_KINDS`, a field of the same name in `Evaluation.msg`, and the place where its value is made.

Stamps are seconds since the epoch. The JSON is strict: a number that is not finite is written as null,
which is read as NaN, "not measured" or "unknown".
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import MISSING, dataclass, fields
from enum import StrEnum
from typing import Any, Literal, NamedTuple, get_args

from mobo_tuner.core.problem import Problem
from mobo_tuner.runs.journal import JsonRecord

VERSION = 1  # of the journal, in its start record

Source = Literal["initial", "model", "operator"]
SOURCES: tuple[Source, ...] = get_args(Source)
"""Sources by the constants of `mobo_msgs_py/msg/Evaluation`: INITIAL, MODEL, OPERATOR."""

DIRECTIONS = ("minimize", "maximize")
"""Directions by the constants of `mobo_msgs_py/msg/Objective`: MINIMIZE, MAXIMIZE."""

SCALES = ("linear", "log")
"""Scales by the constants of `mobo_msgs_py/msg/Variable`: LINEAR, LOG."""

Stamp = float  # [s since the epoch]
Short = int  # at most 65535 in a message
Values = Mapping[str, float]
Measurements = Mapping[str, tuple[float, float]]

_MAX_NAME = 1000  # characters
_MAX_UINT16 = 2**16 - 1


@dataclass(frozen=True)
class StartRecord:
    """The first record of a run.

    Attributes:
        run_id: Name of the run.
        stamp: When it started [s].
        problem: Problem at the start.
        settings: Parameters of the tuner, the budget and the hypervolume goal; empty if unknown, in a run that was
            rebuilt from a bag without `run_records`.
        resumed_from: `run_id` and number of `evaluations` of the run that this one resumes.
    """

    run_id: str
    stamp: Stamp
    problem: Problem
    settings: Mapping[str, Any]
    resumed_from: Mapping[str, Any] | None = None


@dataclass(frozen=True)
class EvaluationRecord:
    """One evaluation: where the machine was, what it measured, and how that came about.

    Attributes:
        index: Position in the run, from 0.
        source: Source of the set-point.
        attempts: Number of attempts, including the last one.
        stamp: When the measurement ended, on the machine's clock [s].
        setpoint: Every variable, in its unit.
        readbacks: Variables by their own instruments, in their units; NaN = unknown.
        diagnostics: Mean and standard deviation of everything measured, in their units; NaN = unknown.
        valid: Whether the evaluation did not fail.
        feasible: Whether every objective and constrained diagnostic was measured and every constraint is met.
        non_dominated: Whether it was on the Pareto front after it was told.
        hypervolume: Hypervolume of the front after this evaluation, as `Optimizer.hypervolume`.
        hypervolume_measured: Hypervolume of the complete readings as they are.
        error_code: One of `EvaluateSetpoint.Result`'s constants; 0 = none.
        error_msg: One sentence; empty without an error.
        suggest_seconds: Wall time of the suggestion [s].
        machine_seconds: Wall time that the machine spent on it [s].
        total_seconds: Wall time of the whole step [s].
    """

    index: int
    source: Source
    attempts: Short
    stamp: Stamp
    setpoint: Values
    readbacks: Values
    diagnostics: Measurements
    valid: bool
    feasible: bool
    non_dominated: bool
    hypervolume: float
    hypervolume_measured: float
    error_code: Short
    error_msg: str
    suggest_seconds: float
    machine_seconds: float
    total_seconds: float

    @property
    def failed(self) -> bool:
        """Whether it failed, or the machine reported an error with what it measured."""
        return bool(self.error_code) or not self.valid


@dataclass(frozen=True)
class ChangeRecord:
    """Another problem or budget (0 = unknown), in force from the evaluation `index` on."""

    stamp: Stamp
    index: int
    problem: Problem
    budget: int


@dataclass(frozen=True)
class ForgetRecord:
    """A withdrawal that is in force from the evaluation `index` on, or the end of one.

    Attributes:
        stamp: When an operator asked for it [s].
        index: Number of finished evaluations.
        evaluation: Index of the evaluation that counts as never measured.
        diagnostic: Its only diagnostic that counts as never measured; empty = all of it.
        withdrawn: Whether it is withdrawn; false where a withdrawal ends.
    """

    stamp: Stamp
    index: int
    evaluation: int
    diagnostic: str = ""
    withdrawn: bool = True


@dataclass(frozen=True)
class QueuedRecord:
    """A set-point that an operator gave; it waits until an evaluation with source "operator" has it."""

    stamp: Stamp
    setpoint: Values


@dataclass(frozen=True)
class MoveRecord:
    """A move that is not part of an evaluation; written before the machine moves.

    Attributes:
        stamp: When it was asked for [s].
        index: Number of finished evaluations.
        setpoint: Where the machine is sent.
        purpose: "go" or "hold" for a working point, "restore" for the state before the run, "best" for the best point.
        by: "operator", or the policy that asks for it, "on_end" or "on_abort".
        evaluation: Index of the evaluation whose set-point it is; None if it is that of none.
        anyway: Whether it leads across the bounds, on an operator's word.
        via: Set-point that it passes on the way; None if it leads straight there.
    """

    stamp: Stamp
    index: int
    setpoint: Values
    purpose: str = "go"
    by: str = "operator"
    evaluation: int | None = None
    anyway: bool = False
    via: Values | None = None


@dataclass(frozen=True)
class StateRecord:
    """Where the machine was when the run began, or at the end of the move before this record.

    Attributes:
        stamp: When it was there [s].
        index: Number of finished evaluations.
        readbacks: Readbacks of the variables; empty if unknown.
        error_msg: Why the move ended before its goal; empty if it did not.
    """

    stamp: Stamp
    index: int
    readbacks: Values
    error_msg: str = ""


PAUSED_DURING = "paused during"
"""Begin of the tuner's message while an operator decides on the evaluation in flight."""


class StopReason(StrEnum):
    """Why a run ended: the constants STOP_REASON_* of the messages."""

    BUDGET = "budget"
    HYPERVOLUME_GOAL = "hypervolume_goal"
    TIME = "time"
    STAGNATION = "stagnation"
    LITTLE_EXPECTED = "little_expected"
    STOPPED = "stopped"
    CANCELED = "canceled"
    ERROR = "error"


@dataclass(frozen=True)
class EndRecord:
    """The last record of a run that was not killed.

    Attributes:
        stop_reason: A `StopReason`, or another text from a later version.
    """

    stamp: Stamp
    stop_reason: str
    error_code: Short = 0
    error_msg: str = ""


Record = (
    StartRecord
    | EvaluationRecord
    | ChangeRecord
    | ForgetRecord
    | QueuedRecord
    | MoveRecord
    | StateRecord
    | EndRecord
)

MOVE, STATE = "move", "state"
"""Types of the records that may come after the end."""

_TYPES: dict[str, type[Record]] = {
    "start": StartRecord,
    "evaluation": EvaluationRecord,
    "change": ChangeRecord,
    "forget": ForgetRecord,
    "queued": QueuedRecord,
    MOVE: MoveRecord,
    STATE: StateRecord,
    "end": EndRecord,
}
_TYPE_NAMES = {kind: name for name, kind in _TYPES.items()}


def to_json(record: Record) -> JsonRecord:
    """Return a record as a JSON object, numbers that are not finite included."""
    content: JsonRecord = {"type": _TYPE_NAMES[type(record)]}
    if isinstance(record, StartRecord):
        content["version"] = VERSION
    for field in fields(record):
        value = getattr(record, field.name)
        if value is not None:
            content[field.name] = value.to_dict() if isinstance(value, Problem) else value
    return content


def from_json(content: Mapping[str, Any]) -> Record | None:
    """Return the record of a JSON object; None for a type of record that is not known.

    Raises:
        ValueError: If a field is missing or has a value that is not allowed.
    """
    kind = _TYPES.get(content["type"])
    if kind is None:
        return None
    if kind is StartRecord and content.get("version") != VERSION:
        raise ValueError(f"version is {content.get('version')!r:.20}; {VERSION} is allowed")
    values = {}
    for field in fields(kind):
        if field.name not in content:
            if field.default is MISSING:
                raise ValueError(f"it lacks '{field.name}'")
            continue
        try:
            values[field.name] = _KINDS[str(field.type)].read(content[field.name])
        except (OverflowError, ValueError) as error:
            raise ValueError(f"{field.name} is not valid: {error}") from None
    return kind(**values)


class MessageClasses(NamedTuple):
    """Classes of which an evaluation's message is made, of rclpy or of a reader of bags."""

    evaluation: type
    named_value: type
    header: type
    time: type


def to_message(
    record: EvaluationRecord, problem: Problem, run_id: str, classes: MessageClasses
) -> Any:
    """Return an evaluation as its message.

    Args:
        record: Evaluation.
        problem: Problem at that time, for the units and the objectives.
        run_id: Name of the run.
        classes: Classes of the message and its parts.
    """
    units = problem.units

    def named(values: Mapping[str, Any]) -> list[Any]:
        pairs = {n: v if isinstance(v, tuple) else (v, math.nan) for n, v in values.items()}
        return [
            classes.named_value(name=name, value=mean, stddev=stddev, unit=units.get(name, ""))
            for name, (mean, stddev) in pairs.items()
        ]

    content = {}
    for field in fields(record):
        value = _KINDS[str(field.type)].write(getattr(record, field.name))
        content[field.name] = named(value) if isinstance(value, Mapping) else value
    unknown = (math.nan, math.nan)
    objectives, contexts = (
        named({name: record.diagnostics.get(name, unknown) for name in names})
        for names in (problem.objective_names, [context.name for context in problem.context])
    )
    sec, nanosec = content.pop("stamp")
    header = classes.header(stamp=classes.time(sec=sec, nanosec=nanosec))
    return classes.evaluation(
        header=header, run_id=run_id, objectives=objectives, contexts=contexts, **content
    )


def from_message(message: Any) -> EvaluationRecord:
    """Return the record of an `Evaluation` message, of rclpy or of a reader of bags.

    Raises:
        ValueError, AttributeError: If the message is not a valid evaluation.
    """
    content: dict[str, Any] = {"stamp": seconds(message.header.stamp)}
    for field in fields(EvaluationRecord):
        if field.name != "stamp":
            content[field.name] = _KINDS[str(field.type)].take(getattr(message, field.name))
    return EvaluationRecord(**content)


def problem_from_message(message: Any) -> Problem:
    """Return the problem of a `Problem` message, of rclpy or of a reader of bags.

    Raises:
        ValueError, AttributeError: If the message is not a valid problem.
    """
    sections: dict[str, dict[str, dict[str, Any]]] = {
        "variables": _entries(message.variables, _variable),
        "objectives": _entries(message.objectives, _objective),
        "constraints": _entries(
            message.constraints,
            lambda c: {**_finite(min=c.min, max=c.max), "unit": c.unit, "critical": c.critical},
        ),
        "observables": _entries(message.observables, lambda o: {"unit": o.unit}),
        # Older bags have none of these.
        "limits": _entries(getattr(message, "limits", ()), _limit),
        "context": _entries(
            getattr(message, "contexts", ()),
            lambda c: {**_finite(min=c.min, max=c.max), "unit": c.unit},
        ),
    }
    return Problem.from_dict(sections)


def _entries(items: Iterable[Any], entry: Callable[[Any], dict[str, Any]]) -> dict[str, Any]:
    """Return a section of a problem from a message's items."""
    section: dict[str, Any] = {}
    for item in items:
        if item.name in section:
            raise ValueError(f"the name {item.name!r:.40} is used twice")
        section[item.name] = entry(item)
    return section


def _variable(item: Any) -> dict[str, Any]:
    entry: dict[str, Any] = {"unit": item.unit, "cost": item.cost}
    choices = list(getattr(item, "choices", ()))  # older bags have no grids
    names = [choice.name for choice in choices if choice.name]
    if getattr(item, "fixed", False):  # nor any of these
        entry["fixed"] = float(item.fixed_value)
    if getattr(item, "approach", 0.0):
        entry["approach"] = float(item.approach)
    if getattr(item, "scale", 0):
        if not item.scale < len(SCALES):
            raise ValueError(f"scale is {item.scale}; 0 to {len(SCALES) - 1} is allowed")
        entry["scale"] = SCALES[item.scale]
    if names:
        return entry | {"choices": names, "values": [float(c.value) for c in choices]}
    entry |= {"min": item.min, "max": item.max}
    if getattr(item, "step", 0.0):
        entry["step"] = item.step
    elif choices:
        entry["choices"] = [float(c.value) for c in choices]
    return entry


def _limit(item: Any) -> dict[str, float]:
    coefficients = {each.name: float(each.value) for each in item.coefficients}
    return coefficients | _finite(min=item.min, max=item.max)


def _objective(item: Any) -> dict[str, Any]:
    if not 0 <= item.direction < len(DIRECTIONS):
        raise ValueError(f"direction is {item.direction}; 0 to {len(DIRECTIONS) - 1} is allowed")
    entry = {"direction": DIRECTIONS[item.direction], "unit": item.unit}
    if getattr(item, "has_goal", False):  # older bags have no goals
        minimised = entry["direction"] == "minimize"
        entry["goal"] = float(item.truncation_min if minimised else item.truncation_max)
    elif item.truncated:
        entry["truncation"] = [float(item.truncation_min), float(item.truncation_max)]
    return entry | _finite(reference=item.reference)


def _finite(**values: float) -> dict[str, float]:
    """Return those values that are finite; the others stand for what is not given."""
    return {name: float(value) for name, value in values.items() if math.isfinite(value)}


class _Kind(NamedTuple):
    """How values of one type are read from JSON, written to a message, and taken from one."""

    read: Callable[[Any], Any]
    write: Callable[[Any], Any] = lambda value: value
    take: Callable[[Any], Any] = lambda value: value


def seconds(stamp: Any) -> float:
    """Return a stamp of a message as seconds since the epoch."""
    return float(stamp.sec + 1e-9 * stamp.nanosec)


def _stamp(value: float) -> tuple[int, int]:
    """Return seconds and nanoseconds; 0 for a time that a message cannot hold."""
    if not (math.isfinite(value) and 0.0 <= value < 2.0**31):
        return 0, 0
    whole = math.floor(value)
    return whole, min(round((value - whole) * 1e9), 999_999_999)


def _integer(value: Any) -> int:
    if isinstance(value, bool) or not isinstance(value, int) or not 0 <= value < 2**32:
        raise ValueError(f"{value!r:.40}; an integer of at least 0 is allowed")
    return value


def _boolean(value: Any) -> bool:
    if not isinstance(value, bool):
        raise ValueError(f"{value!r:.40}; true or false is allowed")
    return value


def _text(value: Any) -> str:
    if not isinstance(value, str):
        raise ValueError(f"{value!r:.40}; a string is allowed")
    return value


def _number(value: Any) -> float:
    """Return a number; null is NaN."""
    if value is None:
        return math.nan
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise ValueError(f"{value!r:.40}; a number or null is allowed")
    return float(value)


def _source(value: Any) -> Source:
    if value not in SOURCES:
        raise ValueError(f"{value!r:.40}; allowed are {', '.join(SOURCES)}")
    source: Source = value
    return source


def _source_of(constant: Any) -> Source:
    if not 0 <= constant < len(SOURCES):
        raise ValueError(f"{constant!r:.40}; 0 to {len(SOURCES) - 1} is allowed")
    source: Source = SOURCES[constant]
    return source


def _mapping(value: Any) -> Mapping[str, Any]:
    if not isinstance(value, dict):
        raise ValueError(f"{value!r:.40}; names with values are allowed")
    for name in value:
        if len(name) > _MAX_NAME:
            raise ValueError(f"the name {name[:40]!r}... has more than {_MAX_NAME} characters")
    return value


def _values(value: Any) -> dict[str, float]:
    return {name: _number(number) for name, number in _mapping(value).items()}


def _pair(value: Any) -> tuple[float, float]:
    if not isinstance(value, list | tuple) or len(value) != 2:
        raise ValueError(f"{value!r:.40}; a pair (mean, standard deviation) is allowed")
    return _number(value[0]), _number(value[1])


def _measurements(value: Any) -> dict[str, tuple[float, float]]:
    return {name: _pair(pair) for name, pair in _mapping(value).items()}


def _values_of(named: Iterable[Any]) -> dict[str, float]:
    return {item.name: float(item.value) for item in named}


def _measurements_of(named: Iterable[Any]) -> dict[str, tuple[float, float]]:
    return {item.name: (float(item.value), float(item.stddev)) for item in named}


_KINDS = {
    "int": _Kind(_integer, take=int),
    "int | None": _Kind(_integer),
    "Short": _Kind(_integer, lambda value: min(value, _MAX_UINT16), int),
    "Stamp": _Kind(_number, _stamp),
    "bool": _Kind(_boolean, take=bool),
    "str": _Kind(_text, take=str),
    "float": _Kind(_number, take=float),
    "Source": _Kind(_source, SOURCES.index, _source_of),
    "Values": _Kind(_values, take=_values_of),
    "Values | None": _Kind(_values, take=_values_of),
    "Measurements": _Kind(_measurements, take=_measurements_of),
    "Problem": _Kind(Problem.from_dict),
    "Mapping[str, Any]": _Kind(_mapping),
    "Mapping[str, Any] | None": _Kind(_mapping),
}
