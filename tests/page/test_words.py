"""Numbers of set-points and limits, in words."""

from __future__ import annotations

import math

import pytest

from mobo_tuner.core.problem import Constraint, Variable
from mobo_tuner.page.board import Motion
from mobo_tuner.page.dialogs import proposed
from mobo_tuner.page.words import evaluations, limits, place


@pytest.mark.parametrize(
    ("value", "span", "text"),
    [
        (280.0, 100.0, "280.00 A"),
        (-0.0032954, 10.0, "−0.003 A"),
        (-1e-9, 10.0, "0.000 A"),
        (431.234, 150.0, "431.23 A"),
        (5.0, 2e6, "5 A"),
        (1.5e-7, 1e-6, "1.5×10⁻⁷ A"),
        (3e8, 100.0, "3×10⁸ A"),
        (20.25, 0.0, "20.25 A"),
        (math.nan, 10.0, "– A"),
    ],
)
def test_a_set_point_is_as_fine_as_its_range_says(value: float, span: float, text: str) -> None:
    assert place(value, span, "A") == text


def test_limits_have_their_unit() -> None:
    assert limits(Constraint("g", -math.inf, 0.5, "mm")) == "at most 0.5 mm"
    assert limits(Constraint("g", 0.98, math.inf)) == "at least 0.98"
    assert limits(Constraint("g", -1.0, 1.0, "mm")) == "−1 to 1 mm"


def test_one_evaluation_is_singular_and_no_way_is_negative() -> None:
    assert [evaluations(count) for count in (0, 1, 2)] == [
        "0 evaluations",
        "1 evaluation",
        "2 evaluations",
    ]
    motion = Motion(start={"x": 1.0}, target={"x": 0.5}, readbacks={"x": 1.0})
    assert f"{motion.fraction('x'):.0%}" == "0%"


def test_a_readback_outside_of_the_bounds_is_not_proposed() -> None:
    variable = Variable("phi", -10.0, 0.0)
    assert proposed(variable, -10.0006) == -10.0
    assert proposed(variable, -3.25) == -3.25
    assert proposed(variable, math.nan) is proposed(variable, None) is None
