"""Health of a node's parts on `/diagnostics` at 1 Hz, in the form that standard ROS tools expect."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.node import Node

from mobo_tuner.ros import interfaces
from mobo_tuner.ros.waiting import STEADY_CLOCK

PERIOD = 1.0  # [s]
_UNKNOWN = "_NODE_NAME_UNKNOWN_"  # rcl's name of a node whose own is not known yet
OK, WARN = DiagnosticStatus.OK, DiagnosticStatus.WARN
ERROR, STALE = DiagnosticStatus.ERROR, DiagnosticStatus.STALE


@dataclass(frozen=True)
class Health:
    """How one part of a node is.

    Attributes:
        level: OK; WARN if a person should know; ERROR if it does not work; STALE if what is known of
            it is old, because it is not there or silent.
        message: One sentence for people.
        values: What a person may want to see, by name.
    """

    level: bytes
    message: str
    values: Mapping[str, object] = field(default_factory=dict)


class Diagnostics:
    """Publisher of the health of a node's parts, each as a status named `<node>: <part>`.

    Args:
        node: Node that publishes; its name includes the namespace, without the first slash.
        hardware_id: What the node stands for, as the standard tools show it.
        parts: Functions that return the health of a part, by the part's name.
    """

    def __init__(
        self, node: Node, hardware_id: str, parts: Mapping[str, Callable[[], Health]]
    ) -> None:
        self._node = node
        self._hardware_id = hardware_id
        self._parts = parts
        self._publisher = interfaces.DIAGNOSTICS.publisher(node)
        # On a steady clock: simulated time that stands must not hide a fault.
        self._timer = node.create_timer(PERIOD, self.publish, clock=STEADY_CLOCK)

    def publish(self) -> None:
        """Publish the health of every part."""
        message = DiagnosticArray()
        message.header.stamp = self._node.get_clock().now().to_msg()
        name = self._node.get_fully_qualified_name().removeprefix("/")
        for part, health_of in self._parts.items():
            health = health_of()
            message.status.append(
                DiagnosticStatus(
                    level=health.level,
                    name=f"{name}: {part}",
                    message=health.message,
                    hardware_id=self._hardware_id,
                    values=[KeyValue(key=k, value=str(v)) for k, v in health.values.items()],
                )
            )
        self._publisher.publish(message)


def other_publishers(node: Node, topic: str) -> list[str]:
    """Return the full names of the other nodes that publish a topic of which a node has a publisher.

    Another node may have the same full name. One that was only just discovered has none yet.
    """
    found = node.get_publishers_info_by_topic(node.resolve_topic_name(topic))
    names = [
        f"{info.node_namespace.rstrip('/')}/{info.node_name}"
        for info in found
        if info.node_name != _UNKNOWN
    ]
    own = node.get_fully_qualified_name()
    if own in names:
        names.remove(own)
    return sorted(names)
