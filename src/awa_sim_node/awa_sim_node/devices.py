"""The machine's devices as plain topics and services, as a typical control system offers them.

`<device>/setpoint` (in), `<device>/readback` and `<device>/settled` (out) are `std_msgs`: a client
can drive the machine without the project's own actions.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import partial

from rclpy.node import Node
from std_msgs.msg import Bool, Float64
from std_srvs.srv import Trigger

from awa_sim_node import interfaces
from awa_sim_node.backend import SimulatedBackend
from mobo_msgs_py.action import EvaluateSetpoint
from mobo_tuner.machine.backend import Failure
from mobo_tuner.machine.server import MachineServer

WARNING_PERIOD = 1.0  # [s] between two warnings with the same error code for one device


class Devices:
    """The topics of each device, and the services `stop` and `clear_interlock`.

    Direct moves obey the limits, the interlock and the node's state, and are refused while an
    action moves the machine.

    Args:
        node: Node that owns the topics and services.
        backend: Backend of the simulated machine.
        server: Server of the machine's actions, which may be moving the machine.
    """

    def __init__(self, node: Node, backend: SimulatedBackend, server: MachineServer) -> None:
        self._node = node
        self._backend = backend
        self._server = server
        names = [variable.name for variable in backend.variables]
        self._readbacks = {name: interfaces.READBACK.publisher(node, name) for name in names}
        self._settled = {name: interfaces.SETTLED.publisher(node, name) for name in names}
        for name in names:
            interfaces.SETPOINT.subscription(node, partial(self._set, name), name)
        self._interlock = interfaces.INTERLOCK.publisher(node)
        interfaces.STOP.server(node, self._served(self._stop))
        interfaces.CLEAR_INTERLOCK.server(node, self._served(self._clear))
        self._warned: dict[str, tuple[int, float]] = {}
        self._shown: dict[str, bool] = {}
        self._shown_interlock: bool | None = None

    def publish(self) -> None:
        """Publish the readback of every device, and whether it is settled."""
        machine = self._backend.machine
        if machine is None:
            return
        for name, value in machine.readbacks().items():
            self._readbacks[name].publish(Float64(data=value))
        self._shown.clear()
        self.publish_changes()

    def publish_changes(self) -> None:
        """Publish changes of `settled` and of the interlock since the last call."""
        machine = self._backend.machine
        if machine is None:
            return
        for name, settled in machine.settled_variables.items():
            if self._shown.get(name) is not settled:
                self._settled[name].publish(Bool(data=settled))
                self._shown[name] = settled
        raised = bool(machine.interlock)
        if raised is not self._shown_interlock:
            if raised:
                self._node.get_logger().error(machine.interlock)
            elif self._shown_interlock is not None:
                self._node.get_logger().info("the interlock is cleared")
            self._interlock.publish(Bool(data=raised))
            self._shown_interlock = raised

    def _set(self, name: str, message: Float64) -> None:
        machine = self._backend.machine
        refusal = self._backend.direct_refusal()
        if refusal is None and self._server.busy:
            refusal = Failure(EvaluateSetpoint.Result.BUSY, "an action moves the machine")
        if refusal is None and machine is not None:
            try:
                self._backend.advance()  # the time until now is not part of the move
                machine.set(name, message.data)
            except (ValueError, RuntimeError) as error:
                refusal = Failure(EvaluateSetpoint.Result.INVALID_SETPOINT, str(error))
        if refusal is not None:
            self._warn(name, message.data, refusal)
        self.publish_changes()

    def _warn(self, name: str, value: float, refusal: Failure) -> None:
        """Log why a set-point is refused, at most once per `WARNING_PERIOD`."""
        code, when = self._warned.get(name, (0, 0.0))
        if code == refusal.code and time.monotonic() - when < WARNING_PERIOD:
            return
        self._warned[name] = refusal.code, time.monotonic()
        self._node.get_logger().warning(
            f"set-point {name} = {value:g} is refused: {refusal.message}"
        )

    def _stop(self) -> tuple[bool, str]:
        self._server.interrupt(
            Failure(EvaluateSetpoint.Result.CANCELED, "stopped by the service 'stop'")
        )
        self._backend.hold()
        return True, "the machine holds its position"

    def _clear(self) -> tuple[bool, str]:
        if self._backend.machine is None:
            return False, "the machine's node is not configured"
        raised = bool(self._backend.machine.interlock)
        self._backend.machine.clear_interlock()
        return True, "the interlock is cleared" if raised else "the interlock was not raised"

    def _served(
        self, act: Callable[[], tuple[bool, str]]
    ) -> Callable[[Trigger.Request, Trigger.Response], Trigger.Response]:
        """Return a service callback that runs `act` and answers with its success and message."""

        def serve(_: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
            response.success, response.message = act()
            self.publish_changes()
            return response

        return serve
