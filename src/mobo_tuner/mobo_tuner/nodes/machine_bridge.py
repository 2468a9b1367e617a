"""The bridge: serves `EvaluateSetpoint` for controls that know none of our types, by a mapping file."""

from __future__ import annotations

import sys

from rclpy.executors import Executor
from rclpy.node import Node

from mobo_tuner.bridge.backend import BridgeBackend
from mobo_tuner.bridge.describe import MACHINE_BRIDGE, mapping_file
from mobo_tuner.bridge.mapping import load_mapping
from mobo_tuner.machine.server import MachineServer
from mobo_tuner.ros.parameters import declare
from mobo_tuner.ros.process import StartError, exit_process, run_node


class MachineBridge:
    """Serves the machine that a mapping file describes.

    Raises:
        ValueError: a parameter is not allowed, or the mapping is not; nothing was sent.
        StartError: no mapping is named.
    """

    exit_code = None

    def __init__(self, executor: Executor) -> None:
        self.node = Node("machine_bridge")
        try:
            path = str(declare(self.node, MACHINE_BRIDGE)["mapping"])
            if not path:
                raise StartError("the parameter mapping is empty; it must name the mapping file")
            mapping = load_mapping(mapping_file(path, sys.argv))
            backend = BridgeBackend(self.node, mapping, executor)
        except (StartError, ValueError):
            self.node.destroy_node()
            raise
        self._server = MachineServer(self.node, backend, executor)
        self.node.get_logger().info(
            f"{backend.name}: ready with {len(backend.variables)} variables and "
            f"{len(backend.diagnostics)} diagnostics"
        )

    async def stop(self) -> None:
        """Stop whatever moves, where it is."""
        await self._server.stop()

    def close(self) -> None:
        """Release the node."""
        self.node.destroy_node()


def main() -> None:
    """Run the bridge until a signal stops it."""
    exit_process(run_node(MachineBridge))


if __name__ == "__main__":
    main()
