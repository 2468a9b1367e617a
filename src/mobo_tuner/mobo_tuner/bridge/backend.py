"""Any controls as a machine: a mapping says where set-points go and where values come from."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping, Sequence
from functools import partial

from rclpy.executors import Executor
from rclpy.node import Node
from rclpy.task import Future

from mobo_msgs_py import msg
from mobo_msgs_py.action import EvaluateSetpoint
from mobo_tuner.bridge.averaging import average
from mobo_tuner.bridge.calls import CallError
from mobo_tuner.bridge.mapping import MAX_SHOTS, MachineMapping
from mobo_tuner.bridge.measuring import Measuring
from mobo_tuner.bridge.ramp import count_steps, interpolate
from mobo_tuner.bridge.setpoint_outputs import group_outputs
from mobo_tuner.bridge.signals import Signals
from mobo_tuner.machine.backend import (
    RAMPING,
    SETTLING,
    Failure,
    Measurement,
    Operation,
)
from mobo_tuner.ros.waiting import first_of

WATCH_PERIOD = 0.1  # [s] between two looks at interlocks and readbacks while something goes on
_Result = EvaluateSetpoint.Result


class BridgeBackend:
    """A machine behind topics, services and actions of any types.

    Args:
        node: that talks to them.
        mapping: what stands for what.
        executor: on which the coroutines run.

    Raises:
        MappingError: the mapping does not fit the installed types. Nothing was sent until then, nor
            is anything before the first move.
    """

    def __init__(self, node: Node, mapping: MachineMapping, executor: Executor) -> None:
        self._node = node
        self._mapping = mapping
        self.name = mapping.name
        self.max_shots = MAX_SHOTS
        self.variables = [
            msg.Variable(name=v.name, unit=v.unit, min=v.minimum, max=v.maximum)
            for v in mapping.variables.values()
        ]
        self.diagnostics = [
            msg.Observable(name=d.name, unit=d.unit) for d in mapping.diagnostics.values()
        ]
        signals = Signals(node)
        self._readbacks = {
            name: signals.number(variable.readback) for name, variable in mapping.variables.items()
        }
        self._settled = {
            name: signals.condition(variable.settled)
            for name, variable in mapping.variables.items()
            if variable.settled is not None
        }
        self._interlocks = {
            name: signals.condition(interlock) for name, interlock in mapping.interlocks.items()
        }
        for signal in self._interlocks.values():
            signal.listeners.append(lambda _: self._look())
        self._measuring = Measuring(node, mapping, signals, executor, self._wait)
        self._outputs = group_outputs(node, mapping.variables.values())
        self._setpoint: dict[str, float] = {}  # sent last; empty before the first move
        self._operation: Operation | None = None

    def refusal(self) -> Failure | None:
        """Why nothing may move now: an interlock, or a part of the controls that is not there."""
        trouble = self._trouble()
        if trouble is not None:
            return trouble
        for name in self._mapping.variables:
            displaced = self._displaced(name)
            if displaced:
                return Failure(_Result.INTERLOCK, displaced)
        problems = [output.problem for output in self._outputs] + self._measuring.problems()
        for problem in problems:
            if problem:
                return Failure(_Result.MACHINE_LOST, problem)
        return None

    def readbacks(self) -> Sequence[msg.NamedValue]:
        """Where the machine is now; NaN where that is not known."""
        return [
            msg.NamedValue(
                name=name,
                value=math.nan if signal.problem else signal.latest,
                stddev=math.nan,
                unit=self._mapping.variables[name].unit,
            )
            for name, signal in self._readbacks.items()
        ]

    async def move(self, setpoint: Mapping[str, float], operation: Operation) -> Failure | None:
        """Ramp to a set-point, and wait until all readbacks stay within their tolerances."""
        self._operation = operation
        try:
            return await self._ramp(setpoint, operation) or await self._settle(operation)
        finally:
            self._operation = None

    async def measure(self, shots: int, operation: Operation) -> Measurement:
        """Measure all diagnostics, and where the machine is meanwhile."""
        self._operation = operation
        positions: dict[str, list[float]] = {name: [] for name in self._readbacks}
        for name, signal in self._readbacks.items():
            positions[name].append(signal.latest)  # so that there is one, whatever comes
            signal.listeners.append(positions[name].append)
        try:
            measured = await self._measuring.measure(shots, operation)
        finally:
            self._operation = None
            for name, signal in self._readbacks.items():
                signal.listeners.remove(positions[name].append)
        readbacks = []
        failure = measured.failure
        for name, variable in self._mapping.variables.items():
            value, stddev = average(positions[name])
            readbacks.append(
                msg.NamedValue(name=name, value=value, stddev=stddev, unit=variable.unit)
            )
            if failure is None and not abs(value - self._setpoint[name]) <= variable.tolerance:
                failure = Failure(
                    _Result.INVALID_MEASUREMENT,
                    f"{name} was {_quantity(value, variable.unit)} while measured, more than "
                    f"{variable.tolerance:g} from its set-point {self._setpoint[name]:g}",
                )
        return Measurement(readbacks, measured.diagnostics, measured.shots, failure)

    def hold(self) -> None:
        """Send nothing more; what lags behind amid a move is told to stay where it is read.

        The readback may lie, so that a set-point never goes back by more than its largest step.
        """
        held = dict(self._setpoint)
        for name, last in self._setpoint.items() if self._operation is not None else ():
            variable, signal = self._mapping.variables[name], self._readbacks[name]
            lag = last - signal.latest
            if not signal.problem and abs(lag) > variable.tolerance:
                step = min(abs(lag), variable.max_step)
                back = last - math.copysign(step, lag)
                held[name] = min(max(back, variable.minimum), variable.maximum)
        for output in self._outputs:
            output.cancel()
        if held != self._setpoint:
            self._setpoint = held
            for output in self._outputs:
                output.send_now(held)

    async def _ramp(self, target: Mapping[str, float], operation: Operation) -> Failure | None:
        period = 1.0 / self._mapping.rate
        variables = self._mapping.variables
        start = self._start()
        largest = {n: min(v.max_step, v.slew * period) for n, v in variables.items()}
        steps = count_steps(start, target, largest)
        for number, point in enumerate(interpolate(start, target, steps), start=1):
            if operation.interrupt.done():
                return None
            self._setpoint = dict(point)
            for output in self._outputs:
                try:
                    await output.send(point, partial(self._wait, operation))
                except CallError as error:
                    code = _Result.UNKNOWN if error.answered else _Result.MACHINE_LOST
                    return None if operation.interrupt.done() else Failure(code, str(error))
            operation.progress(RAMPING, number / steps)
            # Never two steps in less than a period, also where the one before came late.
            await self._pause(operation, period)
        return None

    async def _settle(self, operation: Operation) -> Failure | None:
        started = time.monotonic()
        since = math.inf  # when all was settled first, without a break until now
        while not operation.interrupt.done():
            now = time.monotonic()
            unsettled = self._unsettled()
            since = math.inf if unsettled else min(since, now)
            if now - since >= self._mapping.settle_time:
                return None
            if unsettled and now - started > self._mapping.settle_timeout:
                return Failure(
                    _Result.TIMEOUT,
                    f"{unsettled}, {self._mapping.settle_timeout:g} s after the end of the ramp",
                )
            operation.progress(SETTLING, (now - started) / self._mapping.settle_timeout)
            await self._pause(operation, 0.05)
        return None

    def _start(self) -> dict[str, float]:
        """Where a ramp starts: at the last set-point, or at the readback if that is far from it."""
        start = {}
        for name, variable in self._mapping.variables.items():
            position = self._readbacks[name].latest
            last = self._setpoint.get(name, position)
            if abs(last - position) > variable.tolerance + variable.max_step:
                last = position  # `refusal` has let it pass
            start[name] = min(max(last, variable.minimum), variable.maximum)
        return start

    def _displaced(self, name: str) -> str:
        """Why a move must not start where a variable is, in a few words; empty where it may.

        If the readback is not where the variable was set, then either somebody moved it or the
        readback lies, and a ramp would start with a jump in one of the two cases.
        """
        variable, position = self._mapping.variables[name], self._readbacks[name].latest
        reads = f"{name} reads {_quantity(position, variable.unit)}"
        low, high = variable.minimum - variable.tolerance, variable.maximum + variable.tolerance
        if not low <= position <= high:
            limits = _quantity(f"{variable.minimum:g} to {variable.maximum:g}", variable.unit)
            return f"{reads}, which is outside its limits, {limits}: bring it back by hand"
        last = self._setpoint.get(name, position)
        reach = variable.tolerance + variable.max_step
        if self._mapping.follow_moved or abs(position - last) <= reach:
            return ""
        return (
            f"{reads}, but was set to {_quantity(last, variable.unit)}: bring it back, or restart "
            "the bridge once it is clear which of the two is right"
        )

    def _unsettled(self) -> str:
        """What is not settled yet, in a few words; empty where all is."""
        for name, variable in self._mapping.variables.items():
            readback = self._readbacks[name].latest
            setpoint = self._setpoint[name]
            if not abs(readback - setpoint) <= variable.tolerance:
                return (
                    f"{name} reads {_quantity(readback, variable.unit)}, which is not within "
                    f"{variable.tolerance:g} of its set-point {setpoint:g}"
                )
        for name, signal in self._settled.items():
            if signal.problem:
                return f"whether {name} is settled is not known: {signal.problem}"
            if not signal.latest:
                return f"{name} is not settled by its own account"
        return ""

    def _trouble(self) -> Failure | None:
        """What must end a move or a measurement at once."""
        for name, signal in self._interlocks.items():
            if signal.problem:
                # As after a restart: the way to the machine is lost, which may come back by itself.
                return Failure(
                    _Result.MACHINE_LOST, f"interlock {name} is not known: {signal.problem}"
                )
            if not signal.latest:
                return Failure(_Result.INTERLOCK, f"interlock {name} forbids to move")
        for name, signal in self._readbacks.items():
            if signal.problem:
                return Failure(
                    _Result.MACHINE_LOST, f"the readback of {name} is not known: {signal.problem}"
                )
        return None

    def _look(self) -> None:
        """End what goes on if it must end."""
        if self._operation is not None and (trouble := self._trouble()) is not None:
            self._operation.stop(trouble)

    async def _pause(self, operation: Operation, duration: float) -> None:
        await self._wait(operation, None, duration)

    async def _wait(self, operation: Operation, future: Future | None, timeout: float) -> bool:
        """Wait for a future, looking at the interlocks meanwhile; whether it is done.

        The wait ends when the operation is interrupted, or after `timeout` seconds.
        """
        deadline = time.monotonic() + timeout
        futures = [operation.interrupt] if future is None else [future, operation.interrupt]
        while (remaining := deadline - time.monotonic()) > 0.0:
            self._look()
            if await first_of(self._node, *futures, timeout=min(remaining, WATCH_PERIOD)):
                break
        return future is not None and future.done()


def _quantity(value: float | str, unit: str) -> str:
    number = value if isinstance(value, str) else f"{value:g}"
    return f"{number} {unit}" if unit else number
