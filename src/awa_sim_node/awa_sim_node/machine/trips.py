"""Trips of the gun: a breakdown switches the field off, and it takes time to restore it."""

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
    """Parameters of the trips."""

    rate: float = parameter("trip rate below the threshold [1/h]", 0.0, GREATEST_RATE)
    threshold: float = parameter(
        "gun gradient above which trips become more frequent [MV/m]", 0.0, 1e3
    )
    steepness: float = parameter(
        "increase of the gun gradient above the threshold that multiplies the trip rate by e "
        "[MV/m]",
        0.01,
        1e3,
    )
    recovery_min: float = parameter("shortest time without beam after a trip [s]", 0.1, 1e5)
    recovery_max: float = parameter("longest time without beam after a trip [s]", 0.1, 1e5)
    patience: float = parameter(
        "total time that an evaluation waits for the beam; 0 = it fails at the first trip [s]",
        0.0,
        1e6,
        CHOSEN,
    )

    def __post_init__(self) -> None:
        """Check the values.

        Raises:
            ValueError: If a value is out of its range, or ``recovery_min`` exceeds
                ``recovery_max``.
        """
        super().__post_init__()
        if self.recovery_min > self.recovery_max:
            raise ValueError(
                f"recovery_min = {self.recovery_min} must be at most recovery_max, "
                f"{self.recovery_max}"
            )

    def rate_at(self, gradient: float) -> float:
        """Return the trip rate [1/h] at a gun gradient [MV/m]."""
        # The exponent is limited, so that it cannot overflow; the rate is limited below anyway.
        excess = min(max(0.0, gradient - self.threshold) / self.steepness, 50.0)
        return min(self.rate * math.exp(excess), GREATEST_RATE)


class Trips:
    """A Poisson process whose rate follows the gun gradient.

    It is simulated by thinning (Lewis and Shedler, Nav. Res. Logist. 26, 403 (1979)): candidates
    occur at the highest possible rate, and a candidate at gradient G is a trip with probability
    rate(G) / highest rate. That is exact for any motion of the gradient, and the time of each
    candidate is known in advance.
    """

    def __init__(
        self, parameters: TripParameters, greatest_gradient: float, rng: np.random.Generator
    ) -> None:
        """Start with the field on.

        Args:
            parameters: Parameters of the trips.
            greatest_gradient: Highest gradient that the gun can reach [MV/m].
            rng: Random number generator.
        """
        self._parameters = parameters
        self._greatest = parameters.rate_at(greatest_gradient)
        self._rng = rng
        self._recovery = 0.0
        self._to_candidate = self._draw_interval()
        self.count = 0
        """Number of trips since the machine was switched on."""

    @property
    def tripped(self) -> bool:
        """Whether the field is off."""
        return self._recovery > 0.0

    @property
    def time_to_next_event(self) -> float:
        """Time until the field is restored, or until the next candidate for a trip [s]."""
        return self._recovery if self.tripped else self._to_candidate

    def step(self, dt: float, gradient: float) -> None:
        """Advance by ``dt`` seconds, at most ``time_to_next_event``.

        Args:
            dt: Time step [s].
            gradient: Gradient of the gun at the end of the step [MV/m].
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
