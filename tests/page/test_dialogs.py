"""What a question before a move says."""

from __future__ import annotations

import math

import pytest

from mobo_tuner.core.problem import Variable
from mobo_tuner.page.dialogs import travel


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
