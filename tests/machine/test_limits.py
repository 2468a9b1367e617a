"""Ways between set-points that keep limits on sums, however fast each variable moves."""

from __future__ import annotations

import itertools
import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mobo_msgs_py import msg
from mobo_tuner.machine.limits import SumLimits

NAMES = ("a", "b", "c")
VARIABLES = [msg.Variable(name=name, min=-10.0, max=10.0) for name in NAMES]
values = st.lists(st.floats(-1.0, 1.0), min_size=3, max_size=3)


def terms(coefficients: dict[str, float]) -> list[msg.NamedValue]:
    """Make the coefficients of a limit."""
    return [msg.NamedValue(name=name, value=value) for name, value in coefficients.items()]


def limit(coefficients: list[float], low: float, high: float) -> msg.Limit:
    """Make a limit on a sum of the variables."""
    return msg.Limit(
        name="sum",
        coefficients=terms(dict(zip(NAMES, coefficients, strict=False))),
        min=low,
        max=high,
    )


@settings(max_examples=150, deadline=None)
@given(values, values, st.lists(values, min_size=1, max_size=2), st.floats(0.0, 0.5))
def test_no_speeds_lead_across_a_limit(
    start: list[float], target: list[float], sums: list[list[float]], room: float
) -> None:
    limits = []
    for coefficients in sums:
        ends = [
            math.fsum(c * x for c, x in zip(coefficients, at, strict=True))
            for at in (start, target)
        ]
        limits.append(limit(coefficients, min(ends) - room - 0.05, max(ends) + room))
    checked = SumLimits(limits, VARIABLES)
    here, there = (dict(zip(NAMES, at, strict=True)) for at in (start, target))
    try:
        way = checked.way(here, there)
    except ValueError as error:
        if len(sums) == 2 and "different speeds" in str(error):
            return  # two limits may leave no way
        raise
    assert way[-1] == there
    for one, other in itertools.pairwise([here, *way]):
        for corner in itertools.product(*zip(one.values(), other.values(), strict=True)):
            checked.check(dict(zip(NAMES, corner, strict=True)))


def test_a_way_within_the_limits_is_one_move() -> None:
    limits = SumLimits([limit([1.0, 1.0], -5.0, 5.0)], VARIABLES)
    target = dict.fromkeys(NAMES, 1.0)
    assert limits.way(dict.fromkeys(NAMES, 0.0), target) == [target]
    assert SumLimits([], VARIABLES).way({}, target) == [target]


def test_along_a_limit_what_leads_away_from_it_moves_first() -> None:
    limits = SumLimits([limit([1.0, 1.0], -math.inf, 1.0)], VARIABLES)
    here, there = {"a": 1.0, "b": 0.0, "c": 0.0}, {"a": 0.0, "b": 1.0, "c": 0.0}
    assert limits.way(here, there) == [{"a": 0.0, "b": 0.0, "c": 0.0}, there]


def test_a_machine_outside_a_limit_comes_back_without_going_farther() -> None:
    limits = SumLimits([limit([1.0, 1.0], -math.inf, 1.0)], VARIABLES)
    here, there = {"a": 3.0, "b": 0.0, "c": 0.0}, {"a": 0.0, "b": 1.0, "c": 0.0}
    for one, other in itertools.pairwise([here, *limits.way(here, there)]):
        assert max(one["a"], other["a"]) + max(one["b"], other["b"]) <= 3.0


@pytest.mark.parametrize(
    ("wrong", "reason"),
    [
        (msg.Limit(name="s", coefficients=terms({"d": 1.0}), max=1.0), "names 'd'"),
        (msg.Limit(name="s", coefficients=2 * terms({"a": 1.0})), "one finite number for each"),
        (msg.Limit(name="s", coefficients=terms({"a": math.nan})), "one finite number for each"),
        (msg.Limit(name="s", coefficients=terms({"a": 1.0}), min=2.0), "min must not be above"),
    ],
)
def test_a_limit_that_is_not_one_is_refused(wrong: msg.Limit, reason: str) -> None:
    with pytest.raises(ValueError, match=reason):
        SumLimits([wrong], VARIABLES)


def test_a_set_point_beyond_a_limit_or_an_unknown_place_is_refused() -> None:
    limits = SumLimits([limit([1.0, 1.0], 0.0, 1.0)], VARIABLES)
    with pytest.raises(ValueError, match=r"limits\.sum is 2 at the set-point; 0 to 1 is allowed"):
        limits.check(dict.fromkeys(NAMES, 1.0))
    with pytest.raises(ValueError, match="not known where b is"):
        limits.way({"a": 0.0, "b": math.nan, "c": 0.0}, dict.fromkeys(NAMES, 0.5))
