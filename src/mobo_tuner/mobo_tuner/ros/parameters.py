"""Parameters of nodes: given on the command line, declared as they are specified."""

from __future__ import annotations

import tempfile
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from itertools import pairwise
from typing import Any

from rcl_interfaces.msg import ParameterDescriptor
from rclpy.node import Node

from mobo_tuner.errors import ParameterError
from mobo_tuner.parameter_spec import ParameterSpec, unknown


@contextmanager
def with_parameters_first(arguments: Sequence[str]) -> Iterator[list[str]]:
    """Yield a command line whose `-p name:=value` wins over the sections of its parameter files.

    ROS merges such a parameter into the section of all nodes, which yields to that of the node. It
    is therefore given once more, in a file with a section for any node, the last of all files.

    Args:
        arguments: Command line of a node's process.
    """
    given = {}
    for flag, text in pairwise(arguments):
        name, assigned, value = text.partition(":=")
        if flag in ("-p", "--param") and assigned and ":" not in name and "\n" not in value:
            given[name] = value
    if not given:
        yield list(arguments)
        return
    lines = [f"    {name}: {value}" for name, value in given.items()]
    with tempfile.NamedTemporaryFile("w", suffix=".yaml", encoding="utf-8") as file:
        file.write("\n".join(["/**/*:", "  ros__parameters:", *lines, ""]))
        file.flush()
        yield [*arguments, "--ros-args", "--params-file", file.name]


def given_parameters(node: Node) -> dict[str, Any]:
    """Return the parameters of a node that declares them from its files and command line."""
    own = ("use_sim_time", "start_type_description_service")
    declared: Mapping[str, Any] = node.get_parameters_by_prefix("")
    return {
        name: parameter.value
        for name, parameter in declared.items()
        if name not in own and not name.startswith("qos_overrides.")
    }


def refuse_unknown(given: Iterable[str], known: Collection[str]) -> None:
    """Refuse parameters that a node does not have, of which ROS says nothing.

    Args:
        given: Names of the parameters.
        known: Names of the node's parameters and of what its other parameters stand below.

    Raises:
        ParameterError: If one is unknown.
    """
    for name in given:
        first, dot, _ = name.partition(".")
        if name not in known and not (dot and first in known):
            raise ParameterError(unknown(name if name.count(".") < 2 else first, known, "the node"))


def declare(node: Node, specs: Sequence[ParameterSpec]) -> dict[str, Any]:
    """Declare parameters with description and range, and return their values.

    Raises:
        ParameterError: If a value is of another type or not allowed.
    """
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
            default = list(spec.default) if isinstance(spec.default, tuple) else spec.default
            value = node.declare_parameter(spec.name, default, descriptor).value
        values[spec.name] = spec.check(value)
    return values
