"""Units of products and powers of ten, for people."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable

_SUPERSCRIPTS = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


def raised(exponent: int) -> str:
    """Return an exponent in superscript."""
    return str(exponent).translate(_SUPERSCRIPTS)


def product_of_units(units: Iterable[str]) -> str:
    """Return the unit of a product, as in ``mm³ (mm mrad)² MeV``."""
    parts = []
    for unit, power in Counter(unit for unit in units if unit).items():
        base = f"({unit})" if power > 1 and not unit.isalpha() else unit
        parts.append(base + (raised(power) if power > 1 else ""))
    return " ".join(parts)
