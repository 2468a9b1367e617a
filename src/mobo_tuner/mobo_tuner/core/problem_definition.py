"""The definition of a problem as nested mappings, as in a parameter file."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple, TypeVar

from mobo_tuner.core.derived import CONSTANTS, Derived
from mobo_tuner.core.fidelity import Cost, Fidelity
from mobo_tuner.core.quantities import (
    Constraint,
    Context,
    Limit,
    Objective,
    Observable,
    Variable,
)
from mobo_tuner.core.values import (
    ProblemError,
    as_number,
    as_numbers,
    as_string,
    check_name,
    check_names,
    describe,
    required,
)
from mobo_tuner.core.variable_definition import read_variable, variable_entry

_OF_FIDELITY = ("min", "max", "unit", "step", "choices", "scale", "target")
SECTIONS = (
    "variables",
    "limits",
    "derived",
    "objectives",
    "constraints",
    "observables",
    "context",
)
FIDELITY = "fidelity"
"""Section of a simulation's fidelity, which a machine does not have."""
_LIMIT_NAME = re.compile(r"(?!.*__)[A-Za-z][A-Za-z0-9_]{0,99}")


class Quantities(NamedTuple):
    """All quantities of a problem, each section in the order of its mapping."""

    variables: tuple[Variable, ...]
    objectives: tuple[Objective, ...]
    constraints: tuple[Constraint, ...]
    observables: tuple[Observable, ...]
    limits: tuple[Limit, ...]
    derived: tuple[Derived, ...]
    context: tuple[Context, ...]
    fidelity: Fidelity | None


def read_definition(mapping: Mapping[str, Any]) -> Quantities:
    """Return the quantities that a mapping defines.

    Args:
        mapping: Content of a ROS parameter file, or the sections alone.

    Raises:
        ProblemError: If a key is unknown or missing, or a value has the wrong type or is not allowed.
    """
    parameters = _problem_parameters(mapping)
    check_names("the problem", parameters, (*SECTIONS, FIDELITY))
    sections = {name: _section(parameters, name) for name in SECTIONS}
    for name in ("variables", "objectives"):
        if not sections[name]:
            raise ProblemError(f"'{name}' is missing or empty: at least one is needed")
    variables = tuple(read_variable(n, m) for n, m in sections["variables"].items())
    derived = tuple(_derived(n, m) for n, m in sections["derived"].items())
    constraints = tuple(_constraint(n, m) for n, m in sections["constraints"].items())
    _check_derived(derived, variables, constraints)
    _check_context(sections)
    fidelity = _fidelity(parameters.get(FIDELITY), sections)
    observables = dict(sections["observables"])
    for name, entry in sections["context"].items():  # whatever is a context is also observed
        observables.setdefault(name, {k: v for k, v in entry.items() if k in ("unit", "invalid")})
    return Quantities(
        variables=variables,
        objectives=_with_units(
            (_objective(n, m) for n, m in sections["objectives"].items()), derived
        ),
        constraints=_with_units(constraints, derived),
        observables=_with_units((_observable(n, m) for n, m in observables.items()), derived),
        limits=tuple(_limit(n, m, variables) for n, m in sections["limits"].items()),
        derived=derived,
        context=_with_units((_context(n, m) for n, m in sections["context"].items()), derived),
        fidelity=fidelity,
    )


def definition_of(quantities: Quantities) -> dict[str, dict[str, Any]]:
    """Return the mapping from which `read_definition` reads equal quantities."""
    limits = {limit.name: _limit_entry(limit) for limit in quantities.limits}
    derived = {d.name: {"formula": d.formula, "unit": d.unit} for d in quantities.derived}
    context = {
        c.name: {
            key: value
            for key, value in (("min", c.minimum), ("max", c.maximum))
            if math.isfinite(value)
        }
        | {"unit": c.unit}
        for c in quantities.context
    }
    return {
        "variables": {v.name: variable_entry(v) for v in quantities.variables},
        "objectives": {
            o.name: {"direction": o.direction}
            | ({"reference": o.reference} if math.isfinite(o.reference) else {})
            | {"unit": o.unit}
            | ({"truncation": list(o.truncation)} if o.truncation and o.goal is None else {})
            | ({"goal": o.goal} if o.goal is not None else {})
            | _invalid_entry(o)
            for o in quantities.objectives
        },
        "constraints": {
            c.name: {
                key: value
                for key, value in (("min", c.minimum), ("max", c.maximum))
                if math.isfinite(value)
            }
            | {"unit": c.unit}
            | ({"critical": True} if c.critical else {})
            | ({"safe": c.safe} if c.safe else {})
            | _invalid_entry(c)
            for c in quantities.constraints
        },
        "observables": {
            o.name: {"unit": o.unit} | _invalid_entry(o) for o in quantities.observables
        },
        **({"limits": limits} if limits else {}),
        **({"derived": derived} if derived else {}),
        **({"context": context} if context else {}),
        **({FIDELITY: _fidelity_entry(quantities.fidelity)} if quantities.fidelity else {}),
    }


