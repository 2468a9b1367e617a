"""The points of the data set: row i is always the same, whoever computes it and when."""

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
"""Rows of the data set."""

CORNER: Final = {"K2": (250.0, 285.0), "G1": (59.25, 66.0)}
"""The hard corner: a strong lens on a slow beam, which is focused over."""

_DIGITS: Final = 6  # significant digits of the settings, so that a table holds them exactly
_LARGEST: Final = 2**13
_SPACE, _IN_TEN = 7, 10  # of ten rows, seven fill the space
_COUNT: Final = _IN_TEN * (_LARGEST // _SPACE) + _LARGEST % _SPACE


@dataclass(frozen=True)
class Sample:
    """One point.

    Attributes:
        number: Its number in the series.
        region: ``space`` for the whole box, ``corner`` for the hard corner.
        settings: Where the machine stands.
    """

    number: int
    region: str
    settings: Settings


def sample(number: int) -> Sample:
    """Return a point: 70 % fill the whole box, 30 % the hard corner, each a Sobol sequence.

    Raises:
        ValueError: If there is no such point.
    """
    if not 0 <= number < _COUNT:
        raise ValueError(f"there is no sample {number}, only those from 0 to {_COUNT - 1}")
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
