"""Units and powers as text."""

from __future__ import annotations

import pytest

from mobo_tuner.core.units import product_of_units, raised, spans_decades


@pytest.mark.parametrize(
    ("units", "product"),
    [
        (["mm", "mm", "mm mrad", "mm mrad", "MeV"], "mm² (mm mrad)² MeV"),
        (["", "nC", ""], "nC"),
        (["", ""], ""),
        (["mm mrad", "MV/m"], "mm mrad MV/m"),
    ],
)
def test_the_unit_of_a_product(units: list[str], product: str) -> None:
    assert product_of_units(units) == product


def test_powers_are_raised() -> None:
    assert raised(-12) == "⁻¹²"


@pytest.mark.parametrize(
    ("values", "answer"),
    [
        ([1.0, 10.0, 100.0, 1e3, 1e4, float("nan")], True),
        ([-1.0, 10.0, 100.0, 1e3, 1e4], False),
        ([1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0, 9.0, 10.0, 11.0, 1e4], False),
        ([1.0, 1e4], False),
        ([], False),
    ],
)
def test_values_that_span_decades(values: list[float], answer: bool) -> None:
    assert spans_decades(values) == answer
