"""Health of a node's parts on `/diagnostics` at 1 Hz, in the form that standard ROS tools expect."""

from __future__ import annotations

import time
from collections import defaultdict
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.node import Node
from rclpy.topic_endpoint_info import TopicEndpointInfo

from mobo_tuner.ros import interfaces
from mobo_tuner.ros.waiting import STEADY_CLOCK

PERIOD = 1.0  # [s]
LEASE = 25.0  # [s] after which a node that was killed has left the graph; that of Fast DDS is 20 s
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


class Publishers:
    """The nodes that publish a topic, without those that were killed.

    A node that was killed stays in the graph until its lease ends. If it is started again before, two nodes of one
    full name seem to be there; so they count as one until both have been there for longer than a lease.

    Args:
        node: Node that looks.
        topic: Name of the topic.
        clock: Clock [s].
    """

    def __init__(self, node: Node, topic: str, clock: Callable[[], float] = time.monotonic) -> None:
        self._node = node
        self._topic = topic
        self._clock = clock
        self._seen: dict[tuple[int, ...], float] = {}  # since when, by the id of the publisher

    def names(self) -> list[str]:
        """Return the full names of all nodes, sorted; one that was only just discovered has none yet."""
        now, ages = self._clock(), defaultdict[str, list[float]](list)
        topic = self._node.resolve_topic_name(self._topic)
        found = self._node.get_publishers_info_by_topic(topic)
        self._seen = {gid: self._seen.get(gid, now) for gid in map(_id_of, found)}
        for info in found:
            if info.node_name != _UNKNOWN:
                name = f"{info.node_namespace.rstrip('/')}/{info.node_name}"
                ages[name].append(now - self._seen[_id_of(info)])
        names: list[str] = []
        for name in sorted(ages):
            names += [name] * max(sum(age > LEASE for age in ages[name]), 1)
        return names

    def others(self) -> list[str]:
        """Return the full names of all nodes but the one that looks, if it publishes the topic, sorted."""
        names, own = self.names(), self._node.get_fully_qualified_name()
        if own in names:
            names.remove(own)
        return names


def _id_of(info: TopicEndpointInfo) -> tuple[int, ...]:
    return (*info.endpoint_gid,)
