"""Units and powers as text."""

from __future__ import annotations

import pytest

from mobo_tuner.core.units import product_of_units, raised


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
