"""Checks of values that users give: numbers, strings and names."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence

import numpy as np

from mobo_tuner.errors import UserError
from mobo_tuner.names import ALLOWED, is_name

LARGEST = 1e38
"""Largest magnitude of a number in a problem. A reading above it is a sentinel, such as the largest
float of single or double precision, and means that nothing was measured."""


class ProblemError(UserError):
    """A problem, a choice of its optimiser or a value told to it that is not allowed."""


def as_float(where: str, value: object) -> float:
    """Return a number of any type as a float, NaN and infinity included.

    Args:
        where: Name of the value, for the error.
        value: Value.

    Raises:
        ProblemError: If it is not a number: a string, a boolean, an array or a list for instance.
    """
    if isinstance(value, np.ndarray) and value.ndim == 0:
        value = value[()]
    others = str | bytes | bytearray | bool | np.bool_ | np.ndarray | np.complexfloating
    if isinstance(value, others):
        raise ProblemError(f"{where} must be a number, not {describe(value)}")
    try:
        return float(value)  # type: ignore[arg-type]
    except (TypeError, ValueError):
        raise ProblemError(f"{where} must be a number, not {describe(value)}") from None
    except OverflowError:
        raise ProblemError(f"{where} must be a finite number, not {describe(value)}") from None


def as_number(where: str, value: object) -> float:
    """Return a finite number of at most `LARGEST` in magnitude as a float.

    Args:
        where: Name of the value, for the error.
        value: Value.

    Raises:
        ProblemError: If it is not such a number.
    """
    number = as_float(where, value)
    if not math.isfinite(number):
        raise ProblemError(f"{where} must be a finite number, not {number}")
    if abs(number) > LARGEST:
        raise ProblemError(f"{where} is {number:g}; at most {LARGEST:g} in magnitude is allowed")
    return number


def as_integer(where: str, value: object, minimum: int, maximum: int | None = None) -> int:
    """Return an integer of any type, such as one of NumPy.

    Args:
        where: Name of the value, for the error.
        value: Value.
        minimum: Least integer that is allowed.
        maximum: Greatest one; None for any.

    Raises:
        ProblemError: If it is not an integer, or not in this range.
    """
    number = int(value) if isinstance(value, int | np.integer) else minimum - 1
    if isinstance(value, bool) or number < minimum or (maximum is not None and number > maximum):
        allowed = f"of at least {minimum}" if maximum is None else f"from {minimum} to {maximum}"
        raise ProblemError(f"{where} is {value!r:.60}; an integer {allowed} is allowed")
    return number


def as_string(where: str, value: object) -> str:
    """Return a string; None becomes an empty one.

    Args:
        where: Name of the value, for the error.
        value: Value.

    Raises:
        ProblemError: If it is neither.
    """
    if value is None:
        return ""
    if not isinstance(value, str):
        raise ProblemError(f"{where} must be text, not {describe(value)}")
    return value


def check_names(where: str, entry: Mapping[str, object], allowed: Sequence[str]) -> None:
    """Check that a mapping has no other names than the allowed ones.

    Args:
        where: Name of the mapping, for the error.
        entry: Mapping.
        allowed: Names that are allowed.

    Raises:
        ProblemError: If a name is unknown.
    """
    for key in entry:
        if key not in allowed:
            raise ProblemError(f"'{key}' is unknown in {where}; allowed are {listed(allowed)}")


def check_name(where: str, name: object) -> None:
    """Check the name of a quantity.

    Args:
        where: Place of the name, for the error.
        name: Name.

    Raises:
        ProblemError: If it is not one.
    """
    if not is_name(name):
        raise ProblemError(f"'{str(name)[:60]}' in {where} is not a valid name: {ALLOWED}")


def describe(value: object) -> str:
    """Return kind and beginning of a value, for an error."""
    if isinstance(value, str):
        return f"the text {value[:40]!r}"
    if value is None:
        return "empty"
    kinds = {bool: "a truth value", list: "a list", dict: "a mapping"}
    kind = kinds.get(type(value), "the value")
    try:
        return f"{kind} ({str(value)[:40]})"
    except ValueError:  # Python writes no integer of more than 4300 digits
        return f"{kind} of more than 4300 digits"


def listed(names: Iterable[str]) -> str:
    """Return names separated by commas, for an error."""
    return ", ".join(names)


def as_numbers(where: str, values: object) -> tuple[float, ...]:
    """Return a list of numbers, each as `as_number` returns it.

    Args:
        where: Name of the list, for the error.
        values: List.

    Raises:
        ProblemError: If it is no list, or a value is not a number of the allowed size.
    """
    if isinstance(values, str) or not isinstance(values, Sequence):
        raise ProblemError(f"{where} must be a list of numbers, not {describe(values)}")
    return tuple(as_number(where, value) for value in values)


def required(where: str, entry: Mapping[str, object], key: str) -> object:
    """Return a value of a mapping that must be there.

    Args:
        where: Name of the mapping, for the error.
        entry: Mapping.
        key: Name of the value.

    Raises:
        ProblemError: If it is missing or empty.
    """
    if entry.get(key) is None:
        raise ProblemError(f"{where}.{key} is missing")
    return entry[key]
