"""The mapping file of the bridge: topics, services and actions of variables and diagnostics."""

from __future__ import annotations

import dataclasses
import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mobo_tuner.bridge.field_path import FieldPath, parse_field_path
from mobo_tuner.bridge.section import MappingError, Section
from mobo_tuner.files import load_yaml
from mobo_tuner.machine.averaging import MAX_SHOTS, OutlierRule, percentile
from mobo_tuner.machine.ramp import RampedVariable
from mobo_tuner.names import ALLOWED, is_name

KINDS = {"topic": "msg", "service": "srv", "action": "action"}
QOS = ("reliable", "best_effort", "latched")
_ROS_NAME = re.compile(r"(~?/)?[A-Za-z_][A-Za-z0-9_]*(/[A-Za-z_][A-Za-z0-9_]*)*")
_TYPE = re.compile(r"[a-z][a-z0-9_]*/(msg|srv|action)/[A-Z][A-Za-z0-9]*")


@dataclass(frozen=True)
class Target:
    """A topic, service or action.

    Attributes:
        kind: Kind, ``topic``, ``service`` or ``action``.
        name: Name in the ROS graph.
        type_name: Name of its type, e.g. ``std_msgs/msg/Float64``.
    """

    kind: str
    name: str
    type_name: str

    def __str__(self) -> str:
        return f"{self.kind} '{self.name}'"


@dataclass(frozen=True)
class Endpoint:
    """One value at a target.

    Attributes:
        where: Place in the file, for messages.
        target: Topic, service or action that carries the value.
        field: Field of the message, response or result (of the message, request or goal for a
            set-point); None if there is no value.
        message: Other fields to send, as in the file.
        success: Field of the response or result that must be true; None = none.
        stamp: Field with the time of the value; None = the time when the message arrived.
        scale: Factor in ``value = scale * raw + offset``.
        offset: Offset in this formula [unit of the value].
        stale_after: Age after which a value is ignored [s].
        timeout: Longest time to a response [s].
        period: Time between two calls of a service that is read continuously [s].
        qos: Quality of service, a key of QOS.
        words: Words that the machine takes or gives for the values 0, 1, 2, ...; empty = it has numbers.
    """

    where: str
    target: Target
    field: FieldPath | None
    message: Mapping[str, Any] = dataclasses.field(default_factory=dict)
    success: FieldPath | None = None
    stamp: FieldPath | None = None
    scale: float = 1.0
    offset: float = 0.0
    stale_after: float = math.inf
    timeout: float = math.inf
    period: float = 0.5
    qos: str = "reliable"
    words: tuple[str, ...] = ()

    def value(self, raw: object) -> float:
        """Return the value of a raw number, boolean or numeric string; NaN if it is none of these."""
        if self.words:
            return float(self.words.index(raw)) if raw in self.words else math.nan
        try:
            number = float(raw)  # type: ignore[arg-type]
        except (TypeError, ValueError, OverflowError):
            return math.nan
        return self.scale * number + self.offset

    def raw(self, value: float) -> float | str:
        """Return the raw number of a value, or its word."""
        if self.words:
            return self.words[round(value)]
        return (value - self.offset) / self.scale


@dataclass(frozen=True)
class Condition:
    """A condition on a value: equality, or limits.

    Attributes:
        endpoint: Endpoint of the value.
        equals: Required value; None if the limits apply.
        minimum: Least value allowed.
        maximum: Greatest value allowed.
    """

    endpoint: Endpoint
    equals: bool | float | str | None
    minimum: float
    maximum: float

    def holds(self, raw: object) -> bool:
        """Return whether a raw value meets the condition."""
        if self.equals is not None:
            return bool(raw == self.equals)
        return self.minimum <= self.endpoint.value(raw) <= self.maximum


@dataclass(frozen=True, kw_only=True)
class Variable(RampedVariable):
    """Variable with the endpoints that set and read it.

    Attributes:
        setpoint: Endpoint that takes set-points.
        readback: Endpoint of the readback.
        settled: Additional condition of a settled variable; None = none.
    """

    setpoint: Endpoint
    readback: Endpoint
    settled: Condition | None


@dataclass(frozen=True)
class Diagnostic:
    """The measurement of one diagnostic.

    Attributes:
        name: Name of the diagnostic.
        unit: Unit of its value.
        read: Endpoint of its shots: the messages of a topic, or one call each.
        count: Number of shots to average; 0 if `seconds` applies.
        seconds: Duration of the average [s]; 0 if `count` applies.
        outliers: Rule for shots that are omitted from the average.
        statistic: What is taken of the shots: ``mean``, ``rms``, or a percentile such as ``p90``.
    """

    name: str
    unit: str
    read: Endpoint
    count: int
    seconds: float
    outliers: OutlierRule
    statistic: str = "mean"


