"""The definition of a variable as a mapping, as in a parameter file."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from typing import Any

from mobo_tuner.core.quantities import Scale, Variable, share_of
from mobo_tuner.core.values import (
    LARGEST,
    ProblemError,
    as_number,
    as_numbers,
    as_string,
    check_names,
    describe,
    listed,
    required,
)

MOST_VALUES = 2_000_000
"""Largest number of values on the grid of a variable."""
PRESENT = "present"
"""Value of `fixed` for a variable that stays where the machine is at the start of a run."""
PERCENT = re.compile(r"\s*\d+(\.\d*)?\s*%\s*")
_OF_VARIABLES = (
    *("min", "max", "unit", "cost", "step", "choices", "values", "scale", "fixed", "around"),
    "approach",
)
_OF_NUMBERS = ("min", "max", "step", "scale", "around", "approach")  # not of unordered choices
_FINEST = 1e-12  # least range of a variable, relative to its bounds


def read_variable(name: str, entry: Mapping[str, Any], section: str = "variables") -> Variable:
    """Return the variable that a mapping defines.

    Args:
        name: Name of the variable.
        entry: Mapping, as in a parameter file.
        section: Name of the section that has it, for errors.

    Raises:
        ProblemError: If a key is unknown or missing, or a value has the wrong type or is not allowed.
    """
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
    # Of an open variable it is checked once that is resolved; one that stays where it is needs no grid.
    step = _step(where, entry, *((-math.inf, math.inf) if fixed is not None else (low, high)))
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


def variable_entry(v: Variable) -> dict[str, Any]:
    """Return the mapping from which `read_variable` reads an equal variable."""
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
    choices = as_numbers(f"{where}.choices", given)
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
        values = as_numbers(f"{where}.values", entry["values"])
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
            instead if given is None and instead is not None else required(where, entry, key),
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
