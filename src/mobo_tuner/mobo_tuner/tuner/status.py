"""What the tuner says that it is doing."""

from __future__ import annotations

from rclpy.node import Node

from mobo_msgs_py import msg
from mobo_tuner.tuner.topics import TunerPublishers

STATUS_PERIOD = 1.0  # [s]


class Status:
    """The tuner's status: published at every change that matters, and at 1 Hz.

    Attributes:
        message: as it was published last, but for its stamp.
    """

    def __init__(self, node: Node, publishers: TunerPublishers) -> None:
        self._node = node
        self._publishers = publishers
        self.message = msg.TunerStatus()
        self._timer = node.create_timer(STATUS_PERIOD, self._publish)
        self._publish()

    def set(self, *, publish: bool = True, **fields: object) -> None:
        """Change some fields; what does not matter at once waits for the next period."""
        for name, value in fields.items():
            setattr(self.message, name, value)
        if publish:
            self._publish()

    def _publish(self) -> None:
        self.message.stamp = self._node.get_clock().now().to_msg()
        self._publishers.status(self.message)
