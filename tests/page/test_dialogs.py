"""What a question before a move says."""

from __future__ import annotations

import math
from typing import Any

import pytest

from mobo_tuner.core.problem import Variable
from mobo_tuner.page.dialogs import travel, whole


@pytest.mark.parametrize(
    ("bounds", "here", "new", "text"),
    [
        ((400.0, 500.0), 431.0, 447.0, "16% of its range"),
        ((400.0, 500.0), 390.0, 500.0, "110% of its range"),
        ((400.0, 500.0), math.nan, 447.0, "from an unknown place"),
        ((20.0, 20.0), 20.0, 20.0, "stays"),
        ((20.0, 20.0), 21.0, 20.0, "it is fixed"),
    ],
)
def test_the_travel_is_a_share_of_the_range(
    bounds: tuple[float, float], here: float, new: float, text: str
) -> None:
    assert travel(Variable("K1", *bounds), here, new) == text


@pytest.mark.parametrize(
    ("value", "least", "count"),
    [
        (3.0, 1, 3),
        (None, 0, 0),
        (None, 1, None),
        (0, 1, None),
        (-2, 0, None),
        (2.5, 0, None),
        (math.inf, 0, None),
        (math.nan, 0, None),
    ],
)
def test_a_field_holds_an_integer_or_is_refused(value: Any, least: int, count: int | None) -> None:
    assert whole(value, least) == count
