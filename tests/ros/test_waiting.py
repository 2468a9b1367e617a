"""Waiting for subscribers, whom a message would miss otherwise."""

from __future__ import annotations

from collections.abc import Callable

from rclpy.node import Node
from std_msgs.msg import Float64

from mobo_tuner.ros.qos import LATCHED, STREAM
from mobo_tuner.ros.waiting import unmatched_topics


def test_a_topic_is_matched_once_every_compatible_subscriber_is_connected(
    node: Node, spin_until: Callable[..., None]
) -> None:
    def subscribers() -> int:
        return int(node.count_subscribers("/figures"))

    publisher = node.create_publisher(Float64, "figures", STREAM)
    assert unmatched_topics(node) == []
    node.create_subscription(Float64, "figures", lambda _: None, STREAM)
    spin_until(lambda: subscribers() == 1 and not unmatched_topics(node), "the subscriber")
    assert publisher.get_subscription_count() == 1
    # One that wants latched messages is never connected, and is not waited for.
    node.create_subscription(Float64, "figures", lambda _: None, LATCHED)
    spin_until(lambda: subscribers() == 2, "the graph")
    assert publisher.get_subscription_count() == 1
    assert unmatched_topics(node) == []
