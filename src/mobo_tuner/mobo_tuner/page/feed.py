"""The public topics, from the executor's thread to that of the page."""

from __future__ import annotations

import contextlib
import queue
import time
from functools import partial
from typing import Any

from rclpy.node import Node

from mobo_tuner.page.board import Board
from mobo_tuner.ros import interfaces

TOPICS = (
    interfaces.STATUS,
    interfaces.PROBLEM,
    interfaces.EVALUATION,
    interfaces.PARETO_FRONT,
    interfaces.MACHINE_SETPOINT,
    interfaces.MACHINE_READBACKS,
    interfaces.RECORDER_STATUS,
    interfaces.DIAGNOSTICS,
)


class Feed:
    """Messages that wait to be shown.

    Args:
        node: Node that subscribes.
    """

    def __init__(self, node: Node) -> None:
        self._waiting: queue.SimpleQueue[tuple[str, Any, float]] = queue.SimpleQueue()
        for topic in TOPICS:
            topic.subscription(node, partial(self._put, topic.name))

    def _put(self, topic: str, message: Any) -> None:
        self._waiting.put((topic, message, time.monotonic()))

    def move_to(self, board: Board) -> None:
        """Have a board take over all messages that wait."""
        with contextlib.suppress(queue.Empty):
            while True:
                board.take(*self._waiting.get_nowait())
