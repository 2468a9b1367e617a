"""What the parts of the tuner's node share."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from builtin_interfaces.msg import Time
from rclpy.impl.rcutils_logger import RcutilsLogger
from rclpy.node import Node
from rclpy.task import Future

from mobo_tuner.ros.worker import Worker
from mobo_tuner.tuner.heartbeat import Heartbeat
from mobo_tuner.tuner.machine_client import MachineClient
from mobo_tuner.tuner.status import Status
from mobo_tuner.tuner.topics import TunerPublishers


@dataclass(frozen=True)
class TunerParts:
    """The node, its parameters, and what everything else works with.

    Attributes:
        parameters: as they are now; some may be set while the node runs.
        worker: the thread in which the optimiser works, and nobody else.
        stopping: done when this process is asked to end.
    """

    node: Node
    parameters: dict[str, Any]
    worker: Worker
    machine: MachineClient
    publishers: TunerPublishers
    status: Status
    heartbeat: Heartbeat
    stopping: Future

    @property
    def log(self) -> RcutilsLogger:
        """The node's logger."""
        return self.node.get_logger()

    def now(self) -> Time:
        """The node's time."""
        return self.node.get_clock().now().to_msg()


def sentence(error: Exception) -> str:
    """What a client is told of an error: one sentence; an unforeseen one is named."""
    if isinstance(error, ValueError | OSError):
        return str(error)
    return f"{type(error).__name__}: {error}"
