"""Specification of a parameter: its types, range and choices, and its check.

Parameters of nodes and settings of the optimiser use the same specifications. The fields of a settings
dataclass made with `parameter` define them (`specs_of`): the check of its values (`check_fields`), the
declaration of the node's parameters and the tables of docs/ use them.
"""

from __future__ import annotations

import difflib
import math
import sys
from collections.abc import Collection, Iterator, Sequence
from dataclasses import MISSING, dataclass, field, fields
from types import NoneType, UnionType
from typing import Any, Union, get_args, get_origin, get_type_hints

from mobo_tuner.errors import ParameterError

ParameterValue = bool | int | float | str | tuple[float, ...] | None

NULL = "null"  # in a parameter file; ROS passes it on as a string
_TYPE_NAMES = {
    bool: "true or false",
    int: "an integer",
    float: "a number",
    tuple: "a list of numbers",
    str: "text",
    NoneType: NULL,
}


@dataclass(frozen=True)
class ParameterSpec:
    """One parameter.

    A parameter of a node is read when the node starts; only a `writable` one may be set later.

    Attributes:
        name: Name, with dots if it is below another one.
        default: Default value.
        description: Meaning, with its unit.
        minimum: Least number allowed, also of each in a list.
        maximum: Greatest number allowed, also of each in a list.
        choices: Allowed strings; any string if empty.
        writable: Whether it may be set while the node runs.
        types: Types allowed, of bool, int, float, str, tuple (a list of numbers) and NoneType;
            that of `default` if empty.
        matrix: Whether a list may also be given as the rows of a square matrix.
    """

    name: str
    default: ParameterValue
    description: str
    minimum: float = -math.inf
    maximum: float = math.inf
    choices: Collection[str] = ()
    writable: bool = False
    types: tuple[type, ...] = ()
    matrix: bool = False

    def __post_init__(self) -> None:
        """Use the type of the default if no type is given."""
        object.__setattr__(self, "types", self.types or (type(self.default),))

    def check(self, value: object, where: str = "") -> ParameterValue:
        """Return the value as one of this parameter's types.

        An integer is accepted for a number, an array of NumPy or rclpy for a list, and the string
        "null" for null. The rows of a matrix become one list.

        Args:
            value: Value to check.
            where: Text that precedes the name in an error.

        Raises:
            ParameterError: If the value is of another type or not allowed.
        """
        name = f"{where}{self.name}"
        if hasattr(value, "tolist"):
            value = value.tolist()
        if NoneType in self.types and (value is None or value == NULL):
            return None
        if isinstance(value, str) and str in self.types:
            if self.choices and value not in self.choices:
                raise ParameterError(f"{name} is {value!r}; allowed are {self._allowed}")
            return value
        if isinstance(value, bool) and bool in self.types:
            return value
        if isinstance(value, list | tuple) and tuple in self.types:
            return self._check_list(name, value)
        if float in self.types or int in self.types:
            return self._check_number(name, value, whole=int in self.types)
        raise ParameterError(f"{name} must be {self.type_name}, not {value!r}")

    def _check_number(self, name: str, value: object, *, whole: bool) -> int | float:
        if isinstance(value, float) and not whole and not math.isfinite(value):
            raise ParameterError(f"{name} must be a finite number, not {value!r}")
        # An integer may be too large to become a float.
        if (
            isinstance(value, bool)
            or not isinstance(value, int if whole else int | float)
            or not abs(value) <= sys.float_info.max
        ):
            raise ParameterError(f"{name} must be {self.type_name}, not {value!r}")
        if not self.minimum <= value <= self.maximum:
            raise ParameterError(f"{name} is {value}; {self._number_range} is allowed")
        return value if whole else float(value)

    def _check_list(self, name: str, value: Sequence[Any]) -> tuple[float, ...]:
        if self.matrix and any(isinstance(row, list | tuple) for row in value):
            if any(not isinstance(row, list | tuple) or len(row) != len(value) for row in value):
                raise ParameterError(f"{name} must be a square matrix, not {value!r}")
            value = [entry for row in value for entry in row]
        if not value:
            raise ParameterError(f"{name} is {value!r}; a list must hold at least one number")
        for entry in value:
            if isinstance(entry, bool) or not isinstance(entry, int | float):
                raise ParameterError(f"{name} must hold numbers, not {entry!r}")
        return tuple(
            self._check_number(f"{name}[{i}]", v, whole=False) for i, v in enumerate(value)
        )

    @property
    def type_name(self) -> str:
        """Allowed types, in words."""
        words = [text for kind, text in _TYPE_NAMES.items() if kind in self.types]
        if self.choices and len(words) > 1:
            words = ["a name" if word == _TYPE_NAMES[str] else word for word in words]
        return _join(words)

    @property
    def range_text(self) -> str:
        """Allowed values, in words; empty if there is no limit."""
        return "; ".join(text for text in (", ".join(self.choices), self._number_range) if text)

    @property
    def _allowed(self) -> str:
        others = (text for kind, text in _TYPE_NAMES.items() if kind in self.types)
        return ", ".join([*self.choices, *(text for text in others if text != _TYPE_NAMES[str])])

    @property
    def _number_range(self) -> str:
        low, high = (
            f"{end:.0f}" if end == round(end) and abs(end) < 1e15 else f"{end:g}"
            for end in (_finite_or_zero(self.minimum), _finite_or_zero(self.maximum))
        )
        if math.isfinite(self.minimum) and math.isfinite(self.maximum):
            return f"{low} to {high}"
        if math.isfinite(self.minimum):
            return f"at least {low}"
        return f"at most {high}" if math.isfinite(self.maximum) else ""


