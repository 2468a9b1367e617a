"""What the services and runs of the tuner's node share."""

from __future__ import annotations

from dataclasses import dataclass

from builtin_interfaces.msg import Time
from rclpy.impl.rcutils_logger import RcutilsLogger
from rclpy.node import Node
from rclpy.task import Future

from mobo_tuner.ros.conversions import seconds
from mobo_tuner.ros.worker import Worker
from mobo_tuner.tuner.gate import Gate
from mobo_tuner.tuner.parameters import TunerParameters
from mobo_tuner.tuner.topics import Status, TunerTopics


@dataclass(frozen=True)
class TunerContext:
    """The node and what everything in it works with.

    Attributes:
        node: The tuner's node.
        parameters: Its parameters as they are now; some change while the node runs.
        worker: The one thread in which optimisers work.
        gate: The only way to the machine.
        topics: Publishers.
        stopping: Done when this process is asked to end.
    """

    node: Node
    parameters: TunerParameters
    worker: Worker
    gate: Gate
    topics: TunerTopics
    stopping: Future

    @property
    def log(self) -> RcutilsLogger:
        """Logger of the node."""
        return self.node.get_logger()

    @property
    def status(self) -> Status:
        """Status of the tuner."""
        return self.topics.status

    def now(self) -> Time:
        """Return the node's time."""
        return self.node.get_clock().now().to_msg()

    def stamp(self) -> float:
        """Return the node's time [s since the epoch]."""
        return seconds(self.now())

    def future(self) -> Future:
        """Return a new future of the node's executor."""
        return Future(executor=self.node.executor)


def describe(error: Exception) -> str:
    """Return an error as one sentence for a client; one that was not foreseen is named by its type."""
    if isinstance(error, ValueError | OSError):
        return str(error)
    return f"{type(error).__name__}: {error}"
