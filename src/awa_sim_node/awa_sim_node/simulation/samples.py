"""The points of the data set: a fixed series, in which point i is always the same."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.stats import qmc

from awa_sim_node.simulation.injector import Settings
from awa_sim_node.surrogate.metadata import INPUTS

ROWS: Final = 2500
"""Number of rows of the data set."""

CORNER: Final = {"K2": (250.0, 285.0), "G1": (59.25, 66.0)}
"""The hard corner: a strong lens on a slow beam, which is over-focused."""

_DIGITS: Final = 6  # significant digits of the settings, so that a table holds them exactly
_LARGEST: Final = 2**13
_SPACE, _IN_TEN = 7, 10  # seven of ten rows fill the whole box
_COUNT: Final = _IN_TEN * (_LARGEST // _SPACE) + _LARGEST % _SPACE


@dataclass(frozen=True)
class Sample:
    """One point of the data set.

    Attributes:
        number: Number in the series.
        region: Purpose of the point: ``space`` for the whole box, ``corner`` for the hard corner.
        settings: Settings of the machine.
    """

    number: int
    region: str
    settings: Settings


def sample(number: int) -> Sample:
    """Return a point of the series.

    70 % of the points fill the whole box and 30 % the hard corner, each by a Sobol sequence.

    Args:
        number: Number in the series.

    Raises:
        ValueError: If there is no such point.
    """
    if not 0 <= number < _COUNT:
        raise ValueError(f"sample = {number} must be from 0 to {_COUNT - 1}")
    tens, rest = divmod(number, _IN_TEN)
    if rest < _SPACE:
        region, index = "space", _SPACE * tens + rest
    else:
        region, index = "corner", (_IN_TEN - _SPACE) * tens + rest - _SPACE
    low, high = np.array([quantity.training_range for quantity in INPUTS]).T
    if region == "corner":
        for j, quantity in enumerate(INPUTS):
            low[j], high[j] = CORNER.get(quantity.name, (low[j], high[j]))
    point = low + _sequence(region)[index] * (high - low)
    rounded = [float(f"{value:.{_DIGITS}g}") for value in point]
    return Sample(number, region, Settings(*rounded))


@cache
def _sequence(region: str) -> NDArray[np.float64]:
    engine = qmc.Sobol(len(INPUTS), seed={"space": 11, "corner": 12}[region])
    points: NDArray[np.float64] = engine.random(_LARGEST)
    return points
