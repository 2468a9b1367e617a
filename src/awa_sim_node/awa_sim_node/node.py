"""The simulated machine as a ROS node: it describes itself, and it evaluates set-points."""

from __future__ import annotations

from rclpy.executors import Executor
from rclpy.node import Node

from awa_sim_node.backend import SimulatedBackend
from awa_sim_node.machine import SimulatedMachine
from awa_sim_node.parameters import AWA_SIM
from mobo_tuner.ros.machine_server import MachineServer
from mobo_tuner.ros.parameters import declare
from mobo_tuner.ros.process import exit_process, run_node


class AwaSim:
    """Serves one simulated machine."""

    exit_code = None

    def __init__(self, executor: Executor) -> None:
        """Declare the parameters and switch the machine on; nothing moves.

        Raises:
            ValueError: a parameter is not allowed.
        """
        self.node = Node("awa_sim")
        try:
            parameters = declare(self.node, AWA_SIM)
        except ValueError:
            self.node.destroy_node()
            raise
        machine = SimulatedMachine(
            str(parameters["model"]), str(parameters["mode"]), int(parameters["seed"])
        )
        speed = float(parameters["speed"])
        backend = SimulatedBackend(self.node, machine, speed)
        self._server = MachineServer(self.node, backend, executor)
        self.node.get_logger().info(f"{backend.name}: ready, {speed:g} times as fast as real")

    async def stop(self) -> None:
        """Stop whatever moves, where it is."""
        await self._server.stop()

    def close(self) -> None:
        """Release the node."""
        self.node.destroy_node()


def main() -> None:
    """Run the simulated machine's node."""
    exit_process(run_node(AwaSim))


if __name__ == "__main__":
    main()
