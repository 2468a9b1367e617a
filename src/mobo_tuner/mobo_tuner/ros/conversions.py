"""Conversions of named values and stamps to messages and back."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence

from builtin_interfaces.msg import Time

from mobo_msgs_py import msg
from mobo_tuner.errors import MessageError

MAX_NAMES = 10_000  # in a list from another node


def seconds(stamp: Time) -> float:
    """Return a stamp in seconds since the epoch [s]."""
    return stamp.sec + 1e-9 * stamp.nanosec


def named_values(
    values: Mapping[str, float],
    units: Mapping[str, str],
    stddevs: Mapping[str, float] | None = None,
) -> list[msg.NamedValue]:
    """Return named values in the order of `values`; an unknown standard deviation is NaN."""
    return [
        msg.NamedValue(
            name=name,
            value=float(value),
            stddev=float((stddevs or {}).get(name, math.nan)),
            unit=units.get(name, ""),
        )
        for name, value in values.items()
    ]


def values_of(named: Iterable[msg.NamedValue]) -> dict[str, float]:
    """Return values by name."""
    return {item.name: item.value for item in named}


def unique_values(what: str, named: Sequence[msg.NamedValue]) -> dict[str, float]:
    """Return values by name from an untrusted client.

    Raises:
        MessageError: If there are too many, or a name occurs twice.
    """
    if len(named) > MAX_NAMES:
        raise MessageError(f"{what} has {len(named)} names; at most {MAX_NAMES} are allowed")
    values: dict[str, float] = {}
    for item in named:
        if item.name in values:
            raise MessageError(f"{what} names '{item.name[:80]}' twice")
        values[item.name] = item.value
    return values


def measurements_of(named: Iterable[msg.NamedValue]) -> dict[str, tuple[float, float]]:
    """Return pairs (mean, standard deviation) by name, for `Optimizer.tell`."""
    return {item.name: (item.value, item.stddev) for item in named}
