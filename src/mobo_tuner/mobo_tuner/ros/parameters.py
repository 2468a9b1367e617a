"""Parameters: declared, described and checked in one way, from ROS or from a file before it starts.

Nothing here imports rclpy at the top, so that a parameter file can be checked before any node runs.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from mobo_tuner.errors import ParameterError

if TYPE_CHECKING:
    from rclpy.node import Node

ParameterValue = bool | int | float | str


@dataclass(frozen=True)
class ParameterSpec:
    """One parameter of a node; its type is that of `default`.

    It is read when the node starts; only a `writable` one may be set later.
    """

    name: str
    default: ParameterValue
    description: str
    minimum: float = -math.inf
    maximum: float = math.inf
    choices: tuple[str, ...] = ()
    writable: bool = False

    def check(self, value: object, where: str = "") -> ParameterValue:
        """The value as this parameter's type.

        Raises:
            ParameterError: it is of another type or not allowed; `where` precedes the name.
        """
        name = f"{where}{self.name}"
        if isinstance(self.default, bool) or isinstance(value, bool):
            if not (isinstance(self.default, bool) and isinstance(value, bool)):
                raise ParameterError(f"{name} must be {self.type_name}, not {value!r}")
            return value
        if isinstance(self.default, str):
            if not isinstance(value, str):
                raise ParameterError(f"{name} must be {self.type_name}, not {value!r}")
            if self.choices and value not in self.choices:
                raise ParameterError(f"{name} is {value!r}; allowed are {', '.join(self.choices)}")
            return value
        whole = isinstance(self.default, int)
        # A whole number may be too large for any comparison with a float but this one.
        if not isinstance(value, int if whole else int | float) or not abs(value) < math.inf:
            raise ParameterError(f"{name} must be {self.type_name}, not {value!r}")
        if not self.minimum <= value <= self.maximum:
            raise ParameterError(f"{name} is {value}; {self.range_text} is allowed")
        return value if whole else float(value)

    @property
    def type_name(self) -> str:
        """The parameter's type, in words."""
        names = {bool: "true or false", int: "a whole number", float: "a number", str: "text"}
        return names[type(self.default)]

    @property
    def range_text(self) -> str:
        """What is allowed, in words; empty where everything is."""
        if self.choices:
            return ", ".join(self.choices)
        low, high = (
            f"{end:.0f}" if math.isfinite(end) and end == round(end) else f"{end:g}"
            for end in (self.minimum, self.maximum)
        )
        if math.isfinite(self.minimum) and math.isfinite(self.maximum):
            return f"{low} to {high}"
        if math.isfinite(self.minimum):
            return f"at least {low}"
        return f"at most {high}" if math.isfinite(self.maximum) else ""


def node_sections(content: Mapping[Any, Any]) -> dict[str, dict[str, Any]]:
    """Return the parameters of each node in a parameter file, by the node's name.

    The section ``/**``, which is for all nodes, is left out. ``tuner``, ``/tuner`` and ``/**/tuner``
    all are sections of the node ``tuner``.

    Raises:
        ParameterError: If a section does not hold ``ros__parameters`` alone.
    """
    sections: dict[str, dict[str, Any]] = {}
    for key, section in content.items():
        if key == "/**":
            continue
        if not isinstance(section, Mapping) or list(section) != ["ros__parameters"]:
            raise ParameterError(
                f"the section '{key}' must hold 'ros__parameters' and nothing else"
            )
        parameters = section["ros__parameters"]
        if not isinstance(parameters, Mapping):
            raise ParameterError(f"'ros__parameters' of the section '{key}' must be a mapping")
        name = str(key).removeprefix("/**").removeprefix("/")
        sections.setdefault(name, {}).update(parameters)
    return sections


def check_section(
    where: str, section: Mapping[str, Any], specs: Sequence[ParameterSpec]
) -> dict[str, ParameterValue]:
    """Check one node's parameters as they stand in a file; defaults fill what is not given.

    Raises:
        ParameterError: a parameter is unknown, of the wrong type or not allowed.
    """
    known = {spec.name: spec for spec in specs}
    for name in section:
        if name not in known and name != "use_sim_time":
            raise ParameterError(f"'{name}' is unknown in {where}; allowed are {', '.join(known)}")
    return {
        spec.name: spec.check(section.get(spec.name, spec.default), f"{where}.") for spec in specs
    }


def declare(node: Node, specs: Sequence[ParameterSpec]) -> dict[str, Any]:
    """Declare parameters with description and range, and return their values.

    Raises:
        ParameterError: a value is of the wrong type or not allowed.
    """
    from rcl_interfaces.msg import ParameterDescriptor

    values = {}
    for spec in specs:
        descriptor = ParameterDescriptor(
            name=spec.name,
            description=spec.description,
            additional_constraints=spec.range_text,
            read_only=not spec.writable,
            dynamic_typing=True,  # so that `speed: 100` may stand for 100.0; checked below
        )
        if node.has_parameter(spec.name):
            value = node.get_parameter(spec.name).value
            node.set_descriptor(spec.name, descriptor)
        else:
            value = node.declare_parameter(spec.name, spec.default, descriptor).value
        values[spec.name] = spec.check(value)
    return values
