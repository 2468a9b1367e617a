"""The simulated machine as `MachineServer` drives it: wall time becomes simulated time."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence

from rclpy.node import Node

from awa_sim_node.machine import MAX_SHOTS, SimulatedMachine
from awa_sim_node.machine.diagnostics import Reading
from mobo_msgs_py import msg
from mobo_tuner.ros.conversions import named_values
from mobo_tuner.ros.machine_backend import (
    MEASURING,
    RAMPING,
    SETTLING,
    Failure,
    Measurement,
    Operation,
)
from mobo_tuner.ros.waiting import first_of

STEP_PERIOD = 0.1  # [s] of wall time, at most


class SimulatedBackend:
    """Lets simulated time pass, `speed` times as fast as wall time, while something is to be done.

    Args:
        node: on whose executor the coroutines run.
        machine: what is simulated.
        speed: simulated seconds per second of wall time.
    """

    def __init__(self, node: Node, machine: SimulatedMachine, speed: float) -> None:
        self._node = node
        self._machine = machine
        self._speed = speed
        description = machine.description
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

    def refusal(self) -> Failure | None:
        """Nothing keeps this machine from moving."""
        return None

    def readbacks(self) -> Sequence[msg.NamedValue]:
        """Where the machine is now."""
        return named_values(self._machine.readbacks(), self._units)

    def hold(self) -> None:
        """Stop where the machine is; a running measurement ends."""
        self._machine.stop()

    async def move(self, setpoint: Mapping[str, float], operation: Operation) -> Failure | None:
        """Ramp to a set-point and settle there."""
        self._machine.move(setpoint)
        ramp, settle = self._machine.time_to_ramped, self._machine.time_to_settled

        def report() -> float:
            ramping, remaining = self._machine.time_to_ramped, self._machine.time_to_settled
            if ramping > 0.0:
                operation.progress(RAMPING, 1.0 - ramping / ramp)
            elif remaining > 0.0:
                operation.progress(SETTLING, 1.0 - remaining / (settle - ramp))
            return remaining

        await self._drive(report, operation)
        return None

    async def measure(self, shots: int, operation: Operation) -> Measurement:
        """Average over some shots."""
        evaluation = self._machine.start_evaluation(
            self._machine.setpoint, shots or None, operation.shot
        )

        def report() -> float:
            operation.progress(MEASURING, evaluation.fraction)
            return 0.0 if evaluation.phase.finished else evaluation.duration - evaluation.elapsed

        await self._drive(report, operation)
        self._machine.stop()
        result = evaluation.result
        assert result is not None
        return Measurement(
            readbacks=_messages(result.readbacks),
            diagnostics=_messages(result.diagnostics) if result.shots else (),
            shots=result.shots,
        )

    async def _drive(self, report: Callable[[], float], operation: Operation) -> None:
        """Let time pass until `report`, the simulated time that is left, is 0, or interrupted."""
        last = time.monotonic()
        while (remaining := report()) > 0.0 and not operation.interrupt.done():
            pause = min(remaining / self._speed, STEP_PERIOD)
            if await first_of(self._node, operation.interrupt, timeout=pause) is not None:
                return
            now = time.monotonic()
            self._machine.step((now - last) * self._speed)
            last = now


def _messages(readings: Sequence[Reading]) -> list[msg.NamedValue]:
    return [
        msg.NamedValue(name=r.name, value=r.value, stddev=r.stddev, unit=r.unit) for r in readings
    ]