@dataclass(frozen=True)
class MachineMapping:
    """A machine, as described by a mapping file.

    Attributes:
        file: Name of the mapping file, for messages.
        name: Name of the machine, for people.
        variables: Variables by name.
        diagnostics: Diagnostics by name.
        interlocks: Conditions that must hold for a move, by name.
        fire: Endpoint that fires each shot; None = shots are published without a trigger.
        shots: Number of shots of an evaluation whose goal gives none.
        rate: Rate of the steps of a move [Hz].
        settle_time: Uninterrupted time in which all variables must be settled before a measurement [s].
        settle_timeout: Longest time from the last step of a move to the end of `settle_time` [s].
        follow_moved: Whether a move may start at the readback of a variable that is not at its
            set-point; otherwise it is refused.
    """

    file: str
    name: str
    variables: Mapping[str, Variable]
    diagnostics: Mapping[str, Diagnostic]
    interlocks: Mapping[str, Condition]
    fire: Endpoint | None
    shots: int
    rate: float
    settle_time: float
    settle_timeout: float
    follow_moved: bool


def load_mapping(path: str | Path) -> MachineMapping:
    """Read a mapping file.

    Raises:
        ValueError: If it cannot be read, or a key is unknown, missing or not allowed.
    """
    return parse_mapping(load_yaml(path), Path(path).name)


def parse_mapping(content: object, file: str) -> MachineMapping:
    """Return the mapping of a file's content.

    Raises:
        MappingError: If a key is unknown, missing or not allowed.
    """
    root = Section(f"{file}: ", content)
    move = root.section("move", needed=False)
    measure = root.section("measure", needed=False)
    shots = measure.whole("shots", 1, minimum=1, maximum=MAX_SHOTS)
    fire = None
    if "fire" in measure:
        fire = _endpoint(measure.section("fire"), ("topic", "service", "action"), "act")
    mapping = MachineMapping(
        file=file,
        name=root.text("name"),
        variables={n: _variable(n, s) for n, s in root.sections("variables").items()},
        diagnostics={
            n: _diagnostic(n, s, shots, fire is not None)
            for n, s in root.sections("diagnostics").items()
        },
        interlocks={n: _condition(s) for n, s in root.sections("interlocks", needed=False).items()},
        fire=fire,
        shots=shots,
        rate=move.number("rate", 10.0, above=0.0, maximum=100.0),
        settle_time=move.number("settle_time", 0.5, minimum=0.0, maximum=3600.0),
        follow_moved=move.choice("if_moved", "refuse", ("refuse", "follow")) == "follow",
        settle_timeout=move.number("timeout", 30.0, above=0.0, maximum=86_400.0),
    )
    for section in (move, measure, root):
        section.finish()
    both = [name for name in mapping.variables if name in mapping.diagnostics]
    if both:
        raise MappingError(
            f"{file}: {both[0]} is a variable and a diagnostic; names must be different"
        )
    return mapping


def _variable(name: str, section: Section) -> Variable:
    _check_name(name, section)
    setpoint = _endpoint(section.section("setpoint"), ("topic", "service", "action"), "send")
    readback = _endpoint(section.section("readback"), ("topic", "service"), "watch")
    words = _words(section) if "words" in section else ()
    if words:  # it has nothing but these words, between which there is nothing
        largest = float(len(words) - 1)
        moves = {
            "minimum": 0.0,
            "maximum": largest,
            "max_step": largest,
            "slew": math.inf,
            "tolerance": 0.1,
        }
    else:
        minimum = section.number("min")
        moves = {
            "minimum": minimum,
            "maximum": section.number("max", above=minimum),
            "max_step": section.number("max_step", above=0.0),
            "slew": section.number("slew", above=0.0),
            "tolerance": section.number("tolerance", above=0.0),
        }
    variable = Variable(
        name=name,
        unit=section.text("unit", ""),
        **moves,
        words=words,
        setpoint=dataclasses.replace(setpoint, words=words),
        readback=dataclasses.replace(readback, words=words),
        settled=_condition(section.section("settled")) if "settled" in section else None,
    )
    section.finish()
    return variable


