"""Bridge to any control system: a mapping assigns its topics, services and actions to variables."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial

from rclpy.executors import Executor
from rclpy.node import Node

from mobo_msgs_py.action import EvaluateSetpoint
from mobo_tuner.bridge.calls import CallError
from mobo_tuner.bridge.mapping import MachineMapping
from mobo_tuner.bridge.measuring import Measuring
from mobo_tuner.bridge.setpoint_outputs import group_outputs
from mobo_tuner.bridge.signals import Signals
from mobo_tuner.machine.backend import Failure, Measurement, Operation
from mobo_tuner.machine.ramp import RampSettings
from mobo_tuner.machine.ramped import RampedBackend
from mobo_tuner.ros.diagnostics import ERROR, OK, STALE, Health

_Result = EvaluateSetpoint.Result


class BridgeBackend(RampedBackend):
    """Machine behind topics, services and actions of any types.

    Args:
    node: Node of their publishers, subscriptions and clients.
        mapping: Mapping of variables and diagnostics to them.
        executor: Executor on which the coroutines run.

    Raises:
        MappingError: If the mapping does not fit the installed types. Nothing is sent before the first
            move.
    """

    def __init__(self, node: Node, mapping: MachineMapping, executor: Executor) -> None:
        settings = RampSettings(
            mapping.rate, mapping.settle_time, mapping.settle_timeout, mapping.follow_moved
        )
        units = {name: diagnostic.unit for name, diagnostic in mapping.diagnostics.items()}
        super().__init__(node, mapping.name, mapping.variables.values(), units, settings)
        signals = Signals(node)
        self._readbacks = {
            name: signals.number(variable.readback) for name, variable in mapping.variables.items()
        }
        for name, signal in self._readbacks.items():
            signal.listeners.append(partial(self.collect, name))
        self._settled = {
            name: signals.condition(variable.settled)
            for name, variable in mapping.variables.items()
            if variable.settled is not None
        }
        self._interlocks = {
            name: signals.condition(interlock) for name, interlock in mapping.interlocks.items()
        }
        for signal in self._interlocks.values():
            signal.listeners.append(lambda _: self.check())
        self._measuring = Measuring(node, mapping, signals, executor, self.wait)
        self._outputs = group_outputs(node, mapping.variables.values())

    def position(self, name: str) -> float:
        """Return the readback of a variable, of which a single wrong value does not count."""
        return self._readbacks[name].steady

    def readback_problem(self, name: str) -> str:
        """Return the reason why the readback of a variable is unknown, else an empty string."""
        return self._readbacks[name].problem

    def forbidden(self) -> Failure | None:
        """Return a failure if an interlock prevents moves or is unknown."""
        for name, signal in self._interlocks.items():
            if signal.problem:
                # Treated like a lost connection, which may come back.
                return Failure(
                    _Result.MACHINE_LOST, f"interlock {name} is not known: {signal.problem}"
                )
            if not signal.latest:
                return Failure(_Result.INTERLOCK, f"interlock {name} forbids to move")
        return None

    def missing(self) -> str:
        """Return the missing part of the control system, else an empty string."""
        problems = [output.problem for output in self._outputs] + self._measuring.problems()
        return next((problem for problem in problems if problem), "")

    def parts(self) -> Mapping[str, Callable[[], Health]]:
        """Return functions for the health of the variables, interlocks and connections."""
        return {
            **super().parts(),
            "interlocks": self._interlocks_health,
            "connections": self._connections_health,
        }

    def _interlocks_health(self) -> Health:
        """Return whether each interlock permits moves."""
        values = {
            name: f"unknown: {signal.problem}"
            if signal.problem
            else ("permits" if signal.latest else "forbids")
            for name, signal in self._interlocks.items()
        }
        failure = self.forbidden()
        if failure is None:
            return Health(OK, f"interlocks that permit to move: all {len(values)}", values)
        level = ERROR if failure.code == _Result.INTERLOCK else STALE
        return Health(level, failure.message, values)

    def _connections_health(self) -> Health:
        """Return whether all receivers of set-points, services and actions exist."""
        missing = self.missing()
        return Health(STALE, missing) if missing else Health(OK, "nothing is missing")

    async def send(self, setpoint: Mapping[str, float], operation: Operation) -> Failure | None:
        """Send the set-point of one step; a service or an action must answer."""
        for output in self._outputs:
            try:
                await output.send(setpoint, partial(self.wait, operation))
            except CallError as error:
                return Failure(
                    _Result.UNKNOWN if error.answered else _Result.MACHINE_LOST, str(error)
                )
        return None

    def send_now(self, setpoint: Mapping[str, float]) -> None:
        """Send a set-point at once."""
        for output in self._outputs:
            output.send_now(setpoint)

    def cancel(self) -> None:
        """Cancel the actions that are running."""
        for output in self._outputs:
            output.cancel()

    def unsettled(self) -> str:
        """Return the variable whose `settled` condition does not hold, else an empty string."""
        for name, signal in self._settled.items():
            if signal.problem:
                return f"whether {name} is settled is not known: {signal.problem}"
            if not signal.latest:
                return f"{name} is not settled by its own account"
        return ""

    async def take_shots(self, shots: int, operation: Operation) -> Measurement:
        """Measure all diagnostics."""
        return await self._measuring.measure(shots, operation)
