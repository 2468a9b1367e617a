"""The sign of life of a run, by which a machine knows that its client has not died."""

from __future__ import annotations

from rclpy.clock import Clock, ClockType
from rclpy.node import Node

from mobo_msgs_py.msg import Heartbeat as HeartbeatMessage
from mobo_tuner.ros.qos import STREAM

HEARTBEAT_PERIOD = 1.0  # [s] at most
BEATS = 3.0  # at least, in the time after which a machine counts the client as lost


class Heartbeat:
    """Beats at 1 Hz from the executor's thread for as long as a run goes on.

    Args:
        node: publishes it.
        client_timeout: silence after which a machine counts this client as lost [s]; 0 = never.
            Where it is short, the heart beats faster.
    """

    def __init__(self, node: Node, client_timeout: float) -> None:
        self._node = node
        self._run_id = ""
        self._publisher = node.create_publisher(HeartbeatMessage, "heartbeat", STREAM)
        # Of a steady clock: a life is no matter of simulated time.
        period = min(HEARTBEAT_PERIOD, client_timeout / BEATS or HEARTBEAT_PERIOD)
        self._timer = node.create_timer(
            period, self._beat, clock=Clock(clock_type=ClockType.STEADY_TIME)
        )

    def begin(self, run_id: str) -> None:
        """Beat for this run from now on."""
        self._run_id = run_id
        self._publish()

    def end(self) -> None:
        """Beat no more; a last message without a run tells the machine that this is on purpose."""
        self._run_id = ""
        self._publish()

    def _beat(self) -> None:
        if self._run_id:
            self._publish()

    def _publish(self) -> None:
        stamp = self._node.get_clock().now().to_msg()
        self._publisher.publish(HeartbeatMessage(stamp=stamp, run_id=self._run_id))
