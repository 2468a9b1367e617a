"""The bridge: it serves the machine of a mapping file, whose controls use their own types."""

from __future__ import annotations

import sys

from rclpy.executors import Executor
from rclpy.node import Node

from mobo_tuner.bridge.backend import BridgeBackend
from mobo_tuner.bridge.describe import MACHINE_BRIDGE, mapping_file
from mobo_tuner.bridge.mapping import load_mapping
from mobo_tuner.machine.node import serve
from mobo_tuner.ros.parameters import declare
from mobo_tuner.ros.process import StartError


def create(node: Node, executor: Executor) -> BridgeBackend:
    """Return the machine of the mapping file.

    Raises:
        ValueError: If a parameter or the mapping is not allowed; nothing was sent.
        StartError: If the parameter `mapping` is empty.
    """
    path = str(declare(node, MACHINE_BRIDGE)["mapping"])
    if not path:
        raise StartError("the parameter mapping is empty; it must name the mapping file")
    return BridgeBackend(node, load_mapping(mapping_file(path, sys.argv)), executor)


def main() -> None:
    """Run the bridge until a signal stops it."""
    serve(
        create,
        "machine_bridge",
        "Serves the machine that a mapping file describes, over its own topics, services and actions.",
        MACHINE_BRIDGE,
    )


if __name__ == "__main__":
    main()
