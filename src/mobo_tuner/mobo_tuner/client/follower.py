"""Messages of one run, passed to callbacks on the waiting thread."""

from __future__ import annotations

from collections.abc import Callable
from queue import SimpleQueue
from typing import Any

from mobo_tuner.client.connection import Inbox
from mobo_tuner.client.values import (
    Evaluation,
    Front,
    Status,
    evaluation_of,
    front_of,
    problem_of,
    status_of,
)
from mobo_tuner.core.problem import Problem

OnEvaluation = Callable[[Evaluation], object]
OnStatus = Callable[[Status], object]
OnFront = Callable[[Front], object]
OnProblem = Callable[[Problem], object]


class Follower:
    """Messages of one run as calls in the inbox of the waiting thread."""

    def __init__(
        self,
        run_id: str,
        on_evaluation: OnEvaluation | None,
        on_status: OnStatus | None,
        on_front: OnFront | None,
        on_problem: OnProblem | None,
    ) -> None:
        self.inbox: Inbox = SimpleQueue()
        self._run_id = run_id
        self._callbacks: dict[str, tuple[Callable[[Any], object] | None, Callable[[Any], Any]]] = {
            "evaluation": (on_evaluation, evaluation_of),
            "status": (on_status, status_of),
            "pareto_front": (on_front, front_of),
            "problem": (on_problem, problem_of),
        }
        self._seen: set[int] = set()

    def lacks(self, evaluations: int) -> bool:
        """Return whether evaluations are missing that a callback waits for."""
        return self._callbacks["evaluation"][0] is not None and len(self._seen) < evaluations

    def take(self, topic: str, message: Any) -> None:
        """Take a message; an evaluation arrives on its topic and as feedback, and counts once."""
        callback, convert = self._callbacks[topic]
        if callback is None or message.run_id != self._run_id:
            return
        if topic == "evaluation":
            if message.index in self._seen:
                return
            self._seen.add(message.index)
        self.inbox.put(lambda: callback(convert(message)))
