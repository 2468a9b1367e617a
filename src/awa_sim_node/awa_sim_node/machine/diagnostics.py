"""Instruments: the noise of one shot, and the readings averaged over several shots."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class ShotNoise:
    """Noise of one shot of one diagnostic.

    Attributes:
        fraction: Standard deviation as a fraction of the true value.
        floor: Lowest standard deviation, in the diagnostic's unit.
    """

    fraction: float = 0.0
    floor: float = 0.0

    def __post_init__(self) -> None:
        """Check the values.

        Raises:
            ValueError: If a value is negative or not finite.
        """
        for name, value in (("fraction", self.fraction), ("floor", self.floor)):
            if not (value >= 0.0 and math.isfinite(value)):
                raise ValueError(f"{name} = {value} must be finite and at least 0")

    def stddev(self, value: float) -> float:
        """Return the standard deviation of a shot whose true value is ``value``."""
        return max(self.fraction * abs(value), self.floor)

    def shot(self, value: float, rng: np.random.Generator) -> float:
        """Return the true value ``value`` with the noise of one shot."""
        return value + self.stddev(value) * float(rng.standard_normal())


@dataclass(frozen=True)
class Reading:
    """One measured value.

    Attributes:
        name: Name of the variable or diagnostic.
        value: Mean over the shots, in ``unit``; NaN if nothing was measured.
        stddev: Standard uncertainty of ``value`` (not of one shot), in ``unit``; NaN if unknown.
        unit: Unit of the value; empty if it has none.
    """

    name: str
    value: float
    stddev: float
    unit: str
