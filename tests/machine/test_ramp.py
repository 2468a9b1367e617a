"""Ramps: small enough steps, straight, and exactly at the target in the end."""

from __future__ import annotations

import itertools
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mobo_tuner.machine.ramp import count_steps, interpolate

VALUES = st.floats(-1e3, 1e3)


def test_variables_arrive_together() -> None:
    start, target = {"a": 0.0, "b": 10.0}, {"a": 1.0, "b": 0.0}
    steps = count_steps(start, target, {"a": 1.0, "b": 2.5})
    assert steps == 4
    assert list(interpolate(start, target, steps)) == [
        {"a": 0.25, "b": 7.5},
        {"a": 0.5, "b": 5.0},
        {"a": 0.75, "b": 2.5},
        {"a": 1.0, "b": 0.0},
    ]


def test_a_move_to_where_it_is_takes_one_step() -> None:
    assert count_steps({"a": 0.1}, {"a": 0.1}, {"a": 1.0}) == 1
    assert list(interpolate({"a": 0.1}, {"a": 0.1}, 1)) == [{"a": 0.1}]


@pytest.mark.parametrize("steps", [1, 3, 10, 49])
def test_a_whole_number_of_largest_steps_is_not_split(steps: int) -> None:
    assert count_steps({"a": 0.0}, {"a": 0.1 * steps}, {"a": 0.1}) == steps


@given(VALUES, VALUES, VALUES, VALUES, st.floats(0.5, 100.0), st.floats(0.5, 100.0))
def test_no_step_is_too_large(a: float, b: float, c: float, d: float, p: float, q: float) -> None:
    start, target, largest = {"x": a, "y": b}, {"x": c, "y": d}, {"x": p, "y": q}
    steps = count_steps(start, target, largest)
    points = [start, *interpolate(start, target, steps)]
    assert points[-1] == target
    for before, after in itertools.pairwise(points):
        for name, limit in largest.items():
            step = after[name] - before[name]
            assert abs(step) <= limit * (1.0 + 1e-6) + 1e-9
            assert step * (target[name] - start[name]) >= -1e-6
    assert steps == 1 or math.isclose(
        max(abs(target[n] - start[n]) / largest[n] for n in largest), steps, abs_tol=1.0
    )


def test_a_selector_changes_in_the_last_step() -> None:
    points = interpolate({"a": 0.0, "b": 0.0}, {"a": 1.0, "b": 2.0}, 4, {"b"})
    assert [point["b"] for point in points] == [0.0, 0.0, 0.0, 2.0]
