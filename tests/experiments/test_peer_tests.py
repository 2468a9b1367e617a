"""The problems as peers' tests have them are solved, and are what they say."""

from __future__ import annotations

import pytest

from experiments.peer_tests import CASES, begin, ours


def test_the_ranges_of_the_formula_are_around_where_the_machine_is() -> None:
    problem = CASES["formula"]().problem
    bounds = [(v.minimum, v.maximum) for v in problem.variables]
    assert bounds == [(-1.0, 1.0), (2.0, 4.0), (0.5, 1.5)]
    assert begin(CASES["formula"](), 3) == begin(CASES["formula"](), 3)


@pytest.mark.parametrize("name", ["limits", "discrete"])
def test_the_target_is_reached(name: str) -> None:
    assert ours(CASES[name](), 0, 40) < 40
