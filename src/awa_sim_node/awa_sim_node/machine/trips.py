"""Trips of the gun: a breakdown switches the field off, and it takes a while to bring it back."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from awa_sim_node.machine.parameter import CHOSEN, ParameterGroup, parameter

GREATEST_RATE: Final = 3600.0  # [1/h] however high the gradient
_HOUR: Final = 3600.0  # [s]


@dataclass(frozen=True)
class TripParameters(ParameterGroup):
    """How often the gun trips, and what an evaluation does then."""

    rate: float = parameter("trips per hour below the threshold", 0.0, GREATEST_RATE)
    threshold: float = parameter(
        "gun gradient above which trips become more frequent [MV/m]", 0.0, 1e3
    )
    steepness: float = parameter(
        "gun gradient that makes trips e times as frequent above the threshold [MV/m]", 0.01, 1e3
    )
    recovery_min: float = parameter("shortest time without beam after a trip [s]", 0.1, 1e5)
    recovery_max: float = parameter("longest time without beam after a trip [s]", 0.1, 1e5)
    patience: float = parameter(
        "how long an evaluation waits for the beam in all; 0 = a trip ends it with an error [s]",
        0.0,
        1e6,
        CHOSEN,
    )

    def __post_init__(self) -> None:
        """Check the values; ValueError if one is out of its range or the recovery has no time."""
        super().__post_init__()
        if self.recovery_min > self.recovery_max:
            raise ValueError(
                f"recovery_min = {self.recovery_min} must be at most recovery_max, "
                f"{self.recovery_max}"
            )

    def rate_at(self, gradient: float) -> float:
        """Return the trips per hour at a gun gradient [MV/m]."""
        # The exponent is cut where the greatest rate is reached from the least rate of interest.
        excess = min(max(0.0, gradient - self.threshold) / self.steepness, 50.0)
        return min(self.rate * math.exp(excess), GREATEST_RATE)


class Trips:
    """A Poisson process whose rate follows the gun gradient.

    It is simulated by thinning (Lewis and Shedler, Nav. Res. Logist. 26, 403 (1979)): candidates
    come at the greatest rate of all, and one at gradient G is a trip with the probability of G's
    rate over the greatest. That is exact however the gradient moves, and each candidate is an event
    whose time is known beforehand.
    """

    def __init__(
        self, parameters: TripParameters, greatest_gradient: float, rng: np.random.Generator
    ) -> None:
        """Start with the field on.

        Args:
            parameters: How often the gun trips.
            greatest_gradient: That the gun can ever have [MV/m].
            rng: Source of all chance.
        """
        self._parameters = parameters
        self._greatest = parameters.rate_at(greatest_gradient)
        self._rng = rng
        self._recovery = 0.0
        self._to_candidate = self._draw_interval()
        self.count = 0
        """Trips since the machine was switched on."""

    @property
    def tripped(self) -> bool:
        """Whether the field is off."""
        return self._recovery > 0.0

    @property
    def time_to_next_event(self) -> float:
        """Time until the field is back, or until it may trip [s]."""
        return self._recovery if self.tripped else self._to_candidate

    def step(self, dt: float, gradient: float) -> None:
        """Let ``dt`` seconds pass, at most ``time_to_next_event``.

        Args:
            dt: Time that passes [s].
            gradient: Of the gun at its end [MV/m].
        """
        if self.tripped:
            self._recovery = max(0.0, self._recovery - dt)
            return
        self._to_candidate -= dt
        if self._to_candidate > 0.0:
            return
        self._to_candidate = self._draw_interval()
        if self._rng.random() * self._greatest < self._parameters.rate_at(gradient):
            self.count += 1
            self._recovery = self._rng.uniform(
                self._parameters.recovery_min, self._parameters.recovery_max
            )

    def _draw_interval(self) -> float:
        if self._greatest == 0.0:
            return math.inf
        return float(self._rng.exponential(_HOUR / self._greatest))