def _words(section: Section) -> tuple[str, ...]:
    words = section.get("words")
    if (
        not isinstance(words, list)
        or not all(isinstance(word, str) for word in words)
        or len(set(words)) < max(2, len(words))
    ):
        raise section.error("words", "it must be a list of at least two different words")
    return tuple(words)


def _diagnostic(name: str, section: Section, shots: int, fired: bool) -> Diagnostic:
    _check_name(name, section)
    average = section.section("average", needed=False)
    count, seconds = shots, 0.0
    if "average" in section:
        if fired:
            raise section.error("average", "with measure.fire the shots are measure.shots")
        if average.one_of("count", "seconds") == "count":
            count = average.whole("count", minimum=1, maximum=MAX_SHOTS)
        else:
            count, seconds = 0, average.number("seconds", above=0.0, maximum=86_400.0)
    outliers = section.section("outliers", needed=False)
    rule = OutlierRule()
    if "outliers" in section:
        kind = outliers.one_of("mad", "sigma")
        rule = OutlierRule(kind, outliers.number(kind, above=0.0))
    statistic = section.text("statistic", "mean")
    try:
        percentile(statistic)
    except ValueError as error:
        raise section.error("statistic", str(error)) from None
    diagnostic = Diagnostic(
        name=name,
        unit=section.text("unit", ""),
        read=_endpoint(section.section("read"), ("topic", "service", "action"), "read"),
        count=count,
        seconds=seconds,
        outliers=rule,
        statistic=statistic,
    )
    for part in (average, outliers, section):
        part.finish()
    return diagnostic


def _condition(section: Section) -> Condition:
    equals = section.get("equals")
    minimum = section.number("min", -math.inf, finite=False)
    maximum = section.number("max", math.inf, finite=False)
    limited = "min" in section or "max" in section
    if equals is None and not limited:
        equals = True
    elif equals is not None and (limited or not isinstance(equals, bool | int | float | str)):
        raise section.error("equals", "it must be one value, and stand without min and max")
    return Condition(_endpoint(section, ("topic", "service"), "watch"), equals, minimum, maximum)


def _endpoint(section: Section, kinds: tuple[str, ...], use: str) -> Endpoint:
    """Read an endpoint.

    Args:
        section: Section of the file.
        kinds: Kinds of targets that are allowed.
        use: Use of the endpoint: ``send`` a value, ``watch`` it continuously, ``read`` it on demand,
            or ``act`` without a value.
    """
    kind = section.one_of(*kinds)
    name = section.text(kind)
    if not _ROS_NAME.fullmatch(name):
        raise section.error(kind, f"it must be the name of a {kind}, e.g. magnets/K1")
    type_name = section.text("type")
    if not _TYPE.fullmatch(type_name) or type_name.split("/")[1] != KINDS[kind]:
        raise section.error("type", f"it must be like package/{KINDS[kind]}/Type")
    called = kind != "topic"
    stamped = use == "watch" or (use != "act" and not called)
    endpoint = Endpoint(
        where=section.where,
        target=Target(kind, name, type_name),
        field=None if use == "act" else _path(section, "field"),
        message=section.section("message", needed=False).content
        if called or use in ("send", "act")
        else {},
        success=_path(section, "success") if called and "success" in section else None,
        stamp=_path(section, "stamp") if stamped and "stamp" in section else None,
        scale=section.number("scale", 1.0) if use != "act" else 1.0,
        offset=section.number("offset", 0.0) if use != "act" else 0.0,
        stale_after=section.number(
            "stale_after", 2.0 if use == "watch" else math.inf, above=0.0, finite=False
        )
        if use in ("watch", "read")
        else math.inf,
        timeout=section.number("timeout", 5.0, above=0.0, maximum=86_400.0)
        if called or use == "read"
        else math.inf,
        period=section.number("period", 0.5, minimum=0.05, maximum=3600.0)
        if called and use == "watch"
        else 0.5,
        qos="reliable" if called else section.choice("qos", "reliable", QOS),
    )
    if endpoint.scale == 0.0:
        raise section.error("scale", "it must not be 0")
    section.finish()
    return endpoint


def _path(section: Section, key: str) -> FieldPath:
    try:
        return parse_field_path(section.text(key))
    except MappingError:
        raise
    except ValueError as error:
        raise MappingError(f"{section.path(key)}: {error}") from None


def _check_name(name: str, section: Section) -> None:
    if not is_name(name):
        raise MappingError(f"{section.where}: this name is not valid; {ALLOWED}")
