"""The machine's health on `/diagnostics` at 1 Hz, in the form that standard ROS tools expect."""

from __future__ import annotations

from collections.abc import Mapping

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.node import Node

from awa_sim_node import interfaces
from awa_sim_node.backend import SimulatedBackend


class Health:
    """Publisher of one status each for the machine, the beam and the actuators.

    Args:
        node: Node that owns the topic.
        backend: Backend of the simulated machine.
    """

    def __init__(self, node: Node, backend: SimulatedBackend) -> None:
        self._node = node
        self._backend = backend
        self._publisher = interfaces.DIAGNOSTICS.publisher(node)
        self.evaluations = 0
        self.failures = 0

    def publish(self) -> None:
        """Publish the current status of each part."""
        message = DiagnosticArray(status=[self._machine(), self._beam(), self._actuators()])
        message.header.stamp = self._node.get_clock().now().to_msg()
        self._publisher.publish(message)

    def _machine(self) -> DiagnosticStatus:
        refusal = self._backend.direct_refusal()
        machine = self._backend.machine
        values = {
            "measurements": self.evaluations,
            "failed measurements": self.failures,
            "simulated time [s]": f"{self._backend.simulated_time:.1f}",
        }
        if machine is not None:
            values |= {"mode": machine.mode, "interlock": bool(machine.interlock)}
        if refusal is None:
            return self._status("machine", DiagnosticStatus.OK, "ready", values)
        raised = machine is not None and bool(machine.interlock)
        level = DiagnosticStatus.ERROR if raised else DiagnosticStatus.WARN
        return self._status("machine", level, refusal.message, values)

    def _beam(self) -> DiagnosticStatus:
        machine = self._backend.machine
        if machine is None:
            return self._status("beam", DiagnosticStatus.STALE, "no machine is connected", {})
        values = {"trips": machine.trips}
        if machine.tripped:
            message = "the gun has tripped; there is no beam"
            return self._status("beam", DiagnosticStatus.WARN, message, values)
        return self._status("beam", DiagnosticStatus.OK, "beam is there", values)

    def _actuators(self) -> DiagnosticStatus:
        machine = self._backend.machine
        if machine is None:
            return self._status("actuators", DiagnosticStatus.STALE, "no machine is connected", {})
        setpoint, readbacks = machine.setpoint, machine.readbacks()
        values = {name: f"{readbacks[name]:g} (set {setpoint[name]:g})" for name in setpoint}
        message = "settled" if machine.settled else "moving"
        return self._status("actuators", DiagnosticStatus.OK, message, values)

    def _status(
        self, name: str, level: bytes, message: str, values: Mapping[str, object]
    ) -> DiagnosticStatus:
        return DiagnosticStatus(
            level=level,
            name=f"{self._node.get_name()}: {name}",
            message=message,
            hardware_id=self._backend.name,
            values=[KeyValue(key=key, value=str(value)) for key, value in values.items()],
        )
