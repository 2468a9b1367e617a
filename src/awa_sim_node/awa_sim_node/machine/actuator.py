"""One actuator: a power supply or an rf phase shifter that needs time to reach its set-point.

As on a real machine, four quantities differ: the *target* is the set-point, the *position* is the
actual value, the *readback* is the position with the noise of its instrument, and the *strength* is
the value that the beam feels, which lags behind the position if there is hysteresis.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from awa_sim_node.machine.parameter import parameter

# Relative tolerance for rounding when a computed event time is reached.
_ROUNDING = 1e-9


@dataclass(frozen=True)
class ActuatorParameters:
    """Parameters of an actuator's motion.

    Attributes:
        slew_rate: Highest speed of the reference [unit/s]; infinite for an instantaneous actuator.
        time_constant: Time constant of the lag of the position behind the reference [s].
        tolerance: Distance from the target within which the actuator counts as settled [unit].
        readback_noise: Standard deviation of one readback [unit].
        hysteresis: Width of the play between position and strength [unit].
    """

    slew_rate: float = parameter("highest speed [unit/s]", 1e-3, 1e6)
    time_constant: float = parameter("time constant of the lag [s]", 0.0, 1e3)
    tolerance: float = parameter("distance from the target that counts as settled [unit]", 1e-6, 10)
    readback_noise: float = parameter("standard deviation of one readback [unit]", 0.0, 10)
    hysteresis: float = parameter(
        "width of the hysteresis; the field that the beam feels lags by up to half of it [unit]",
        0,
        10,
    )

    def __post_init__(self) -> None:
        """Check the values.

        Raises:
            ValueError: If a value is negative or not finite where that is not allowed.
        """
        if not self.slew_rate > 0.0:
            raise ValueError(f"slew_rate = {self.slew_rate} must be greater than 0")
        if not (self.time_constant >= 0.0 and math.isfinite(self.time_constant)):
            raise ValueError(f"time_constant = {self.time_constant} must be finite and at least 0")
        if not self.tolerance > 0.0:
            raise ValueError(f"tolerance = {self.tolerance} must be greater than 0")
        if not self.readback_noise >= 0.0:
            raise ValueError(f"readback_noise = {self.readback_noise} must be at least 0")
        if not (self.hysteresis >= 0.0 and math.isfinite(self.hysteresis)):
            raise ValueError(f"hysteresis = {self.hysteresis} must be finite and at least 0")


INSTANTANEOUS = ActuatorParameters(
    slew_rate=math.inf, time_constant=0.0, tolerance=1e-12, readback_noise=0.0, hysteresis=0.0
)


class Actuator:
    """An actuator with limited speed, lag and readback noise.

    The reference r runs to the target at the slew rate v; the position p follows with a first-order
    lag, dp/dt = (r - p) / tau. Both are advanced by their exact solution, so that the motion does
    not depend on the length of the steps. Once the reference has arrived and the position is within
    the tolerance, the actuator is settled and its control loop holds it on the target.

    Hysteresis is a play operator (M. Brokate and J. Sprekels, Hysteresis and Phase Transitions,
    sec. 2.1): the position drags the strength along at a distance of half the play's width.
    """

    def __init__(self, parameters: ActuatorParameters, position: float) -> None:
        """Create an actuator at rest.

        Args:
            parameters: Parameters of its motion.
            position: Initial position and target [unit].
        """
        self._parameters = parameters
        self._target = position
        self._reference = position
        self._position = position
        self._strength = position

    @property
    def parameters(self) -> ActuatorParameters:
        """Parameters of the actuator's motion."""
        return self._parameters

    @property
    def target(self) -> float:
        """Set-point of the actuator [unit]."""
        return self._target

    @property
    def position(self) -> float:
        """Position of the actuator [unit]."""
        return self._position

    @property
    def strength(self) -> float:
        """Value that the beam feels [unit]."""
        return self._strength

    @property
    def ramping(self) -> bool:
        """Whether the reference is still moving to the target."""
        return self._reference != self._target

    @property
    def settled(self) -> bool:
        """Whether the actuator rests on its target."""
        return self._position == self._target and not self.ramping

    @property
    def time_to_ramped(self) -> float:
        """Time until the reference reaches the target [s]; 0 if it has."""
        return abs(self._target - self._reference) / self._parameters.slew_rate

    @property
    def time_to_settled(self) -> float:
        """Time until the actuator is settled [s]; 0 if it already is."""
        if self.settled:
            return 0.0
        ramp = self.time_to_ramped
        lag = abs(self._lag_after(ramp))
        if lag <= self._parameters.tolerance:
            return ramp
        return ramp + self._parameters.time_constant * math.log(lag / self._parameters.tolerance)

    def set(self, target: float) -> None:
        """Start moving to ``target``."""
        self._target = target
        self.step(0.0)

    def hold(self) -> None:
        """Stop the actuator; its position becomes its target."""
        self._target = self._reference = self._position

    def step(self, dt: float) -> None:
        """Advance by ``dt`` >= 0 seconds."""
        if self.settled:
            return
        turn = self._time_to_turn()
        if 0.0 < turn < dt:
            # The position is extreme at the turning point, so the hysteresis must be updated there.
            self._advance(turn)
            dt -= turn
        self._advance(dt)

    def _advance(self, dt: float) -> None:
        """Advance by ``dt`` seconds during which the position does not reverse."""
        self._follow(dt)
        play = 0.5 * self._parameters.hysteresis
        self._strength = min(max(self._strength, self._position - play), self._position + play)

    def _follow(self, dt: float) -> None:
        """Advance reference and position."""
        ramp = self.time_to_ramped
        if dt < ramp * (1.0 - _ROUNDING):
            lag = self._lag_after(dt)
            self._reference += self._velocity * dt
            self._position = self._reference - lag
            return
        lag = self._decayed(self._lag_after(ramp), max(0.0, dt - ramp))
        self._reference = self._target
        within = abs(lag) <= self._parameters.tolerance * (1.0 + _ROUNDING)
        self._position = self._target if within else self._target - lag

    def readback(self, rng: np.random.Generator) -> float:
        """Return the position with the noise of the actuator's instrument [unit]."""
        return self._position + self._parameters.readback_noise * float(rng.standard_normal())

    def _time_to_turn(self) -> float:
        """Return the time until the position reverses during the ramp [s]; infinite if it does not.

        It reverses if it still moves in one direction while the reference already moves in the
        other: at the moment when the two meet.
        """
        if not self.ramping or self._parameters.time_constant == 0.0:
            return math.inf
        final = self._velocity * self._parameters.time_constant
        lag = self._reference - self._position
        if lag * final >= 0.0:
            return math.inf
        turn = self._parameters.time_constant * math.log1p(-lag / final)
        return turn if turn < self.time_to_ramped else math.inf

    @property
    def _velocity(self) -> float:
        """Signed speed of the reference [unit/s]."""
        return math.copysign(self._parameters.slew_rate, self._target - self._reference)

    def _lag_after(self, dt: float) -> float:
        """Return v tau + (lag - v tau) exp(-dt / tau), the lag r - p after ``dt`` of ramping."""
        if self._parameters.time_constant == 0.0:
            return 0.0
        if dt == 0.0:
            return self._reference - self._position
        final = self._velocity * self._parameters.time_constant
        return final + self._decayed(self._reference - self._position - final, dt)

    def _decayed(self, lag: float, dt: float) -> float:
        """Return the rest of ``lag`` after ``dt`` seconds with the reference at rest."""
        if self._parameters.time_constant == 0.0:
            return 0.0
        return lag * math.exp(-dt / self._parameters.time_constant)
