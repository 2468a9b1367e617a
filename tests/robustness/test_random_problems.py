"""A short version of the campaign over random problems."""

from __future__ import annotations

from robustness.random_problems import search


def test_no_suggestion_leaves_bounds_grids_or_limits() -> None:
    search(12)
