"""The simulated machine as a backend of `MachineServer`: maps the passing time to simulated time."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterable, Mapping, Sequence

from rclpy.node import Node

from awa_sim_node.health import actuators_health, beam_health
from awa_sim_node.machine import (
    MAX_SHOTS,
    Cause,
    EvaluationResult,
    InterlockError,
    ModelDescription,
    Shot,
    SimulatedMachine,
)
from awa_sim_node.machine.diagnostics import Reading
from mobo_msgs_py import msg
from mobo_msgs_py.action import EvaluateSetpoint
from mobo_tuner.machine.backend import (
    MEASURING,
    RAMPING,
    SETTLING,
    Failure,
    MachineBackend,
    Measurement,
    Operation,
)
from mobo_tuner.ros.conversions import named_values
from mobo_tuner.ros.diagnostics import Health
from mobo_tuner.ros.waiting import first_of

STEP_PERIOD = 0.1  # [s] of wall time, at most
SHORTEST_PAUSE = 0.001  # [s] of wall time
STEP_BUDGET = 0.05  # [s] of wall time for one call of `advance`; time beyond it is dropped
_Result = EvaluateSetpoint.Result
_CODES = {Cause.INTERLOCK: _Result.INTERLOCK}


class SimulatedBackend(MachineBackend):
    """A backend that runs a simulated machine `speed` times as fast as the clock `now`.

    Args:
        node: Node whose executor runs the coroutines.
        description: Description of the machine, valid whether or not it is connected.
        speed: Simulated seconds per second of `now`.
        now: Callable that returns the current time [s].
        trouble: Callable that returns why that time stands still; empty if it does not.
    """

    def __init__(
        self,
        node: Node,
        description: ModelDescription,
        speed: float,
        now: Callable[[], float] = time.monotonic,
        trouble: Callable[[], str] = str,
    ) -> None:
        self._node = node
        self._speed = speed
        self._now = now
        self._trouble = trouble
        self._last = now()
        self.name = description.title
        self.max_shots = MAX_SHOTS
        self.variables = [
            msg.Variable(name=v.name, unit=v.unit, min=v.minimum, max=v.maximum)
            for v in description.variables
        ]
        self.diagnostics = [
            msg.Observable(name=d.name, unit=d.unit) for d in description.diagnostics
        ]
        self._units = {v.name: v.unit for v in description.variables}
        self.machine: SimulatedMachine | None = None
        """The connected machine, or None."""
        self.simulated_time = 0.0
        """Simulated time since the node was started, summed over all connected machines [s]."""
        self.on_shot: Callable[[Shot], None] = lambda _: None
        self.on_step: Callable[[], None] = lambda: None
        self.on_measured: Callable[[EvaluationResult], None] = lambda _: None

    def connect(self, machine: SimulatedMachine) -> None:
        """Connect a machine."""
        self.machine = machine
        self._last = self._now()

    def disconnect(self) -> None:
        """Disconnect the machine."""
        self.machine = None

    def refusal(self) -> Failure | None:
        """Return why an action may not move the machine now, or None."""
        self.advance()  # a device may have arrived in the meantime
        refusal = self.direct_refusal()
        if refusal is None and self.machine is not None and self.machine.busy:
            return Failure(_Result.BUSY, "a device is moving to a set-point from its topic")
        return refusal

    def direct_refusal(self) -> Failure | None:
        """Return why a single device may not be moved now, or None."""
        if self.inactive or self.machine is None:
            return Failure(_Result.NOT_ACTIVE, f"{self.inactive}; nothing may move")
        if self.machine.interlock:
            return Failure(_Result.INTERLOCK, self.machine.interlock)
        return None

    def readbacks(self) -> Sequence[msg.NamedValue]:
        """Return the current readbacks; NaN while no machine is connected."""
        values = (
            dict.fromkeys(self._units, math.nan)
            if self.machine is None
            else self.machine.readbacks()
        )
        return named_values(values, self._units)

    def hold(self) -> None:
        """Stop the machine where it is and end a running measurement."""
        if self.machine is not None:
            self.machine.stop()

    def parts(self) -> Mapping[str, Callable[[], Health]]:
        """Return functions for the health of the beam and the actuators."""
        return {
            "beam": lambda: beam_health(self.machine),
            "actuators": lambda: actuators_health(
                self.machine, self.simulated_time, self._trouble()
            ),
        }

    def advance(self) -> None:
        """Advance the simulated machine by the time that has passed since the last call."""
        now = self._now()
        due, self._last = max(0.0, now - self._last) * self._speed, now
        deadline = time.perf_counter() + STEP_BUDGET
        while self.machine is not None and due > 0.0 and time.perf_counter() < deadline:
            part = min(due, max(self.machine.time_to_next_event, SHORTEST_PAUSE))
            self.machine.step(part)
            self.simulated_time += part
            due -= part
        self.on_step()

    async def move(self, setpoint: Mapping[str, float], operation: Operation) -> Failure | None:
        """Ramp to a set-point and settle there."""
        machine = self.machine
        assert machine is not None
        self.advance()  # the time until now is not part of the move
        machine.move(setpoint)
        ramp, settle = machine.time_to_ramped, machine.time_to_settled

        def report() -> float:
            ramping, remaining = machine.time_to_ramped, machine.time_to_settled
            if ramping > 0.0:
                operation.progress(RAMPING, 1.0 - ramping / ramp)
            elif remaining > 0.0:
                operation.progress(SETTLING, 1.0 - remaining / (settle - ramp))
            return remaining

        await self._drive(report, operation)
        return Failure(_Result.INTERLOCK, machine.interlock) if machine.interlock else None

    async def measure(self, shots: int, operation: Operation) -> Measurement:
        """Measure at the current position.

        Args:
            shots: Number of shots to average; 0 for the machine's default.
            operation: Operation that receives progress and shots and can interrupt.

        Returns:
            The measurement; its `failure` is set if the shots do not form a valid one.
        """
        machine = self.machine
        assert machine is not None

        def take(shot: Shot) -> None:
            self.on_shot(shot)
            operation.shot(shot.measured)

        try:
            evaluation = machine.measure(shots or None, take)
        except InterlockError as error:
            return Measurement(failure=Failure(_Result.INTERLOCK, str(error)))

        def report() -> float:
            operation.progress(MEASURING, evaluation.taken / evaluation.shots)
            if evaluation.phase.finished:
                return 0.0
            return max(evaluation.remaining, SHORTEST_PAUSE)

        await self._drive(report, operation)
        machine.stop()
        result = evaluation.result
        assert result is not None
        self.on_measured(result)
        return Measurement(
            readbacks=_messages(result.readbacks),
            diagnostics=_messages(d for d in result.diagnostics if not math.isnan(d.value)),
            shots=result.shots,
            failure=_failure(result),
        )

    async def _drive(self, report: Callable[[], float], operation: Operation) -> None:
        """Advance until done or interrupted.

        Args:
            report: Callable that reports progress and returns the simulated time left [s]; 0 ends.
            operation: Operation that can interrupt.
        """
        while (remaining := report()) > 0.0 and not operation.interrupt.done():
            pause = min(max(remaining / self._speed, SHORTEST_PAUSE), STEP_PERIOD)
            if await first_of(self._node, operation.interrupt, timeout=pause) is not None:
                return
            self.advance()


def _messages(readings: Iterable[Reading]) -> list[msg.NamedValue]:
    return [
        msg.NamedValue(name=r.name, value=r.value, stddev=r.stddev, unit=r.unit) for r in readings
    ]


def _failure(result: EvaluationResult) -> Failure | None:
    if result.failure is None:
        return None
    code = _CODES.get(result.failure.cause, _Result.INVALID_MEASUREMENT)
    return Failure(code, result.failure.message)
