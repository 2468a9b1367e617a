"""The problem as ROS parameters: declared from what a file gives, and changed while the node runs."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from rcl_interfaces.msg import ParameterDescriptor
from rclpy.node import Node

from mobo_tuner.core.problem import SECTIONS, Problem, ProblemError
from mobo_tuner.parameter_spec import NULL


@dataclass(frozen=True)
class QuantityParameter:
    """A parameter of each quantity in a section of the problem.

    Attributes:
        section: Section, one of `SECTIONS`.
        leaf: Last part of its name, `<section>.<name of the quantity>.<leaf>`.
        kind: Type and default, in words.
        description: Meaning.
        writable: Whether it may be set while the node runs. Such a parameter is declared even if the
            file does not give it.
    """

    section: str
    leaf: str
    kind: str
    description: str
    writable: bool = False


_UNIT = "Unit; if given, it must be the machine's."
_INVALID = "Readings that mean that nothing was measured."
QUANTITY_PARAMETERS = tuple(
    QuantityParameter(*row)
    for row in (
        (
            "variables",
            "min",
            "number, required",
            "Lower bound of the search; not required with choices or fixed.",
            True,
        ),
        (
            "variables",
            "max",
            "number, required",
            "Upper bound of the search; not required with choices or fixed.",
            True,
        ),
        (
            "variables",
            "step",
            "number > 0, none",
            "Step of its grid: only multiples of the step, counted from 0, are suggested.",
        ),
        (
            "variables",
            "choices",
            "list of numbers or of names, none",
            "Only values that are suggested; names have no order.",
        ),
        (
            "variables",
            "values",
            "list of numbers, 0 1 2 ...",
            "Numbers that the machine takes for the names of choices, in the same order.",
        ),
        (
            "variables",
            "scale",
            "linear or log, linear",
            "Whether differences or ratios of its values matter to the models.",
        ),
        (
            "variables",
            "fixed",
            "number, name of a choice or present, none",
            "Only value that is suggested; present = where the machine is at the start of a run.",
            True,
        ),
        (
            "variables",
            "around",
            "number or text such as 10 %, none",
            "Distance of the bounds from where the machine is at the start of a run, or as a share of "
            "the machine's range; the machine's limits, min and max are walls.",
        ),
        ("variables", "cost", "number >= 0, 1.0", "Relative cost of a change of it.", True),
        (
            "variables",
            "approach",
            "number >= 0, 0.0",
            "Distance from which the machine approaches a working point, from the side from which its "
            "evaluation came, for hysteresis; 0 = from wherever it is.",
            True,
        ),
        ("variables", "unit", "text, empty", _UNIT),
        (
            "limits",
            "VARIABLE",
            "number, 0.0",
            "Coefficient of a variable in the sum that is limited.",
        ),
        ("limits", "min", "number, none", "Least value of the sum; min, max or both.", True),
        ("limits", "max", "number, none", "Greatest value of the sum; min, max or both.", True),
        (
            "derived",
            "formula",
            "text, required",
            "Formula over diagnostics and variables, such as sqrt(eps_x * eps_y); its name is that of an "
            "objective, a constraint, an observable or none of them.",
        ),
        ("derived", "unit", "text, empty", "Unit of the result."),
        (
            "objectives",
            "reference",
            "number, inferred",
            "Component of the reference point, the worst value of interest.",
            True,
        ),
        ("objectives", "direction", "minimize or maximize, minimize", "Better direction."),
        (
            "objectives",
            "truncation",
            "two numbers [A, B], none",
            "Side of the truncation box, which contains the reference.",
            True,
        ),
        (
            "objectives",
            "goal",
            "number, none",
            "Value that is good enough, in place of a truncation box: improvement beyond it counts nothing.",
            True,
        ),
        ("objectives", "invalid", "list of numbers, empty", _INVALID),
        ("objectives", "unit", "text, empty", _UNIT),
        ("constraints", "min", "number, none", "Least feasible value; min, max or both.", True),
        ("constraints", "max", "number, none", "Greatest feasible value; min, max or both.", True),
        (
            "constraints",
            "critical",
            "true or false, false",
            "Whether one shot that violates it ends the evaluation.",
            True,
        ),
        (
            "constraints",
            "safe",
            "number, 0.0",
            "Probability, such as 0.95, with which the models must believe that a suggestion meets it; the first "
            "evaluation is where the machine is. 0 = any.",
        ),
        ("constraints", "invalid", "list of numbers, empty", _INVALID),
        ("constraints", "unit", "text, empty", _UNIT),
        ("observables", "invalid", "list of numbers, empty", _INVALID),
        ("observables", "unit", "text, empty", _UNIT),
        (
            "context",
            "min",
            "number, as measured",
            "Lower end of the range in which it is expected; a reading may lie outside. With max, or neither.",
        ),
        (
            "context",
            "max",
            "number, as measured",
            "Upper end of the range in which it is expected.",
        ),
        ("context", "invalid", "list of numbers, empty", _INVALID),
        ("context", "unit", "text, empty", _UNIT),
    )
)
FIDELITY_PARAMETERS = (
    ("fidelity.<name>.min", "number, required", "Lowest value; not required with choices."),
    ("fidelity.<name>.max", "number, required", "Highest value; not required with choices."),
    ("fidelity.<name>.step", "number > 0, none", "Step of its grid, as for a variable."),
    ("fidelity.<name>.choices", "list of numbers, none", "Only values that are chosen."),
    (
        "fidelity.<name>.scale",
        "linear or log, linear",
        "Whether differences or ratios of its values matter.",
    ),
    (
        "fidelity.<name>.target",
        "number, its highest value",
        "Value at the highest fidelity, one end of its range.",
    ),
    ("fidelity.<name>.unit", "text, empty", "Unit."),
    (
        "fidelity.cost",
        "text, required",
        "Formula of the cost of one simulation, over the names in this section, in any unit.",
    ),
)
"""Names, types and meanings in the section of a campaign's fidelities, which is no parameter of a node."""
_BY_NAME = {(p.section, p.leaf): p for p in QUANTITY_PARAMETERS}


