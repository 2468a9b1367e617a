"""The lifecycle node of the simulated machine: configured, it is on; activated, it may move."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

from builtin_interfaces.msg import Time
from rcl_interfaces.msg import SetParametersResult
from rclpy.clock import Clock, ClockType
from rclpy.executors import Executor
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import qos_profile_system_default
from rosgraph_msgs.msg import Clock as ClockMessage

from awa_sim_node.backend import SimulatedBackend
from awa_sim_node.beam_topics import BeamTopics
from awa_sim_node.devices import Devices
from awa_sim_node.health import Health
from awa_sim_node.machine import EvaluationResult, SimulatedMachine, behaviour_of, describe
from awa_sim_node.machine.behaviour import Mode
from awa_sim_node.parameters import AWA_SIM, behaviour_specs
from mobo_msgs_py.action import EvaluateSetpoint
from mobo_tuner.machine.backend import Failure
from mobo_tuner.machine.server import MachineServer
from mobo_tuner.ros.lifecycle import refuse_unknown_transitions
from mobo_tuner.ros.parameters import declare
from mobo_tuner.ros.process import StartError, exit_process, run_node

HEALTH_PERIOD = 1.0  # [s]
CLOCK_PERIOD = 0.05  # [s] of wall time
_SUCCESS = TransitionCallbackReturn.SUCCESS


class AwaSim(LifecycleNode):
    """The node of one simulated machine.

    `configure` switches the machine on, `activate` allows motion, `deactivate` stops all motion,
    `cleanup` switches it off. Every interface exists from the start and refuses requests that the
    current state does not allow.
    """

    exit_code = None

    def __init__(self, executor: Executor) -> None:
        """Declare the parameters; with `autostart`, also configure and activate.

        Nothing moves.

        Args:
            executor: Executor that spins the node.

        Raises:
            ValueError: If a parameter is not allowed.
            StartError: If the machine could not be switched on.
        """
        super().__init__("awa_sim")
        refuse_unknown_transitions(self)
        try:
            self._values = declare(self, AWA_SIM)
            model, mode = str(self._values["model"]), str(self._values["mode"])
            self._behaviour = declare(self, behaviour_specs(model, mode))
            behaviour_of(model, Mode(mode)).changed(self._behaviour)
        except ValueError:
            self.destroy_node()
            raise
        self.add_on_set_parameters_callback(self._refuse_unknown_parameters)
        description = describe(model)
        self._speed = float(self._values["speed"])
        self._backend = SimulatedBackend(self, description, self._speed, self._passing_time())
        self._server = MachineServer(self, self._backend, executor)
        self._devices = Devices(self, self._backend, self._server)
        self._beam = BeamTopics(self, description, bool(self._values["publish_truth"]))
        self._health = Health(self, self._backend)
        self._last_free_shot = 0.0
        self._backend.on_shot = self._beam.publish
        self._backend.on_step = self._devices.publish_changes
        self._backend.on_measured = self._measured
        self._every(1.0 / float(self._values["stream_rate"]), self._stream)
        self._every(HEALTH_PERIOD, self._health.publish)
        if self._values["publish_clock"]:
            self._began = time.time()
            self._clock_publisher = self.create_publisher(
                ClockMessage, "/clock", qos_profile_system_default
            )
            self._every(CLOCK_PERIOD, self._publish_clock)
        if self._values["autostart"]:
            if self.trigger_configure() is _SUCCESS:
                self.trigger_activate()
            if not self._backend.active:
                self.destroy_node()
                raise StartError("the machine could not be switched on; the log above says why")

    @property
    def node(self) -> Node:
        """The rclpy node: itself."""
        return self

    def on_configure(self, _: LifecycleState) -> TransitionCallbackReturn:
        """Switch the machine on."""
        values = self._values
        try:
            machine = SimulatedMachine(
                str(values["model"]), str(values["mode"]), int(values["seed"]), self._behaviour
            )
        except Exception as error:  # rclpy would not log it
            self.get_logger().error(f"the machine could not be switched on: {error!r}")
            return TransitionCallbackReturn.FAILURE
        self._backend.connect(machine)
        self._last_free_shot = 0.0
        self.get_logger().info(
            f"{self._backend.name}: configured, {machine.mode}, {self._speed:g} times real time"
        )
        return _SUCCESS

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Allow motion."""
        self._backend.activate()
        self.get_logger().info(f"{self._backend.name}: ready")
        return super().on_activate(state)

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Stop all motion."""
        self._halt("the machine's node was deactivated")
        return super().on_deactivate(state)

    def on_cleanup(self, _: LifecycleState) -> TransitionCallbackReturn:
        """Switch the machine off."""
        self._backend.disconnect()
        return _SUCCESS

    def on_shutdown(self, _: LifecycleState) -> TransitionCallbackReturn:
        """Stop all motion and switch the machine off."""
        self._halt("the machine's node was shut down")
        self._backend.disconnect()
        return _SUCCESS

    def on_error(self, _: LifecycleState) -> TransitionCallbackReturn:
        """Switch the machine off after a failed transition."""
        self._halt("the machine's node failed")
        self._backend.disconnect()
        return _SUCCESS

    async def stop(self) -> None:
        """Stop all motion; the machine holds its position."""
        await self._server.stop()

    def close(self) -> None:
        """Release the node."""
        self.destroy_node()

    def _halt(self, reason: str) -> None:
        self._server.interrupt(Failure(EvaluateSetpoint.Result.NOT_ACTIVE, reason))
        self._backend.deactivate(reason)
        self.get_logger().info(reason)

    def _refuse_unknown_parameters(self, parameters: list[Parameter]) -> SetParametersResult:
        """Refuse parameters that were not declared; rclpy itself accepts one with an empty name."""
        unknown = [p.name for p in parameters if not self.has_parameter(p.name)]
        reason = f"the parameter '{unknown[0]}' is unknown" if unknown else ""
        return SetParametersResult(successful=not unknown, reason=reason)

    def _passing_time(self) -> Callable[[], float]:
        """Return the clock [s] that drives the machine: wall time, or `/clock` if it is external."""
        simulated = self.get_parameter("use_sim_time").value
        if simulated and not self._values["publish_clock"]:
            clock = self.get_clock()
            return lambda: float(clock.now().nanoseconds * 1e-9)
        return time.monotonic

    def _every(self, period: float, callback: Callable[[], Any]) -> None:
        # Streams run in wall time, whatever the speed of the simulation.
        self.create_timer(period, callback, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def _stream(self) -> None:
        """Advance time, publish the devices, and take a free-running shot between evaluations."""
        self._backend.advance()
        self._devices.publish()
        machine = self._backend.machine
        if machine is None or not self._backend.active:
            return
        period = 1.0 / machine.behaviour.beam.repetition_rate
        if machine.time - self._last_free_shot < period:
            return
        shot = machine.free_shot()
        if shot is not None:
            self._last_free_shot = machine.time
            self._beam.publish(shot)
            self._devices.publish_changes()

    def _measured(self, result: EvaluationResult) -> None:
        self._health.evaluations += 1
        self._health.failures += result.failure is not None
        if self._backend.machine is not None:
            self._beam.publish_uncertainty(self._backend.machine.spread())

    def _publish_clock(self) -> None:
        self._backend.advance()
        now = self._began + self._backend.simulated_time
        seconds = int(now)
        self._clock_publisher.publish(
            ClockMessage(clock=Time(sec=seconds, nanosec=int((now - seconds) * 1e9)))
        )


def main() -> None:
    """Run the simulated machine's node."""
    exit_process(run_node(AwaSim))


if __name__ == "__main__":
    main()