def _fidelity_entry(fidelity: Fidelity) -> dict[str, Any]:
    entries: dict[str, Any] = {}
    for variable, target in zip(fidelity.variables, fidelity.targets, strict=True):
        entry = variable_entry(variable) | {"target": target}
        entries[variable.name] = {key: entry[key] for key in _OF_FIDELITY if key in entry}
    return entries | {"cost": fidelity.cost.formula}


def _problem_parameters(mapping: Mapping[str, Any]) -> Mapping[str, Any]:
    """Return the mapping of the problem, which a ROS parameter file has in its section ``/**``."""
    if not isinstance(mapping, Mapping):
        raise ProblemError(f"the problem must be a mapping, not {describe(mapping)}")
    section = mapping.get("/**")
    if section is None:
        return mapping
    if not isinstance(section, Mapping) or "ros__parameters" not in section:
        raise ProblemError("the section '/**' must hold 'ros__parameters'")
    parameters = section["ros__parameters"]
    if not isinstance(parameters, Mapping):
        raise ProblemError("'ros__parameters' of the section '/**' must be a mapping")
    return parameters


def _section(parameters: Mapping[str, Any], name: str) -> Mapping[str, Mapping[str, Any]]:
    section = parameters.get(name)
    if section is None:
        return {}
    if not isinstance(section, Mapping):
        raise ProblemError(f"'{name}' must be a mapping of names, not {describe(section)}")
    for key, entry in section.items():
        check_name(f"'{name}'", key)
        if name == "limits" and not _LIMIT_NAME.fullmatch(key):
            raise ProblemError(
                f"'{key[:60]}' in 'limits' is not a valid name: letters, digits and single underscores are "
                "allowed, and a letter comes first"
            )
        if entry is not None and not isinstance(entry, Mapping):
            raise ProblemError(f"'{name}.{key}' must be a mapping, not {describe(entry)}")
    return {key: entry or {} for key, entry in section.items()}


def _limit(name: str, entry: Mapping[str, Any], variables: Sequence[Variable]) -> Limit:
    where = f"limits.{name}"
    scales = {v.name: v.scale for v in variables}
    unordered = {v.name for v in variables if v.choice_names}
    check_names(where, entry, (*scales, "min", "max"))
    low, high = _ends(where, entry)
    coefficients = []
    for variable, value in entry.items():
        if variable in ("min", "max"):
            continue
        if scales[variable] == "log":
            raise ProblemError(
                f"{where} has {variable}, whose scale is log; only linear ones are allowed"
            )
        if variable in unordered:
            raise ProblemError(
                f"{where} has {variable}, whose choices are names; only numbers are allowed"
            )
        coefficient = as_number(f"{where}.{variable}", value)
        if coefficient:
            coefficients.append((variable, coefficient))
    if not coefficients:
        raise ProblemError(f"{where} has no variable: each needs a coefficient other than 0")
    return Limit(name, tuple(coefficients), low, high)


def _limit_entry(limit: Limit) -> dict[str, float]:
    ends = (("min", limit.minimum), ("max", limit.maximum))
    return dict(limit.coefficients) | {key: end for key, end in ends if math.isfinite(end)}


def _derived(name: str, entry: Mapping[str, Any]) -> Derived:
    where = f"derived.{name}"
    check_names(where, entry, ("formula", "unit"))
    unit = as_string(f"{where}.unit", entry.get("unit", ""))
    return Derived(name, entry.get("formula", ""), unit)


def _check_derived(
    derived: Sequence[Derived], variables: Sequence[Variable], constraints: Sequence[Constraint]
) -> None:
    """Check that derived quantities depend on none of each other, and that a machine need not know them."""
    names = {d.name for d in derived}
    unordered = {v.name for v in variables if v.choice_names}
    for quantity in derived:
        where = f"derived.{quantity.name}"
        if quantity.name in CONSTANTS or quantity.name in {v.name for v in variables}:
            raise ProblemError(
                f"{where} is called as a variable or a constant; another name is allowed"
            )
        for name in quantity.names:
            if name in unordered:
                raise ProblemError(
                    f"{where}.formula uses '{name}', whose choices are names; only numbers are allowed"
                )
            if name in names:
                raise ProblemError(
                    f"{where}.formula uses '{name}', which is derived itself; write its formula there"
                )
    for constraint in constraints:
        if constraint.critical and constraint.name in names:
            raise ProblemError(
                f"constraints.{constraint.name}.critical is true, but the machine, which ends such an "
                "evaluation, does not know derived quantities; false is allowed"
            )


