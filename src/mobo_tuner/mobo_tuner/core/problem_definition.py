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
    Scale,
    Variable,
)
from mobo_tuner.core.values import (
    LARGEST,
    ProblemError,
    as_number,
    as_string,
    check_name,
    check_names,
    describe,
    listed,
)

_OF_VARIABLES = (
    *("min", "max", "unit", "cost", "step", "choices", "values", "scale", "fixed", "around"),
    "approach",
)
_OF_FIDELITY = ("min", "max", "unit", "step", "choices", "scale", "target")
_OF_NUMBERS = ("min", "max", "step", "scale", "around", "approach")  # not of unordered choices
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
MOST_VALUES = 2_000_000
"""Largest number of values on the grid of a variable."""
PRESENT = "present"
"""Value of `fixed` for a variable that stays where the machine is at the start of a run."""
PERCENT = re.compile(r"\s*\d+(\.\d*)?\s*%\s*")
_FINEST = 1e-12  # least range of a variable, relative to its bounds
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
    variables = tuple(_variable(n, m) for n, m in sections["variables"].items())
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
        "variables": {v.name: _variable_entry(v) for v in quantities.variables},
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


def _variable_entry(v: Variable) -> dict[str, Any]:
    return (
        {
            key: bound
            for key, bound in (("min", v.minimum), ("max", v.maximum))
            if math.isfinite(bound) and not v.choice_names
        }
        | {"unit": v.unit, "cost": v.cost}
        | ({"step": v.step} if v.step else {})
        | _choices_entry(v)
        | ({"scale": v.scale} if v.scale != "linear" else {})
        | ({"fixed": _fixed_entry(v)} if v.fixed is not None else {})
        | ({"fixed": PRESENT} if v.at_present else {})
        | ({"around": v.around} if v.around is not None else {})
        | ({"approach": v.approach} if v.approach else {})
    )


def _fidelity_entry(fidelity: Fidelity) -> dict[str, Any]:
    entries: dict[str, Any] = {}
    for variable, target in zip(fidelity.variables, fidelity.targets, strict=True):
        entry = _variable_entry(variable) | {"target": target}
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


def _variable(name: str, entry: Mapping[str, Any], section: str = "variables") -> Variable:
    where = f"{section}.{name}"
    check_names(where, entry, _OF_VARIABLES)
    scale = _scale(where, entry)
    at_present = entry.get("fixed") == PRESENT
    choices, names = _choices(where, entry)
    fixed = None
    if entry.get("fixed") is not None and not at_present:
        fixed = choice_value(f"{where}.fixed", entry["fixed"], choices, names)
    around = _around(where, entry)
    if around is not None and entry.get("fixed") is not None:
        raise ProblemError(f"{where} has around and fixed; one of the two is allowed")
    if at_present or around is not None:
        low, high = _walls(where, entry)
    else:
        low, high = _bounds(where, entry, choices, fixed, scale)
    cost = _not_negative(where, entry, "cost", 1.0)
    approach = _not_negative(where, entry, "approach", 0.0)
    if fixed is not None and not low <= fixed <= high:
        raise ProblemError(f"{where}.fixed is {fixed:g}; {low:g} to {high:g} is allowed")
    step = _step(
        where, entry, low, high
    )  # of an open variable, it is checked once that is resolved
    if step and choices:
        raise ProblemError(f"{where} has a step and choices; one of the two is allowed")
    unit = as_string(f"{where}.unit", entry.get("unit", ""))
    variable = Variable(
        name,
        low,
        high,
        unit,
        cost,
        step,
        choices,
        scale,
        fixed,
        around,
        at_present,
        approach,
        names,
    )
    if not variable.is_open and variable.values is not None and not len(variable.values):
        kind = f"multiple of the step {step:g}" if step else "of its choices"
        raise ProblemError(f"{where}.min to max is {low:g} to {high:g}, with no {kind} in between")
    return variable


def _not_negative(where: str, entry: Mapping[str, Any], key: str, default: float) -> float:
    value = as_number(f"{where}.{key}", entry.get(key, default))
    if value < 0.0:
        raise ProblemError(f"{where}.{key} is {value:g}, which must not be negative")
    return value


