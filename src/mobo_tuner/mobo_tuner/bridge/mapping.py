"""The mapping file of the bridge: which topic, service or action stands for what."""

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
from mobo_tuner.machine.averaging import MAX_SHOTS, OutlierRule
from mobo_tuner.machine.ramp import RampedVariable

KINDS = {"topic": "msg", "service": "srv", "action": "action"}
QOS = ("reliable", "best_effort", "latched")
_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]*")
_ROS_NAME = re.compile(r"(~?/)?[A-Za-z_][A-Za-z0-9_]*(/[A-Za-z_][A-Za-z0-9_]*)*")
_TYPE = re.compile(r"[a-z][a-z0-9_]*/(msg|srv|action)/[A-Z][A-Za-z0-9]*")


@dataclass(frozen=True)
class Target:
    """A topic, service or action.

    Attributes:
        kind: ``topic``, ``service`` or ``action``.
        name: of the ROS graph.
        type_name: e.g. ``std_msgs/msg/Float64``.
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
        where: the endpoint is in the file, for messages.
        target: that carries the value.
        field: of the message, response or result (of the message, request or goal for a set-point);
            None where there is no value, only an act.
        message: other fields to send, as the file gives them.
        success: field of the response or result that must be true; None = not looked at.
        stamp: field that holds the time of the value; None = it is as old as the message here.
        scale: a value is ``scale * raw + offset``.
        offset: as above, in the value's unit.
        stale_after: age beyond which a value does not count [s].
        timeout: for an answer [s].
        period: between two calls of a service that is read all the time [s].
        qos: one of QOS.
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

    def value(self, raw: object) -> float:
        """What a raw number, truth value or numeric text stands for; NaN where it is none."""
        try:
            number = float(raw)  # type: ignore[arg-type]
        except (TypeError, ValueError, OverflowError):
            return math.nan
        return self.scale * number + self.offset

    def raw(self, value: float) -> float:
        """The raw number that stands for a value."""
        return (value - self.offset) / self.scale


@dataclass(frozen=True)
class Condition:
    """A condition on a value: it equals something, or lies within limits.

    Attributes:
        endpoint: of the value.
        equals: what the value must be; None where the limits count.
        minimum: least value.
        maximum: greatest value.
    """

    endpoint: Endpoint
    equals: bool | float | str | None
    minimum: float
    maximum: float

    def holds(self, raw: object) -> bool:
        """Whether a raw value meets the condition."""
        if self.equals is not None:
            return bool(raw == self.equals)
        return self.minimum <= self.endpoint.value(raw) <= self.maximum


@dataclass(frozen=True, kw_only=True)
class Variable(RampedVariable):
    """Variable with the endpoints that set and read it.

    Attributes:
        setpoint: Endpoint that takes set-points.
        readback: Endpoint that gives the readback.
        settled: Condition that must hold as well once the variable is settled; None for none.
    """

    setpoint: Endpoint
    readback: Endpoint
    settled: Condition | None


@dataclass(frozen=True)
class Diagnostic:
    """How one diagnostic is measured.

    Attributes:
        name: of the diagnostic.
        unit: of its value.
        read: where shots come from: the messages of a topic, or one call each.
        count: shots to average; 0 where the time counts.
        seconds: to average over [s]; 0 where the count does.
        outliers: that are left out of the average.
    """

    name: str
    unit: str
    read: Endpoint
    count: int
    seconds: float
    outliers: OutlierRule


@dataclass(frozen=True)
class MachineMapping:
    """A machine, as a mapping file describes it.

    Attributes:
        file: the mapping came from, for messages.
        name: of the machine, for people.
        variables: by name.
        diagnostics: by name.
        interlocks: conditions without which nothing moves, by name.
        fire: what fires each shot; None = shots come by themselves.
        shots: of an evaluation that asks for no number of its own.
        rate: of the steps of a move [Hz].
        settle_time: for which all must stay settled before a measurement counts [s].
        settle_timeout: from the last step of a move until then [s].
        follow_moved: whether a move may start at the readback of a variable that is not where it
            was set; else it is refused.
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
        ValueError: it cannot be read, or something in it is unknown, missing or not allowed.
    """
    return parse_mapping(load_yaml(path), Path(path).name)


def parse_mapping(content: object, file: str) -> MachineMapping:
    """A mapping from the content of a file.

    Raises:
        MappingError: something in it is unknown, missing or not allowed.
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
    minimum = section.number("min")
    variable = Variable(
        name=name,
        unit=section.text("unit", ""),
        minimum=minimum,
        maximum=section.number("max", above=minimum),
        max_step=section.number("max_step", above=0.0),
        slew=section.number("slew", above=0.0),
        tolerance=section.number("tolerance", above=0.0),
        setpoint=_endpoint(section.section("setpoint"), ("topic", "service", "action"), "send"),
        readback=_endpoint(section.section("readback"), ("topic", "service"), "watch"),
        settled=_condition(section.section("settled")) if "settled" in section else None,
    )
    section.finish()
    return variable


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
    diagnostic = Diagnostic(
        name=name,
        unit=section.text("unit", ""),
        read=_endpoint(section.section("read"), ("topic", "service", "action"), "read"),
        count=count,
        seconds=seconds,
        outliers=rule,
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
        section: of the file.
        kinds: of targets that are allowed.
        use: ``send`` a value; ``watch`` one all the time; ``read`` one when it is wanted; ``act``
            without a value.
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
    if not _NAME.fullmatch(name) or "__" in name:
        raise MappingError(f"{section.where}: a name must be letters, digits and underscores")
