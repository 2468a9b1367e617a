"""The public topics, from the executor's thread to that of the page."""

from __future__ import annotations

import contextlib
import queue
import time
from collections import deque
from functools import partial
from typing import Any

from rclpy.node import Node
from rclpy.serialization import deserialize_message

from mobo_tuner.page.board import Board
from mobo_tuner.ros import interfaces

TOPICS = (
    interfaces.STATUS,
    interfaces.PROBLEM,
    interfaces.EVALUATION,
    interfaces.MACHINE_SETPOINT,
    interfaces.MACHINE_READBACKS,
    interfaces.RECORDER_STATUS,
    interfaces.DIAGNOSTICS,
)


class Feed:
    """Messages that wait to be shown.

    Of the front, by far the largest message, only the newest one is kept and read.

    Args:
        node: Node that subscribes.
    """

    def __init__(self, node: Node) -> None:
        self._waiting: queue.SimpleQueue[tuple[str, Any, float]] = queue.SimpleQueue()
        self._front: deque[bytes] = deque(maxlen=1)  # the newest one, serialised
        for topic in TOPICS:
            topic.subscription(node, partial(self._put, topic.name))
        interfaces.PARETO_FRONT.subscription(node, self._put_front, raw=True)

    def _put(self, topic: str, message: Any) -> None:
        self._waiting.put((topic, message, time.monotonic()))

    def _put_front(self, message: bytes) -> None:
        self._front.append(message)

    def move_to(self, board: Board) -> None:
        """Have a board take over all messages that wait."""
        with contextlib.suppress(queue.Empty):
            while True:
                board.take(*self._waiting.get_nowait())
        if self._front:
            front = deserialize_message(self._front.pop(), interfaces.PARETO_FRONT.kind)
            board.take(interfaces.PARETO_FRONT.name, front, time.monotonic())