def _around(where: str, entry: Mapping[str, Any]) -> float | str | None:
    """Return half the width of the bounds: a number, or a text such as "10 %"."""
    value = entry.get("around")
    if value is None:
        return None
    if isinstance(value, str):
        if not PERCENT.fullmatch(value) or not 0.0 < share_of(value) <= 1.0:
            raise ProblemError(
                f"{where}.around is {value!r:.40}; a number, or a share of the machine's range such as "
                "'10 %' is allowed"
            )
        return value
    around = as_number(f"{where}.around", value)
    if not around > 0.0:
        raise ProblemError(f"{where}.around is {around:g}, which must be greater than 0")
    return around


def share_of(percent: str) -> float:
    """Return the share that a text such as "10 %" names."""
    return float(percent.replace("%", "")) / 100.0


def _walls(where: str, entry: Mapping[str, Any]) -> tuple[float, float]:
    """Return the bounds of an open variable as far as they are given, infinite where not."""
    low, high = (
        infinite if entry.get(key) is None else as_number(f"{where}.{key}", entry[key])
        for key, infinite in (("min", -math.inf), ("max", math.inf))
    )
    if not low < high:
        raise ProblemError(f"{where}.min is {low:g}, which must be less than its max of {high:g}")
    return low, high


def _scale(where: str, entry: Mapping[str, Any]) -> Scale:
    scale = entry.get("scale", "linear")
    if scale == "log":
        return "log"
    if scale == "linear":
        return "linear"
    raise ProblemError(f"{where}.scale is {scale!r}; 'linear' and 'log' are allowed")


def _choices(where: str, entry: Mapping[str, Any]) -> tuple[tuple[float, ...], tuple[str, ...]]:
    """Return the choices in ascending order and, if they stand for names without an order, these names."""
    given = entry.get("choices")
    if given is None:
        if entry.get("values") is not None:
            raise ProblemError(
                f"{where}.values is given without choices, whose names it would number"
            )
        return (), ()
    if (
        not isinstance(given, str)
        and isinstance(given, Sequence)
        and any(isinstance(c, str) for c in given)
    ):
        return _named_choices(where, entry, given)
    choices = _numbers(f"{where}.choices", given)
    if entry.get("values") is not None:
        raise ProblemError(
            f"{where}.values is given, but its choices are numbers; names are allowed"
        )
    if len(set(choices)) < 2:
        raise ProblemError(
            f"{where}.choices is {list(choices)}; at least two numbers are allowed, and 'fixed' for one"
        )
    return tuple(sorted(set(choices))), ()


def _named_choices(
    where: str, entry: Mapping[str, Any], given: Sequence[object]
) -> tuple[tuple[float, ...], tuple[str, ...]]:
    """Return what the machine takes for choices that are names, in ascending order, and the names."""
    names = [name for name in given if isinstance(name, str)]
    if len(names) < len(given):
        other = next(c for c in given if not isinstance(c, str))
        raise ProblemError(
            f"{where}.choices has names and {describe(other)}; either names or numbers are allowed (names such as "
            "'on' and 'off' must stand in quotes)"
        )
    if len(set(names)) < max(2, len(names)) or PRESENT in names or "" in names:
        raise ProblemError(
            f"{where}.choices is {names!r:.60}; at least two different names are allowed, none of them empty or "
            f"'{PRESENT}'"
        )
    for key in _OF_NUMBERS:
        if entry.get(key) is not None:
            raise ProblemError(
                f"{where}.{key} is given, but its choices are names, which have no order"
            )
    values: Sequence[float] = range(len(names))
    if entry.get("values") is not None:
        values = _numbers(f"{where}.values", entry["values"])
        if len(set(values)) != len(names) or len(values) != len(names):
            raise ProblemError(
                f"{where}.values is {list(values)!r:.60}; {len(names)} different numbers are allowed, one for each of "
                "its choices"
            )
    pairs = sorted(zip(map(float, values), names, strict=True))
    return tuple(value for value, _ in pairs), tuple(name for _, name in pairs)


