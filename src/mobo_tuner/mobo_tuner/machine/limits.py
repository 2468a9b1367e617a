"""Limits on sums of variables, which a goal brings along, and ways between two set-points that keep them."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from mobo_msgs_py import msg

_ROUNDING = 1e-9  # excess of a sum, relative to the largest of its terms and ends, that is rounding
_HALVINGS = 8  # of the straight way, so that it has at most 256 parts


class SumLimits:
    """Limits on weighted sums of variables.

    Variables of one machine move at different speeds. On the way from one set-point to another each may be anywhere
    between its two values, independently of the others, so that a sum may leave its limits although it keeps them
    at both ends. A way that keeps them has steps so short, and in such an order, that no combination of values within
    any step exceeds a limit.

    Args:
        limits: Limits of a goal.
        variables: Variables of the machine.

    Raises:
        ValueError: If a limit is not valid; the message is one sentence.
    """

    def __init__(self, limits: Sequence[msg.Limit], variables: Sequence[msg.Variable]) -> None:
        known = {variable.name for variable in variables}
        for limit in limits:
            unknown = [item.name for item in limit.coefficients if item.name not in known]
            if unknown:
                raise ValueError(
                    f"limits.{limit.name} names {unknown[0][:80]!r}, but the machine's variables are "
                    f"{', '.join(sorted(known))}"
                )
            names = [item.name for item in limit.coefficients]
            if len({*names}) < len(names) or not all(
                math.isfinite(item.value) for item in limit.coefficients
            ):
                raise ValueError(
                    f"limits.{limit.name} has coefficients of {', '.join(names)}; one finite number for each is allowed"
                )
            if not limit.min <= limit.max:  # also where one of them is NaN
                raise ValueError(
                    f"limits.{limit.name} has min = {limit.min:g} and max = {limit.max:g}; min must not be above max"
                )
        self._limits = tuple(limits)

    def __bool__(self) -> bool:
        return bool(self._limits)

    def check(self, setpoint: Mapping[str, float]) -> None:
        """Check that a set-point keeps the limits.

        Raises:
            ValueError: If it does not; the message is one sentence.
        """
        for limit in self._limits:
            total, slack = _sum(limit, setpoint), _slack(limit, setpoint)
            if not limit.min - slack <= total <= limit.max + slack:
                raise ValueError(
                    f"limits.{limit.name} is {total:g} at the set-point; {limit.min:g} to {limit.max:g} is allowed"
                )

    def way(
        self, start: Mapping[str, float], target: Mapping[str, float]
    ) -> list[Mapping[str, float]]:
        """Return set-points that lead to a target, the last of which is the target itself.

        Where an end is outside a limit, no step on the way is farther outside than that end.

        Args:
            start: Where the machine is.
            target: Where it is to go.

        Raises:
            ValueError: If no such way is found, or it is unknown where the machine is.
        """
        for limit in self._limits:
            names = [item.name for item in limit.coefficients]
            unknown = [name for name in names if not math.isfinite(start.get(name, math.nan))]
            if unknown:
                raise ValueError(
                    f"it is not known where {unknown[0]} is, so that limits.{limit.name} cannot be kept on the way"
                )
        return self._way({**target, **start}, target, _HALVINGS)

    def _way(
        self, start: Mapping[str, float], target: Mapping[str, float], halvings: int
    ) -> list[Mapping[str, float]]:
        broken = self._broken(start, target)
        if not broken:
            return [target]
        inwards = {
            name: target[name]
            if all(_leads_inwards(end, name, start, target) for end in broken)
            else start[name]
            for name in target
        }
        if not self._broken(start, inwards) and not self._broken(inwards, target):
            return [inwards, target]
        if not halvings:
            raise ValueError(
                f"limits.{broken[0][0].name} cannot be kept on the way, as the variables move at different speeds"
            )
        middle = {name: 0.5 * (start[name] + target[name]) for name in target}
        return [
            *self._way(start, middle, halvings - 1),
            *self._way(middle, target, halvings - 1),
        ]

    def _broken(
        self, start: Mapping[str, float], target: Mapping[str, float]
    ) -> list[tuple[msg.Limit, float]]:
        """Return the limits that may be exceeded between two set-points, each with +1 for its upper end or -1."""
        found = []
        for limit in self._limits:
            ends = _sum(limit, start), _sum(limit, target)
            slack = max(_slack(limit, start), _slack(limit, target))
            terms = [
                (item.value * start[item.name], item.value * target[item.name])
                for item in limit.coefficients
            ]
            if math.fsum(map(max, terms)) > max(limit.max, *ends) + slack:
                found.append((limit, 1.0))
            if math.fsum(map(min, terms)) < min(limit.min, *ends) - slack:
                found.append((limit, -1.0))
        return found


def _leads_inwards(
    end: tuple[msg.Limit, float], name: str, start: Mapping[str, float], target: Mapping[str, float]
) -> bool:
    """Return whether a variable's move does not bring a sum nearer to an end of its limit."""
    limit, side = end
    coefficients = {item.name: item.value for item in limit.coefficients}
    return bool(side * coefficients.get(name, 0.0) * (target[name] - start[name]) <= 0.0)


def _sum(limit: msg.Limit, setpoint: Mapping[str, float]) -> float:
    return math.fsum(item.value * setpoint[item.name] for item in limit.coefficients)


def _slack(limit: msg.Limit, setpoint: Mapping[str, float]) -> float:
    ends = [abs(end) for end in (limit.min, limit.max) if math.isfinite(end)]
    terms = [abs(item.value * setpoint[item.name]) for item in limit.coefficients]
    return _ROUNDING * max(0.0, *terms, *ends)
