"""The parameters of nodes: checked as they stand in a file, declared as they are specified.

Nothing here imports rclpy at the top, so that a parameter file can be checked before any node runs.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from mobo_tuner.errors import ParameterError
from mobo_tuner.parameter_spec import ParameterSpec, unknown

if TYPE_CHECKING:
    from rclpy.node import Node


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
) -> dict[str, Any]:
    """Check one node's parameters as they stand in a file; defaults fill what is not given.

    Args:
        where: Name of the section.
        section: Parameters; those in a mapping have its name and a dot before theirs.
        specs: Parameters of the node.

    Raises:
        ParameterError: If a parameter is unknown, of another type or not allowed.
    """
    given = dict(_flat(section))
    known = [spec.name for spec in specs]
    for name in given:
        if name not in known and name != "use_sim_time":
            raise ParameterError(unknown(name, known, where))
    return {
        spec.name: spec.check(given.get(spec.name, spec.default), f"{where}.") for spec in specs
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


def _flat(section: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    for name, value in section.items():
        if isinstance(value, Mapping) and value:
            yield from _flat(value, f"{prefix}{name}.")
        else:
            yield f"{prefix}{name}", value
