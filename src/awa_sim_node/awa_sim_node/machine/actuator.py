"""One actuator: a power supply or an rf phase shifter that takes its time to get where it is told.

Four things are kept apart, as on a real machine: the *target* it was told, the *position* it has, the
*readback*, which is the position as its own instrument shows it, and the *strength* that the beam
feels, which lags behind the position where there is hysteresis.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from awa_sim_node.machine.parameter import parameter

# Reaching a computed event time must not fail for the last bit of a float.
_ROUNDING = 1e-9


@dataclass(frozen=True)
class ActuatorParameters:
    """How an actuator moves.

    Attributes:
        slew_rate: Greatest speed of the reference [unit/s]; infinite for an instantaneous one.
        time_constant: Time constant of the lag of the position behind the reference [s].
        tolerance: Distance from the target within which the actuator counts as settled [unit].
        readback_noise: Standard deviation of one readback [unit].
        hysteresis: Width of the play between position and strength [unit].
    """

    slew_rate: float = parameter("greatest speed [unit/s]", 1e-3, 1e6)
    time_constant: float = parameter("time constant of the lag [s]", 0.0, 1e3)
    tolerance: float = parameter("distance from the target that counts as settled [unit]", 1e-6, 10)
    readback_noise: float = parameter("standard deviation of one readback [unit]", 0.0, 10)
    hysteresis: float = parameter(
        "what the beam feels lags behind by up to half of it [unit]", 0, 10
    )

    def __post_init__(self) -> None:
        """Check the values; ValueError if one of them makes no sense."""
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
        """Create an actuator at rest at ``position``."""
        self._parameters = parameters
        self._target = position
        self._reference = position
        self._position = position
        self._strength = position

    @property
    def parameters(self) -> ActuatorParameters:
        """How this actuator moves."""
        return self._parameters

    @property
    def target(self) -> float:
        """Where the actuator was told to go."""
        return self._target

    @property
    def position(self) -> float:
        """Where the actuator is."""
        return self._position

    @property
    def strength(self) -> float:
        """What the beam feels."""
        return self._strength

    @property
    def ramping(self) -> bool:
        """Whether the reference is still on its way to the target."""
        return self._reference != self._target

    @property
    def settled(self) -> bool:
        """Whether the actuator rests on its target."""
        return self._position == self._target and not self.ramping

    @property
    def time_to_ramped(self) -> float:
        """Time until the reference arrives at the target [s]; 0 if it is there."""
        return abs(self._target - self._reference) / self._parameters.slew_rate

    @property
    def time_to_settled(self) -> float:
        """Time until the actuator is settled [s]; 0 if it is."""
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
        """Stop where the actuator is; that becomes its target."""
        self._target = self._reference = self._position

    def step(self, dt: float) -> None:
        """Advance by ``dt`` >= 0 seconds."""
        if self.settled:
            return
        turn = self._time_to_turn()
        if 0.0 < turn < dt:
            # The turning point is the farthest that the position gets: the play must see it.
            self._advance(turn)
            dt -= turn
        self._advance(dt)

    def _advance(self, dt: float) -> None:
        """Advance by ``dt`` seconds in which the position does not turn round."""
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
        """Return the position as the actuator's own instrument shows it, noise included."""
        return self._position + self._parameters.readback_noise * float(rng.standard_normal())

    def _time_to_turn(self) -> float:
        """Return when the position turns round during the ramp [s]; infinite if it does not.

        It does where it still runs one way while the reference already goes the other: at the
        moment when the two meet.
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
        """Return what is left of ``lag`` after ``dt`` seconds with a reference at rest."""
        if self._parameters.time_constant == 0.0:
            return 0.0
        return lag * math.exp(-dt / self._parameters.time_constant)