class ProblemParameters:
    """The parameters of a node under the sections of a problem.

    The node must declare its parameters from overrides, since only the file knows their names.

    Raises:
        ProblemError: If they do not form a valid problem.
    """

    def __init__(self, node: Node) -> None:
        self._values: dict[str, Any] = {}  # also of entries that are unset
        for section in SECTIONS:
            given: Mapping[str, Any] = node.get_parameters_by_prefix(section)
            for key, given_parameter in given.items():
                name = f"{section}.{key}"
                self._values[name] = _plain(given_parameter.value)
                node.set_descriptor(name, _descriptor(name))
        self._given = self.problem = Problem.from_dict(_nested(self._values))
        self._resolve: Callable[[Problem], Problem] = lambda problem: problem
        for parameter in QUANTITY_PARAMETERS:
            for quantity in getattr(self.problem, parameter.section):
                name = f"{parameter.section}.{quantity.name}.{parameter.leaf}"
                if parameter.writable and not node.has_parameter(name):
                    node.declare_parameter(name, None, _descriptor(name))

    def owns(self, name: str) -> bool:
        """Return whether a parameter of this name is part of the problem."""
        return name.split(".")[0] in SECTIONS

    @property
    def open_variables(self) -> tuple[str, ...]:
        """Names of the variables whose bounds or value depend on where the machine is."""
        return self._given.open_variables

    def resolve(self, by: Callable[[Problem], Problem]) -> None:
        """Resolve the open variables; it holds until the next time, also after changes.

        Args:
            by: Function that returns a problem with its open variables resolved.

        Raises:
            ProblemError: If it cannot; nothing is changed.
        """
        self.problem = by(self._given)
        self._resolve = by

    def with_changes(self, changes: Mapping[str, Any]) -> Problem:
        """Return the problem with some parameters set.

        Raises:
            ProblemError: If they do not form a valid problem.
        """
        problem = Problem.from_dict(_nested(self._with(changes)))
        return self._resolve(problem) if problem.open_variables else problem

    def accept(self, changes: Mapping[str, Any]) -> None:
        """Take over parameters that were set."""
        self.problem = self.with_changes(changes)
        self._values = self._with(changes)
        self._given = Problem.from_dict(_nested(self._values))

    def _with(self, changes: Mapping[str, Any]) -> dict[str, Any]:
        """Return the values with some set, or unset by null."""
        for name, value in changes.items():
            if value is None:
                raise ProblemError(f"{name} cannot be deleted; '{NULL}' unsets it")
        return {**self._values, **{name: _plain(value) for name, value in changes.items()}}


def _is_unset(value: Any) -> bool:
    """Return whether a parameter has no value: it was only declared, or is the text "null"."""
    return value is None or (isinstance(value, str) and value == NULL)


def _descriptor(name: str) -> ParameterDescriptor:
    section, _, leaf = _parts(name)
    known = _BY_NAME.get((section, leaf))
    if section == "limits" and known is None:
        known = _BY_NAME["limits", "VARIABLE"]
    return ParameterDescriptor(
        name=name,
        description=known.description if known else "",
        read_only=known is None or not known.writable,
        dynamic_typing=True,  # so that 500 may stand for 500.0; checked by the problem
    )


def _parts(name: str) -> tuple[str, str, str]:
    """Return section, quantity and last part of a parameter's name; names of quantities may have dots.

    The last part has none, but in a limit, where it is the name of a variable and that of the limit has none.
    """
    section, _, rest = name.partition(".")
    if section == "limits":
        quantity, _, leaf = rest.partition(".")
    else:
        quantity, _, leaf = rest.rpartition(".")
    return section, quantity, leaf


def _plain(value: Any) -> Any:
    """Return a parameter's value without the array types of rclpy."""
    return list(value) if hasattr(value, "tolist") else value


def _nested(values: Mapping[str, Any]) -> dict[str, Any]:
    """Return the mapping that a file would hold; what has only unset entries is still named."""
    nested: dict[str, Any] = {}
    for name, value in values.items():
        section, quantity, leaf = _parts(name)
        if not quantity or not leaf:
            raise ProblemError(f"'{name}' is not a parameter of a quantity in '{section}'")
        entry = nested.setdefault(section, {}).setdefault(quantity, {})
        if not _is_unset(value):
            entry[leaf] = value
    return nested
