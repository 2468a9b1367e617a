"""Action server: refusals with a reason, explicit cancels, and one place for conclusions."""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from typing import Any

from rclpy.action import ActionServer, CancelResponse, GoalResponse
from rclpy.action.server import ServerGoalHandle
from rclpy.node import Node

from mobo_tuner.errors import one_line

# [s] a result is kept, as long as a machine waits for a silent client by default: every status message
# lists all goals that are kept, and takes the longer to read.
RESULT_TIMEOUT = 5
FAULT = 255  # error code of an unforeseen exception: UNKNOWN or INTERNAL in the action


class Goal:
    """Goal that a `GoalServer` serves.

    Attributes:
        request: Message that the client sent.
    """

    def __init__(self, handle: ServerGoalHandle, feedback: Callable[..., Any]) -> None:
        self.request: Any = handle.request
        self._handle = handle
        self._feedback = feedback
        self._cancel: Callable[[], None] = lambda: None

    @property
    def id(self) -> bytes:
        """Unique identifier that the client gave the goal."""
        return bytes(self._handle.goal_id.uuid)

    @property
    def canceled(self) -> bool:
        """Whether a client asked to cancel the goal, which has not ended yet."""
        return bool(self._handle.is_cancel_requested)

    def on_cancel(self, callback: Callable[[], None]) -> None:
        """Set the function for a cancel, and call it now if the goal is already canceled.

        Args:
            callback: Function that interrupts the work on the goal and returns at once.
        """
        self._cancel = callback
        if self.canceled:
            callback()

    def cancel(self) -> None:
        """Interrupt the work on the goal."""
        self._cancel()

    def publish_feedback(self, **fields: Any) -> None:
        """Send the client a feedback message with these fields."""
        self._handle.publish_feedback(self._feedback(**fields))


class GoalServer:
    """Action server that concludes each goal by the `error_code` of its result.

    Every goal is accepted, because ROS rejects goals without a reason: a goal that cannot be served is
    aborted with the reason in `error_msg`. `execute` decides whether another goal prevents it, because
    several actions may move the same machine. `NONE` concludes a goal as succeeded, `CANCELED` as
    canceled if its client requested that, every other code as aborted.

    Args:
        node: Node that serves the action; its executor runs `execute`.
        action: Action type whose result has `error_code` and `error_msg`, with the constants `NONE`
            and `CANCELED`.
        name: Name of the action.
        execute: Coroutine function that serves a goal and returns the action's result.
    """

    def __init__(
        self, node: Node, action: Any, name: str, execute: Callable[[Goal], Awaitable[Any]]
    ) -> None:
        self._log = node.get_logger()
        self._action = action
        self._name = name
        self._execute = execute
        self._goals: dict[bytes, Goal] = {}
        self._server = ActionServer(
            node,
            action,
            name,
            execute_callback=self._serve,
            goal_callback=lambda _: GoalResponse.ACCEPT,
            cancel_callback=self._cancel,
            result_timeout=RESULT_TIMEOUT,
        )

    def close(self) -> None:
        """Stop serving the action; the node stays."""
        self._server.destroy()

    def _cancel(self, handle: ServerGoalHandle) -> CancelResponse:
        goal = self._goals.get(bytes(handle.goal_id.uuid))
        if goal is not None:  # otherwise it has not started, and `on_cancel` handles the cancel
            goal.cancel()
        return CancelResponse.ACCEPT

    async def _serve(self, handle: ServerGoalHandle) -> Any:
        goal = Goal(handle, self._action.Feedback)
        self._goals[goal.id] = goal
        try:
            result = await self._execute(goal)
        except Exception as error:  # rclpy would send a result without an error code
            result = self._action.Result(
                error_code=FAULT, error_msg=one_line(f"{type(error).__name__}: {error}")
            )
        finally:
            del self._goals[goal.id]
        codes = self._action.Result
        if result.error_code == codes.NONE:
            handle.succeed()
        elif result.error_code == codes.CANCELED and goal.canceled:
            handle.canceled()
        else:
            self._log.warning(f"{self._name}: {result.error_msg}")
            handle.abort()
        return result