def choice_value(
    where: str, given: object, choices: Sequence[float], names: Sequence[str]
) -> float:
    """Return a value of a variable, which may be given by the name of a choice.

    Args:
        where: Name of the value, for the error.
        given: Number, or name.
        choices: Numbers that stand for the names.
        names: Names of the choices; empty if they have none.

    Raises:
        ProblemError: If it is neither.
    """
    if names and isinstance(given, str):
        if given not in names:
            raise ProblemError(f"{where} is '{given[:60]}'; allowed are {listed(names)}")
        return choices[names.index(given)]
    return as_number(where, given)


def _choices_entry(variable: Variable) -> dict[str, list[Any]]:
    if variable.choice_names:
        return {"choices": list(variable.choice_names), "values": list(variable.choices)}
    return {"choices": list(variable.choices)} if variable.choices else {}


def _fixed_entry(variable: Variable) -> float | str:
    assert variable.fixed is not None
    return variable.shown(variable.fixed) if variable.choice_names else variable.fixed


def _step(where: str, entry: Mapping[str, Any], low: float, high: float) -> float:
    if entry.get("step") is None:
        return 0.0
    step = as_number(f"{where}.step", entry["step"])
    if not step > 0.0:
        raise ProblemError(f"{where}.step is {step:g}, which must be greater than 0")
    if math.isinf(high - low):
        return step
    if (high - low) / step > MOST_VALUES or max(abs(low), abs(high)) / step > 1e15:
        raise ProblemError(
            f"{where}.step is {step:g}, too fine for {low:g} to {high:g}: at most {MOST_VALUES} values "
            "are allowed; leave it out for a variable that is nearly continuous"
        )
    return step


def _bounds(
    where: str,
    entry: Mapping[str, Any],
    choices: tuple[float, ...],
    fixed: float | None,
    scale: Scale,
) -> tuple[float, float]:
    """Return the bounds; those that are left out are those of the choices, or around a fixed value."""
    least, most = (choices[0], choices[-1]) if choices else (None, None)
    if fixed is not None and not choices:
        around = max(0.5 * abs(fixed), 1.0 / LARGEST) if fixed else 1.0
        least, most = fixed - around, fixed + around
    bounds = {}
    for key, instead in (("min", least), ("max", most)):
        given = entry.get(key)
        bounds[key] = as_number(
            f"{where}.{key}",
            instead if given is None and instead is not None else _required(where, entry, key),
        )
    low, high = bounds["min"], bounds["max"]
    if not low < high:
        raise ProblemError(f"{where}.min is {low:g}, which must be less than its max of {high:g}")
    if high - low < max(_FINEST * max(abs(low), abs(high)), 1.0 / LARGEST):
        raise ProblemError(
            f"{where}.max is {high!r}, too near to its min of {low!r}: a range of at least "
            f"{_FINEST:g} of the bounds, and of {1.0 / LARGEST:g}, is allowed"
        )
    if scale == "log" and not low > 0.0:
        raise ProblemError(f"{where}.min is {low:g}; with scale log it must be greater than 0")
    return low, high


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
    low, high = (
        as_number(f"{where}.{key}", _required(where, entry, key)) for key in ("min", "max")
    )
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
        variable = _variable(name, {k: v for k, v in entry.items() if k != "target"}, FIDELITY)
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
    formula = _required(FIDELITY, given, "cost")
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
    return () if values is None else _numbers(f"{where}.invalid", values)


def _numbers(where: str, values: object) -> tuple[float, ...]:
    if isinstance(values, str) or not isinstance(values, Sequence):
        raise ProblemError(f"{where} must be a list of numbers, not {describe(values)}")
    return tuple(as_number(where, value) for value in values)


def _invalid_entry(quantity: Objective | Constraint | Observable) -> dict[str, list[float]]:
    return {"invalid": list(quantity.invalid)} if quantity.invalid else {}


def _interval(where: str, value: object) -> tuple[float, float]:
    if isinstance(value, str) or not isinstance(value, Sequence) or len(value) != 2:
        raise ProblemError(f"{where} must be two numbers [A, B], not {describe(value)}")
    low, high = (as_number(where, v) for v in value)
    if not low < high:
        raise ProblemError(f"{where} is [{low:g}, {high:g}], upside down: A must be less than B")
    return low, high


def _required(where: str, entry: Mapping[str, Any], key: str) -> object:
    if entry.get(key) is None:
        raise ProblemError(f"{where}.{key} is missing")
    return entry[key]
