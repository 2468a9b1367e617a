"""The machine as its client sees it: one thing at a time, each with a timeout."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from rclpy.action import ActionClient
from rclpy.action.client import ClientGoalHandle
from rclpy.node import Node
from rclpy.task import Future

from mobo_msgs_py import msg
from mobo_msgs_py.action import ApplySetpoint, EvaluateSetpoint
from mobo_msgs_py.srv import DescribeMachine
from mobo_tuner.ros import interfaces
from mobo_tuner.ros.conversions import measurements_of, seconds, values_of
from mobo_tuner.ros.waiting import first_of, until

CANCEL_TIMEOUT = 0.6  # [s] for the machine to confirm that it stopped
LET_GO_TIMEOUT = 2.0  # [s] for what was stopped to end, before the machine is asked for more
_ASK_AGAIN = 0.2  # [s] for a machine to know where it is, before it is asked again
_RESULT = EvaluateSetpoint.Result

FeedbackCallback = Callable[[Any], None]


class MachineLostError(Exception):
    """The machine does not answer; the message is one sentence for the user."""


@dataclass(frozen=True)
class Answer:
    """What became of an evaluation or a move; the fields are those of `EvaluateSetpoint.Result`."""

    error_code: int
    error_msg: str
    stamp: float  # when the measurement ended, on the machine's clock [s since the epoch]
    readbacks: dict[str, float] = field(default_factory=dict)
    diagnostics: dict[str, tuple[float, float]] = field(default_factory=dict)
    machine_seconds: float = 0.0


class MachineClient:
    """Client of `describe_machine`, `evaluate_setpoint` and `apply_setpoint`.

    Args:
        node: Node whose executor runs all coroutines of this class.
        silence_timeout: Silence of the machine after which it counts as lost [s].
        evaluation_timeout: Longest time of one evaluation or move [s].
    """

    def __init__(self, node: Node, silence_timeout: float, evaluation_timeout: float) -> None:
        self._node = node
        self._silence_timeout = silence_timeout
        self._evaluation_timeout = evaluation_timeout
        self._stopped: Future | None = None  # the result of what was stopped, until it came
        self._evaluate = interfaces.EVALUATE_SETPOINT.client(node)
        self._apply = interfaces.APPLY_SETPOINT.client(node)
        # Made last: endpoints are discovered in this order, so that a machine that answers this one
        # knows the others, too. It would drop its answers to a client that it does not know yet.
        self._describe = interfaces.DESCRIBE_MACHINE.client(node)

    @property
    def is_there(self) -> bool:
        """Whether a machine serves its description and evaluations."""
        return self._describe.service_is_ready() and self._evaluate.server_is_ready()

    @property
    def action_name(self) -> str:
        """Full name of the action by which the machine evaluates set-points."""
        return str(self._node.resolve_topic_name("evaluate_setpoint"))

    async def describe(
        self, timeout: float, *interrupts: Future
    ) -> DescribeMachine.Response | None:
        """Wait for the machine and ask what it can do; None when interrupted.

        Raises:
            MachineLostError: If none answered within `timeout` seconds.
        """
        deadline = time.monotonic() + timeout
        if await until(self._node, lambda: self.is_there, *interrupts, timeout=timeout):
            while time.monotonic() < deadline and not _any_done(interrupts):
                # A request sent right after discovery may be lost, so it is asked again.
                request = self._describe.call_async(DescribeMachine.Request())
                done = await first_of(self._node, request, *interrupts, timeout=1.0)
                if done is request:
                    return request.result()
                self._describe.remove_pending_request(request)
        if _any_done(interrupts):
            return None
        raise MachineLostError(
            f"no machine answered on '{self._describe.srv_name}' within {timeout:g} s"
        )

    async def evaluate(
        self, goal: EvaluateSetpoint.Goal, on_feedback: FeedbackCallback, *interrupts: Future
    ) -> Answer:
        """Have one set-point evaluated; when one of `interrupts` is done the machine is stopped.

        An answer that is not to this goal is dropped, and counts as an evaluation that failed.

        Raises:
            MachineLostError: If the machine refused the goal, fell silent or took too long.
        """
        what = f"evaluation {goal.index}, attempt {goal.attempt} of run '{goal.run_id}'"
        result = await self._carry_out(self._evaluate, goal, what, on_feedback, interrupts)
        if result is None:
            return self._canceled()
        if (result.run_id, result.index, result.attempt) != (goal.run_id, goal.index, goal.attempt):
            foreign = (
                f"the machine answered for evaluation {result.index}, attempt {result.attempt} of "
                f"run '{result.run_id}', not for {what}"
            )
            self._node.get_logger().warning(f"{foreign}; that answer is dropped")
            return Answer(_RESULT.UNKNOWN, foreign, self._now())
        return Answer(
            error_code=result.error_code,
            error_msg=result.error_msg,
            stamp=seconds(result.stamp),
            readbacks=values_of(result.readbacks),
            diagnostics=measurements_of(result.diagnostics),
            machine_seconds=result.machine_seconds,
        )

    async def apply(
        self,
        goal: ApplySetpoint.Goal,
        on_feedback: FeedbackCallback,
        *interrupts: Future,
        leave: Future | None = None,
    ) -> Answer:
        """Have the machine go to a set-point, ramped and verified.

        Args:
            goal: Set-point with the way there.
            on_feedback: Function that gets the feedback.
            interrupts: Futures; when one of them is done, the machine is stopped.
            leave: Future; when it is done, this returns, and the machine finishes the move by itself.

        Raises:
            MachineLostError: If `evaluate` would raise it, or the machine does not offer the action.
        """
        if not self._apply.server_is_ready():
            raise MachineLostError("the machine does not offer 'apply_setpoint'")
        result = await self._carry_out(self._apply, goal, "a move", on_feedback, interrupts, leave)
        if result is None:
            return self._canceled()
        return Answer(
            result.error_code,
            result.error_msg,
            seconds(result.stamp),
            values_of(result.readbacks),
        )

    async def where(self, *interrupts: Future, patience: float = 0.0) -> dict[str, float] | None:
        """Return the machine's readbacks; nothing moves. Returns None if interrupted.

        It is asked to go nowhere at all; where it refuses that, it says where it is all the same.

        Args:
            interrupts: Futures; when one of them is done, nothing more is asked.
            patience: Time for which a machine that has no readback yet is asked again [s].

        Raises:
            MachineLostError: If it does not answer, or has no readback.
        """
        deadline = time.monotonic() + patience
        while True:
            answer = await self.apply(ApplySetpoint.Goal(), lambda _: None, *interrupts)
            if answer.error_code == _RESULT.CANCELED:
                return None
            where = {n: v for n, v in answer.readbacks.items() if math.isfinite(v)}
            if where:
                return where
            if time.monotonic() >= deadline:
                raise MachineLostError("the machine does not say where it is")
            await first_of(self._node, *interrupts, timeout=_ASK_AGAIN)

    async def send_off(self, goal: ApplySetpoint.Goal, timeout: float) -> bool:
        """Have the machine go to a set-point by itself: only its acceptance is waited for."""
        if not self._apply.server_is_ready():
            return False
        await self._let_go(timeout / 2)
        sent = self._apply.send_goal_async(goal)
        done = await first_of(self._node, sent, timeout=timeout / 2)
        return done is not None and sent.result().accepted

    async def _carry_out(
        self,
        client: ActionClient,
        goal: Any,
        what: str,
        on_feedback: FeedbackCallback,
        interrupts: Sequence[Future],
        leave: Future | None = None,
    ) -> Any:
        """Return the result of a goal; None if it was interrupted and the machine did not say more.

        Raises:
            MachineLostError: If it refused the goal, fell silent or took too long.
        """
        await self._let_go(LET_GO_TIMEOUT, *interrupts)
        if _any_done(interrupts):
            return None
        all_interrupts = interrupts if leave is None else (*interrupts, leave)
        patience = _Patience(self._silence_timeout, self._evaluation_timeout, what)

        def heard(message: Any) -> None:
            if not patience.over:  # what comes later is of no concern
                patience.heard()
                on_feedback(message.feedback)

        sent = client.send_goal_async(goal, feedback_callback=heard)
        try:
            if not await self._answered(sent, patience, all_interrupts):
                return None
            handle = sent.result()
            if not handle.accepted:
                raise MachineLostError("the machine refused the goal without a reason")
            finished = handle.get_result_async()
            try:
                if not await self._answered(finished, patience, all_interrupts):
                    if not _any_done(interrupts):  # it is left
                        return None
                    handle.cancel_goal_async()
                    await first_of(self._node, finished, timeout=CANCEL_TIMEOUT)
                    return finished.result().result if finished.done() else None
            except MachineLostError:
                handle.cancel_goal_async()
                raise
            finally:
                if not finished.done():
                    self._stopped = finished
                    finished.add_done_callback(lambda _: self._drop_late(what))
            return finished.result().result
        finally:
            patience.over = True
            if not sent.done() and (leave is None or _any_done(interrupts)):
                # The goal may be accepted later: its response must then stop it.
                self._stopped = self._cancel_late(sent)

    async def _let_go(self, timeout: float, *interrupts: Future) -> None:
        """Wait for what was stopped to end: until then the machine refuses everything else."""
        if self._stopped is None:
            return
        done = await first_of(self._node, self._stopped, *interrupts, timeout=timeout)
        if done is None or done is self._stopped:
            self._stopped = None

    def _cancel_late(self, sent: Future) -> Future:
        """Stop a goal once it is accepted; the future is done when the goal has ended."""
        ended: Future = Future(executor=self._node.executor)

        def end(_: Future) -> None:
            ended.set_result(None)

        def answered(_: Future) -> None:
            if sent.cancelled() or sent.exception() is not None or not sent.result().accepted:
                ended.set_result(None)
                return
            handle: ClientGoalHandle = sent.result()
            handle.cancel_goal_async()
            handle.get_result_async().add_done_callback(end)

        sent.add_done_callback(answered)
        return ended

    async def _answered(
        self, future: Future, patience: _Patience, interrupts: Sequence[Future]
    ) -> bool:
        """Wait for `future`; False when interrupted.

        Raises:
            MachineLostError: If the time is over.
        """
        while not future.done():
            remaining = patience.remaining()
            done = await first_of(self._node, future, *interrupts, timeout=remaining)
            if done is not None and done is not future:
                return False
        return True

    def _drop_late(self, what: str) -> None:
        self._node.get_logger().warning(f"the answer to {what} came too late and is dropped")

    def _canceled(self) -> Answer:
        return Answer(_RESULT.CANCELED, "the machine was stopped", self._now())

    def _now(self) -> float:
        return seconds(self._node.get_clock().now().to_msg())


class _Patience:
    """How long to wait for the machine yet.

    Attributes:
        over: Whether the wait has ended.
    """

    def __init__(self, silence_timeout: float, whole_timeout: float, what: str) -> None:
        self._silence_timeout = silence_timeout
        self._whole_timeout = whole_timeout
        self._what = what
        self._started = self._heard = time.monotonic()
        self.over = False

    def heard(self) -> None:
        """Note a sign of life of the machine."""
        self._heard = time.monotonic()

    def remaining(self) -> float:
        """Seconds from now.

        Raises:
            MachineLostError: If none are left.
        """
        now = time.monotonic()
        if now - self._heard >= self._silence_timeout:
            raise MachineLostError(f"the machine has been silent for {now - self._heard:.1f} s")
        if now - self._started >= self._whole_timeout:
            raise MachineLostError(f"{self._what} did not end within {self._whole_timeout:g} s")
        return min(
            self._heard + self._silence_timeout - now, self._started + self._whole_timeout - now
        )


def clip_to_limits(
    setpoint: Mapping[str, float], variables: Sequence[msg.Variable]
) -> dict[str, float]:
    """Return readbacks, which may be slightly outside, as a set-point within the machine's limits."""
    return {v.name: min(max(setpoint[v.name], v.min), v.max) for v in variables}


def _any_done(futures: Sequence[Future]) -> bool:
    return any(future.done() for future in futures)
