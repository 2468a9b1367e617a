"""Ramps: moves of several variables that arrive together, in bounded steps."""

from __future__ import annotations

import math
from collections.abc import Container, Iterator, Mapping
from dataclasses import dataclass

_ROUNDING = 1e-9  # a step must not be split for the last bit of a float


@dataclass(frozen=True, kw_only=True)
class RampedVariable:
    """Variable that is set in steps and read back.

    Attributes:
        name: Name of the variable.
        unit: Unit of everything below.
        minimum: Smallest set-point.
        maximum: Largest set-point.
        max_step: Largest change of the set-point in one step.
        slew: Largest speed of the set-point [unit/s].
        tolerance: Largest distance of the readback from the set-point when settled.
        words: Names of the positions 0, 1, 2, ... of a selector, between which there is nothing: it changes at the
            end of a ramp. Empty = it is no selector.
    """

    name: str
    unit: str = ""
    minimum: float
    maximum: float
    max_step: float
    slew: float
    tolerance: float
    words: tuple[str, ...] = ()


@dataclass(frozen=True)
class RampSettings:
    """How all variables of a machine move.

    Attributes:
        rate: Rate of the steps of a ramp [Hz].
        settle_time: Time for which all variables must stay settled before a measurement begins [s].
        settle_timeout: Time from the last step of a ramp until then [s].
        follow_moved: Whether a ramp may start at the readback of a variable that is not where it was
            set; otherwise such a move is refused.
    """

    rate: float = 10.0
    settle_time: float = 0.5
    settle_timeout: float = 30.0
    follow_moved: bool = False


def count_steps(
    start: Mapping[str, float], target: Mapping[str, float], largest: Mapping[str, float]
) -> int:
    """Return the number of equal steps of a move, none of them larger than `largest`; at least 1."""
    return max(
        1,
        *(
            math.ceil(abs(target[name] - start[name]) / largest[name] - _ROUNDING)
            for name in target
        ),
    )


def interpolate(
    start: Mapping[str, float],
    target: Mapping[str, float],
    steps: int,
    at_the_end: Container[str] = (),
) -> Iterator[dict[str, float]]:
    """Yield the points of a straight ramp, without `start`, ending exactly at `target`.

    Args:
        start: Where it begins.
        target: Where it ends.
        steps: Number of points.
        at_the_end: Variables that change at the last point only.
    """
    for step in range(1, steps):
        part = step / steps
        yield {
            name: start[name] + (0.0 if name in at_the_end else part) * (target[name] - start[name])
            for name in target
        }
    yield dict(target)