def parameter(default: ParameterValue, description: str, **limits: Any) -> Any:
    """Return a dataclass field that is a parameter.

    Args:
        default: Default of the field.
        description: Meaning, with its unit.
        limits: Further attributes of `ParameterSpec`; the types are those of the annotation.
    """
    return field(default=default, metadata={"description": description, **limits})


def specs_of(settings: type, prefix: str = "") -> tuple[ParameterSpec, ...]:
    """Return the specification of each field of a settings dataclass that holds plain values.

    Args:
        settings: Dataclass whose fields have defaults; those made by `parameter` say more.
        prefix: Text that precedes the names.
    """
    hints = get_type_hints(settings)
    return tuple(
        ParameterSpec(
            prefix + f.name,
            f.default,
            types=tuple(_plain_types(hints[f.name])),
            **{"description": "", **f.metadata},
        )
        for f in fields(settings)
        if f.default is not MISSING
    )


def check_fields(settings: Any) -> None:
    """Check the fields of a frozen settings dataclass and replace each by its checked value.

    Raises:
        ParameterError: If a value is of another type or not allowed.
    """
    for spec in specs_of(type(settings)):
        object.__setattr__(settings, spec.name, spec.check(getattr(settings, spec.name)))


def unknown(name: str, known: Collection[str], where: str) -> str:
    """Return the error about an unknown parameter, with the most similar known one."""
    near = difflib.get_close_matches(str(name), known, n=1)
    hint = f"did you mean '{near[0]}'?" if near else f"allowed are {', '.join(known)}"
    return f"'{name}' is unknown in {where}; {hint}"


def _plain_types(hint: Any) -> Iterator[type]:
    """Return the types of an annotation, without their arguments."""
    if get_origin(hint) in (Union, UnionType):
        for part in get_args(hint):
            yield from _plain_types(part)
    else:
        yield get_origin(hint) or hint


def _finite_or_zero(value: float) -> float:
    return value if math.isfinite(value) else 0.0


def _join(words: Sequence[str]) -> str:
    *most, last = words
    return f"{', '.join(most)} or {last}" if most else last


AUTOSTART = ParameterSpec(
    "autostart", True, "Whether the node configures and activates itself at its start."
)
"""Parameter of every machine's lifecycle node."""
