"""A short version of the campaign over formulas."""

from __future__ import annotations

from robustness.fuzz_formulas import search


def test_no_formula_executes_anything_or_takes_long() -> None:
    report = search(1500, seed=7)
    assert report.wrong == []
    assert set(report.counts) == {"evaluated", "not measured", "refused"}
