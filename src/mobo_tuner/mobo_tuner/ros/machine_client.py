"""The machine as the tuner sees it: one evaluation at a time, never waited for without end."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

from builtin_interfaces.msg import Time
from rclpy.action import ActionClient
from rclpy.node import Node
from rclpy.task import Future

from mobo_msgs_py.action import EvaluateSetpoint
from mobo_msgs_py.srv import DescribeMachine
from mobo_tuner.core.problem import Problem
from mobo_tuner.ros.conversions import measurements_of, named_values, problem_units, values_of
from mobo_tuner.ros.waiting import first_of, until

CANCEL_TIMEOUT = 0.6  # [s] for the machine to confirm that it stopped

FeedbackCallback = Callable[[EvaluateSetpoint.Feedback], None]


class MachineLostError(Exception):
    """The machine does not answer; the message is one sentence for the user."""


@dataclass(frozen=True)
class Answer:
    """What became of one evaluation; the fields are those of `EvaluateSetpoint.Result`."""

    error_code: int
    error_msg: str
    stamp: Time
    readbacks: dict[str, float] = field(default_factory=dict)
    diagnostics: dict[str, tuple[float, float]] = field(default_factory=dict)
    machine_seconds: float = 0.0


class MachineClient:
    """Client of `describe_machine` and `evaluate_setpoint`.

    Args:
        node: on whose executor every coroutine here runs.
        silence_timeout: how long the machine may say nothing before it counts as lost [s].
        evaluation_timeout: how long one evaluation may take [s].
    """

    def __init__(self, node: Node, silence_timeout: float, evaluation_timeout: float) -> None:
        self._node = node
        self._silence_timeout = silence_timeout
        self._evaluation_timeout = evaluation_timeout
        self._describe = node.create_client(DescribeMachine, "describe_machine")
        self._evaluate = ActionClient(node, EvaluateSetpoint, "evaluate_setpoint")
        self._heard = 0.0  # when the machine was last heard, time.monotonic()

    async def describe(self, interrupt: Future, timeout: float) -> DescribeMachine.Response | None:
        """Wait for the machine and ask what it can do; None when interrupted.

        Raises:
            MachineLostError: none answered within `timeout` seconds.
        """

        def ready() -> bool:
            return self._describe.service_is_ready() and self._evaluate.server_is_ready()

        deadline = time.monotonic() + timeout
        if await until(self._node, ready, interrupt, timeout=timeout):
            while time.monotonic() < deadline and not interrupt.done():
                # A request sent right after discovery may be lost, so it is asked again.
                request = self._describe.call_async(DescribeMachine.Request())
                done = await first_of(self._node, request, interrupt, timeout=1.0)
                if done is request:
                    return request.result()
                self._describe.remove_pending_request(request)
        if interrupt.done():
            return None
        raise MachineLostError(
            f"no machine answered on '{self._describe.srv_name}' within {timeout:g} s"
        )

    async def evaluate(
        self,
        problem: Problem,
        run_id: str,
        index: int,
        setpoint: Mapping[str, float],
        shots: int,
        interrupt: Future,
        on_feedback: FeedbackCallback,
    ) -> Answer:
        """Have one set-point evaluated; when `interrupt` is done the machine is told to stop.

        Raises:
            MachineLostError: it refused the goal, fell silent or took too long.
        """
        goal = EvaluateSetpoint.Goal(
            run_id=run_id,
            index=index,
            setpoint=named_values(setpoint, problem_units(problem)),
            shots=shots,
        )
        self._heard = time.monotonic()

        def heard(message: Any) -> None:
            self._heard = time.monotonic()
            on_feedback(message.feedback)

        sent = self._evaluate.send_goal_async(goal, feedback_callback=heard)
        if await self._answered(sent, interrupt) is None:
            # The goal may be accepted after all: whoever is told so must stop it.
            sent.add_done_callback(self._cancel_late)
            return self._canceled()
        handle = sent.result()
        if not handle.accepted:
            raise MachineLostError("the machine refused the goal without a reason")
        finished = handle.get_result_async()
        try:
            if await self._answered(finished, interrupt) is None:
                handle.cancel_goal_async()
                await first_of(self._node, finished, timeout=CANCEL_TIMEOUT)
                return self._answer(finished, goal) if finished.done() else self._canceled()
        except MachineLostError:
            handle.cancel_goal_async()
            raise
        return self._answer(finished, goal)

    async def _answered(self, future: Future, interrupt: Future) -> Future | None:
        """Wait for `future`; None when interrupted."""
        started = time.monotonic()
        while True:
            patience = min(self._heard + self._silence_timeout, started + self._evaluation_timeout)
            remaining = patience - time.monotonic()
            if remaining <= 0.0:
                waited = time.monotonic() - self._heard
                if waited < self._silence_timeout:
                    raise MachineLostError(
                        f"the evaluation did not end within {self._evaluation_timeout:g} s"
                    )
                raise MachineLostError(f"the machine has been silent for {waited:.1f} s")
            done = await first_of(self._node, future, interrupt, timeout=remaining)
            if done is future:
                return future
            if done is interrupt:
                return None

    def _answer(self, finished: Future, goal: EvaluateSetpoint.Goal) -> Answer:
        result: EvaluateSetpoint.Result = finished.result().result
        if (result.run_id, result.index) != (goal.run_id, goal.index):
            raise MachineLostError(
                f"the machine answered for evaluation {result.index} of run '{result.run_id}', "
                f"not for {goal.index} of '{goal.run_id}'"
            )
        return Answer(
            error_code=result.error_code,
            error_msg=result.error_msg,
            stamp=result.stamp,
            readbacks=values_of(result.readbacks),
            diagnostics=measurements_of(result.diagnostics),
            machine_seconds=result.machine_seconds,
        )

    def _canceled(self) -> Answer:
        return Answer(
            EvaluateSetpoint.Result.CANCELED,
            "the evaluation was stopped",
            self._node.get_clock().now().to_msg(),
        )

    @staticmethod
    def _cancel_late(sent: Future) -> None:
        if not sent.cancelled() and sent.exception() is None and sent.result().accepted:
            sent.result().cancel_goal_async()
