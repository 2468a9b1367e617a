"""Units of products, powers of ten and decades, for people."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable

import numpy as np
from numpy.typing import ArrayLike

_SUPERSCRIPTS = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


_DECADES = 100.0  # ratio of the largest to the smallest values, a tenth at either end left out
_FEWEST = 5  # values that say so


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


def spans_decades(values: ArrayLike) -> bool:
    """Return whether values, all of them positive, are told apart on a logarithmic axis alone."""
    known = np.asarray(values, dtype=float).ravel()
    known = known[np.isfinite(known)]
    if len(known) < _FEWEST or known.min() <= 0.0:
        return False
    low, high = np.percentile(known, [10.0, 90.0])
    return bool(high > _DECADES * low)
