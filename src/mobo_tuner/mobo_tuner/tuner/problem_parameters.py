"""The problem as ROS parameters: declared from what a file gives, and changed while the node runs."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from rcl_interfaces.msg import ParameterDescriptor
from rclpy.node import Node

from mobo_tuner.core.problem import SECTIONS, Problem, ProblemError
from mobo_tuner.parameter_spec import NULL

_DESCRIPTIONS = {
    ("variables", "min"): "lower bound of the search",
    ("variables", "max"): "upper bound of the search",
    ("variables", "cost"): "relative cost of changing the variable",
    ("objectives", "direction"): "minimize or maximize",
    ("objectives", "reference"): "component of the reference point",
    ("objectives", "truncation"): "side [A, B] of the truncation box",
    ("objectives", "invalid"): "readings that mean that nothing was measured",
    ("constraints", "min"): "least value that is feasible",
    ("constraints", "max"): "greatest value that is feasible",
    ("constraints", "invalid"): "readings that mean that nothing was measured",
    ("observables", "invalid"): "readings that mean that nothing was measured",
    ("constraints", "critical"): "whether a single shot that violates it ends the evaluation",
}
# What may be set while the node runs, by section; it is declared even where the file lacks it.
WRITABLE = {
    "variables": ("min", "max", "cost"),
    "objectives": ("reference", "truncation"),
    "constraints": ("min", "max", "critical"),
    "observables": (),
}


class ProblemParameters:
    """The parameters under `variables`, `objectives`, `constraints` and `observables` of a node.

    The node must declare its parameters from overrides, since only the file knows their names.

    Raises:
        ProblemError: they do not make up a problem.
    """

    def __init__(self, node: Node) -> None:
        self._values: dict[str, Any] = {}
        for section in SECTIONS:
            given: Mapping[str, Any] = node.get_parameters_by_prefix(section)
            for key, parameter in given.items():
                name = f"{section}.{key}"
                if not _is_unset(parameter.value):
                    self._values[name] = _plain(parameter.value)
                node.set_descriptor(name, _descriptor(name))
        self.problem = Problem.from_dict(_nested(self._values))
        for section, leaves in WRITABLE.items():
            for quantity in getattr(self.problem, section):
                for leaf in leaves:
                    name = f"{section}.{quantity.name}.{leaf}"
                    if not node.has_parameter(name):
                        node.declare_parameter(name, None, _descriptor(name))

    def owns(self, name: str) -> bool:
        """Whether a parameter of this name is part of the problem."""
        return name.split(".")[0] in SECTIONS

    def with_changes(self, changes: Mapping[str, Any]) -> Problem:
        """The problem with some parameters set.

        Raises:
            ProblemError: they do not make up a problem.
        """
        return Problem.from_dict(_nested(self._with(changes)))

    def accept(self, changes: Mapping[str, Any]) -> None:
        """Some parameters were set."""
        self.problem = self.with_changes(changes)
        self._values = self._with(changes)

    def _with(self, changes: Mapping[str, Any]) -> dict[str, Any]:
        """The values with some set, or unset by null."""
        for name, value in changes.items():
            if value is None:
                raise ProblemError(f"{name} cannot be deleted; '{NULL}' unsets it")
        values = {**self._values, **{name: _plain(value) for name, value in changes.items()}}
        return {name: value for name, value in values.items() if not _is_unset(value)}


def _is_unset(value: Any) -> bool:
    """Whether a parameter has no value: a leaf that was declared only, or the text of null."""
    return value is None or (isinstance(value, str) and value == NULL)


def _descriptor(name: str) -> ParameterDescriptor:
    section, *_, leaf = name.split(".")
    return ParameterDescriptor(
        name=name,
        description=_DESCRIPTIONS.get((section, leaf), ""),
        read_only=leaf not in WRITABLE[section],
        dynamic_typing=True,  # so that 500 may stand for 500.0; checked by the problem
    )


def _plain(value: Any) -> Any:
    """A parameter's value without the array types of rclpy."""
    return list(value) if hasattr(value, "tolist") else value


def _nested(values: Mapping[str, Any]) -> dict[str, Any]:
    """The mapping that a file would hold."""
    nested: dict[str, Any] = {}
    for name, value in values.items():
        branch = nested
        *path, leaf = name.split(".")
        for part in path:
            branch = branch.setdefault(part, {})
            if not isinstance(branch, dict):
                raise ProblemError(f"'{name}' stands below a value")
        branch[leaf] = value
    return nested
