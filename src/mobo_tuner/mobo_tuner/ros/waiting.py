"""Waiting inside coroutines of an executor: for a condition, or for whichever comes first."""

from __future__ import annotations

import time
from collections.abc import Callable

from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from rclpy.qos import QoSCompatibility, qos_check_compatible
from rclpy.task import Future

STEADY_CLOCK = Clock(clock_type=ClockType.STEADY_TIME)
"""Clock of everything that people and processes wait for: it runs also when simulated time stands."""


async def first_of(node: Node, *futures: Future, timeout: float) -> Future | None:
    """Return the first of `futures` that is done, or None after `timeout` seconds."""
    signal: Future = Future(executor=node.executor)

    def notify(*_: object) -> None:
        if not signal.done():
            signal.set_result(None)

    for future in futures:
        if future.done():
            return future
        future.add_done_callback(notify)
    timer = node.create_timer(timeout, notify, clock=STEADY_CLOCK)
    try:
        await signal
    finally:
        node.destroy_timer(timer)
    return next((future for future in futures if future.done()), None)


async def until(
    node: Node,
    condition: Callable[[], bool],
    *futures: Future,
    timeout: float,
    period: float = 0.05,
) -> bool:
    """Wait for `condition` to hold, or for one of `futures` to be done, or for the timeout.

    Returns:
        Whether the condition held in the end; it is looked at every `period` seconds.
    """
    deadline = time.monotonic() + timeout
    while not condition():
        if time.monotonic() >= deadline or any(future.done() for future in futures):
            return False
        await first_of(node, *futures, timeout=period)
    return True


def unmatched_topics(node: Node) -> list[str]:
    """Return the topics of a node that would lose a message now.

    The graph shows a subscriber of each that the publisher has not been matched with yet. One with an
    incompatible quality of service never is, and does not count.
    """
    return [
        publisher.topic
        for publisher in node.publishers
        if publisher.get_subscription_count() < node.count_subscribers(publisher.topic)
        and publisher.get_subscription_count()
        < sum(
            qos_check_compatible(publisher.qos_profile, subscriber.qos_profile)[0]
            != QoSCompatibility.ERROR
            for subscriber in node.get_subscriptions_info_by_topic(publisher.topic)
        )
    ]