_Measured = TypeVar("_Measured", Objective, Constraint, Observable, Context)


def _with_units(
    quantities: Iterable[_Measured], derived: Sequence[Derived]
) -> tuple[_Measured, ...]:
    """Return quantities with the units of the derived ones among them.

    Raises:
        ProblemError: If one has another unit.
    """
    units = {d.name: d.unit for d in derived}
    found = []
    for quantity in quantities:
        unit = units.get(quantity.name, "")
        if unit and quantity.unit and unit != quantity.unit:
            raise ProblemError(
                f"derived.{quantity.name}.unit is '{unit}', and the same quantity has the unit "
                f"'{quantity.unit}' elsewhere; one of the two is allowed"
            )
        found.append(replace(quantity, unit=quantity.unit or unit))
    return tuple(found)


def _objective(name: str, entry: Mapping[str, Any]) -> Objective:
    where = f"objectives.{name}"
    check_names(where, entry, ("direction", "reference", "unit", "truncation", "goal", "invalid"))
    direction = entry.get("direction", "minimize")
    if direction not in ("minimize", "maximize"):
        raise ProblemError(
            f"{where}.direction is {direction!r}; 'minimize' and 'maximize' are allowed"
        )
    reference = math.inf if direction == "minimize" else -math.inf
    if entry.get("reference") is not None:
        reference = as_number(f"{where}.reference", entry["reference"])
    truncation = None
    if entry.get("truncation") is not None:
        truncation = _interval(f"{where}.truncation", entry["truncation"])
        if math.isinf(reference):
            raise ProblemError(f"{where}.reference is missing: a truncation box needs one")
        if not truncation[0] <= reference <= truncation[1]:
            raise ProblemError(
                f"{where}.reference is {reference:g}, outside its truncation box "
                f"[{truncation[0]:g}, {truncation[1]:g}]"
            )
        if reference == truncation[direction == "maximize"]:
            raise ProblemError(
                f"{where}.reference is {reference:g}, the best end of its truncation box [{truncation[0]:g}, "
                f"{truncation[1]:g}], in which nothing can be better; the worst end, or a value inside, is allowed"
            )
    unit = as_string(f"{where}.unit", entry.get("unit", ""))
    objective = Objective(name, reference, direction, unit, truncation, _invalid(where, entry))
    return _with_goal(where, objective, entry)


def _with_goal(where: str, objective: Objective, entry: Mapping[str, Any]) -> Objective:
    """Return an objective with its goal, if it has one, as the side of its truncation box."""
    if entry.get("goal") is None:
        return objective
    if objective.truncation is not None:
        raise ProblemError(f"{where} has a goal and a truncation box; one of the two is allowed")
    goal = as_number(f"{where}.goal", entry["goal"])
    if not objective.sign * goal < objective.sign * objective.reference:
        better = "less" if objective.sign > 0.0 else "greater"
        raise ProblemError(
            f"{where}.goal is {goal:g}, which must be {better} than its reference of {objective.reference:g}"
        )
    return replace(objective, goal=goal).with_reference(objective.reference)


def _constraint(name: str, entry: Mapping[str, Any]) -> Constraint:
    where = f"constraints.{name}"
    check_names(where, entry, ("min", "max", "unit", "critical", "safe", "invalid"))
    low, high = _ends(where, entry)
    critical = entry.get("critical", False)
    if not isinstance(critical, bool):
        raise ProblemError(f"{where}.critical must be true or false, not {describe(critical)}")
    safe = as_number(f"{where}.safe", entry.get("safe", 0.0))
    if safe and not 0.5 <= safe < 1.0:
        raise ProblemError(f"{where}.safe is {safe:g}; 0, or from 0.5 to less than 1, is allowed")
    unit = as_string(f"{where}.unit", entry.get("unit", ""))
    return Constraint(name, low, high, unit, critical, _invalid(where, entry), safe)


def _observable(name: str, entry: Mapping[str, Any]) -> Observable:
    where = f"observables.{name}"
    check_names(where, entry, ("unit", "invalid"))
    unit = as_string(f"{where}.unit", entry.get("unit", ""))
    return Observable(name, unit, _invalid(where, entry))


