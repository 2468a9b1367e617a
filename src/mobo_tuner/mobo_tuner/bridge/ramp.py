"""A ramp: the interpolated steps of a move of several variables that arrive together."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping

_ROUNDING = 1e-9  # a step must not be split for the last bit of a float


def count_steps(
    start: Mapping[str, float], target: Mapping[str, float], largest: Mapping[str, float]
) -> int:
    """How many equal steps a move takes, none of them larger than `largest`; at least one."""
    return max(
        1,
        *(
            math.ceil(abs(target[name] - start[name]) / largest[name] - _ROUNDING)
            for name in target
        ),
    )


def interpolate(
    start: Mapping[str, float], target: Mapping[str, float], steps: int
) -> Iterator[dict[str, float]]:
    """The points of a straight ramp, `start` left out, ending exactly at `target`."""
    for step in range(1, steps):
        part = step / steps
        yield {name: start[name] + part * (target[name] - start[name]) for name in target}
    yield dict(target)
