"""The lifecycle node of the simulated machine: configured, it is on; activated, it may move."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

from builtin_interfaces.msg import Time
from rclpy.executors import Executor
from rclpy.lifecycle import LifecycleState, TransitionCallbackReturn
from rclpy.node import Node
from rosgraph_msgs.msg import Clock as ClockMessage

from awa_sim_node import interfaces
from awa_sim_node.backend import SimulatedBackend
from awa_sim_node.beam_topics import BeamTopics
from awa_sim_node.devices import Devices
from awa_sim_node.external_clock import ExternalClock
from awa_sim_node.machine import EvaluationResult, SimulatedMachine, behaviour_of, describe
from awa_sim_node.machine.behaviour import Mode
from awa_sim_node.parameters import AWA_SIM, behaviour_specs
from mobo_tuner.machine.node import MachineNode
from mobo_tuner.ros.parameters import declare
from mobo_tuner.ros.process import Program, exit_process, run_node
from mobo_tuner.ros.waiting import STEADY_CLOCK

CLOCK_PERIOD = 0.05  # [s] of wall time
LOOK_PERIOD = 0.5  # [s] of wall time between two looks whether the clock of others stands still


class AwaSim(MachineNode):
    """The node of one simulated machine.

    `configure` switches the machine on, `activate` allows motion, `deactivate` stops all motion,
    `cleanup` switches it off.
    """

    def __init__(self, executor: Executor) -> None:
        """Declare the parameters; with `autostart`, also configure and activate.

        Nothing moves.

        Args:
            executor: Executor that spins the node.

        Raises:
            ValueError: If a parameter is not allowed.
            StartError: If the machine could not be switched on.
        """
        super().__init__("awa_sim", executor, self._create)
        description = describe(str(self._values["model"]))
        self._devices = Devices(self, self._simulated, self.server)
        self._beam = BeamTopics(self, description, bool(self._values["publish_truth"]))
        self._last_free_shot = 0.0
        self._simulated.on_shot = self._beam.publish
        self._simulated.on_step = self._devices.publish_changes
        self._simulated.on_measured = self._measured
        self._every(1.0 / float(self._values["stream_rate"]), self._stream)
        if self._values["publish_clock"]:
            self._began = time.time()
            self._clock_publisher = interfaces.CLOCK.publisher(self)
            self._every(CLOCK_PERIOD, self._publish_clock)
        self.autostart()

    def _create(self, node: Node, _: Executor) -> SimulatedBackend:
        """Declare the parameters and return the backend."""
        self._values = declare(node, AWA_SIM)
        model, mode = str(self._values["model"]), str(self._values["mode"])
        self._behaviour = declare(node, behaviour_specs(model, mode))
        behaviour_of(model, Mode(mode)).changed(self._behaviour)
        self._speed = float(self._values["speed"])
        clock = self._external_clock()
        self._trouble = ""  # with the clock
        self._simulated = (
            SimulatedBackend(node, describe(model), self._speed, clock, lambda: self._trouble)
            if clock
            else SimulatedBackend(node, describe(model), self._speed)
        )
        if clock:
            self._every(LOOK_PERIOD, lambda: self._look_at(clock))
        return self._simulated

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Switch the machine on."""
        values = self._values
        try:
            machine = SimulatedMachine(
                str(values["model"]), str(values["mode"]), int(values["seed"]), self._behaviour
            )
        except Exception as error:  # rclpy would not log it
            self.get_logger().error(f"the machine could not be switched on: {error!r}")
            return TransitionCallbackReturn.FAILURE
        self._simulated.connect(machine)
        self._last_free_shot = 0.0
        self.get_logger().info(
            f"{self.backend.name}: configured, {machine.mode}, {self._speed:g} times real time"
        )
        return super().on_configure(state)

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Switch the machine off."""
        done = super().on_cleanup(state)
        self._simulated.disconnect()
        return done

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Stop all motion and switch the machine off."""
        done = super().on_shutdown(state)
        self._simulated.disconnect()
        return done

    def on_error(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Switch the machine off after a failed transition."""
        done = super().on_error(state)
        self._simulated.disconnect()
        return done

    def _external_clock(self) -> ExternalClock | None:
        """Return the clock on `/clock` if others publish it; None if wall time drives the machine."""
        simulated = self.get_parameter("use_sim_time").value
        if not simulated or self._values["publish_clock"]:
            return None
        clock = self.get_clock()
        return ExternalClock(lambda: float(clock.now().nanoseconds * 1e-9))

    def _look_at(self, clock: ExternalClock) -> None:
        """Say when the time begins to stand still, and when it goes on."""
        before, self._trouble = self._trouble, clock.trouble
        if self._trouble and not before:
            self.get_logger().warning(self._trouble)
        elif before and not self._trouble:
            self.get_logger().info("the time on /clock goes on")

    def _every(self, period: float, callback: Callable[[], Any]) -> None:
        # Streams run in wall time, whatever the speed of the simulation.
        self.create_timer(period, callback, clock=STEADY_CLOCK)

    def _stream(self) -> None:
        """Advance time, publish the devices, and take a free-running shot between evaluations."""
        self._simulated.advance()
        self._devices.publish()
        machine = self._simulated.machine
        if machine is None or self._simulated.inactive:
            return
        period = 1.0 / machine.behaviour.beam.repetition_rate
        if machine.time - self._last_free_shot < period:
            return
        shot = machine.free_shot()
        if shot is not None:
            self._last_free_shot = machine.time
            self._beam.publish(shot)
            self._devices.publish_changes()

    def _measured(self, _: EvaluationResult) -> None:
        if self._simulated.machine is not None:
            self._beam.publish_uncertainty(self._simulated.machine.spread())

    def _publish_clock(self) -> None:
        self._simulated.advance()
        now = self._began + self._simulated.simulated_time
        seconds = int(now)
        self._clock_publisher.publish(
            ClockMessage(clock=Time(sec=seconds, nanosec=int((now - seconds) * 1e9)))
        )


def main() -> None:
    """Run the simulated machine's node."""
    program = Program(
        "awa_sim",
        "Simulates a machine to tune: the AWA injector, or the paper's toy problem.",
        (*AWA_SIM, *behaviour_specs("awa", "nominal")),
        "The defaults of the behaviour (those with a dot) are those of the mode 'nominal'.",
    )
    exit_process(run_node(AwaSim, program))


if __name__ == "__main__":
    main()