def _context(name: str, entry: Mapping[str, Any]) -> Context:
    where = f"context.{name}"
    check_names(where, entry, ("min", "max", "unit", "invalid"))
    unit = as_string(f"{where}.unit", entry.get("unit", ""))
    if "min" not in entry and "max" not in entry:
        return Context(name, unit=unit)
    low, high = (as_number(f"{where}.{key}", required(where, entry, key)) for key in ("min", "max"))
    if not low < high:
        raise ProblemError(f"{where}.min is {low:g}, which must be less than its max of {high:g}")
    return Context(name, low, high, unit)


def _check_context(sections: Mapping[str, Mapping[str, Mapping[str, Any]]]) -> None:
    """Check that contexts are nothing that is set, wanted or limited, and have one unit."""
    for name, entry in sections["context"].items():
        for section in ("variables", "objectives", "constraints"):
            if name in sections[section]:
                raise ProblemError(
                    f"context.{name} is also in '{section}'; a diagnostic that is neither set, wanted nor "
                    "limited is allowed"
                )
        observed = sections["observables"].get(name, {})
        for key in ("unit", "invalid"):
            if key in observed and key in entry and observed[key] != entry[key]:
                raise ProblemError(
                    f"context.{name}.{key} is {entry[key]!r:.40}, and observables.{name}.{key} is "
                    f"{observed[key]!r:.40}; one of the two is allowed"
                )


def _fidelity(
    given: object, sections: Mapping[str, Mapping[str, Mapping[str, Any]]]
) -> Fidelity | None:
    """Return the fidelity of a section that may be missing."""
    if given is None:
        return None
    if not isinstance(given, Mapping):
        raise ProblemError(f"'{FIDELITY}' must be a mapping of names, not {describe(given)}")
    entries = _section({FIDELITY: {n: e for n, e in given.items() if n != "cost"}}, FIDELITY)
    if not entries:
        raise ProblemError(f"'{FIDELITY}' has no variable: at least one is needed")
    variables, targets = [], []
    for name, entry in entries.items():
        where = f"{FIDELITY}.{name}"
        check_names(where, entry, _OF_FIDELITY)
        for section, others in sections.items():
            if name in others:
                raise ProblemError(f"{where} is also in '{section}'; another name is allowed")
        variable = read_variable(name, {k: v for k, v in entry.items() if k != "target"}, FIDELITY)
        if variable.choice_names:
            raise ProblemError(f"{where}.choices has names; numbers are allowed")
        values = variable.values
        ends = (
            (variable.minimum, variable.maximum)
            if values is None
            else (float(values[0]), float(values[-1]))
        )
        if not ends[0] < ends[1]:
            raise ProblemError(f"{where} has one value only; at least two are allowed")
        target = as_number(f"{where}.target", entry.get("target", ends[1]))
        if target not in ends:
            raise ProblemError(
                f"{where}.target is {target:g}; one of its ends is allowed, {ends[0]:g} or {ends[1]:g}"
            )
        variables.append(variable)
        targets.append(target)
    formula = required(FIDELITY, given, "cost")
    cost = Cost("cost", as_string(f"{FIDELITY}.cost", formula))
    return Fidelity(tuple(variables), tuple(targets), cost)


def _ends(where: str, entry: Mapping[str, Any]) -> tuple[float, float]:
    """Return the ends of a limit, at least one of which is finite."""
    if "min" not in entry and "max" not in entry:
        raise ProblemError(f"{where} needs 'min', 'max' or both")
    low = as_number(f"{where}.min", entry["min"]) if "min" in entry else -math.inf
    high = as_number(f"{where}.max", entry["max"]) if "max" in entry else math.inf
    if not low < high:
        raise ProblemError(f"{where}.min is {low:g}, which must be less than its max of {high:g}")
    return low, high


def _invalid(where: str, entry: Mapping[str, Any]) -> tuple[float, ...]:
    values = entry.get("invalid")
    return () if values is None else as_numbers(f"{where}.invalid", values)


def _invalid_entry(quantity: Objective | Constraint | Observable) -> dict[str, list[float]]:
    return {"invalid": list(quantity.invalid)} if quantity.invalid else {}


def _interval(where: str, value: object) -> tuple[float, float]:
    if isinstance(value, str) or not isinstance(value, Sequence) or len(value) != 2:
        raise ProblemError(f"{where} must be two numbers [A, B], not {describe(value)}")
    low, high = (as_number(where, v) for v in value)
    if not low < high:
        raise ProblemError(f"{where} is [{low:g}, {high:g}], upside down: A must be less than B")
    return low, high
