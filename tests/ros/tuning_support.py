"""Clients of the tuner and of a machine, in plain rclpy, and a machine that answers as it is told."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from rclpy.action import ActionClient, ActionServer, CancelResponse
from rclpy.node import Node
from rclpy.task import Future

from mobo_msgs_py import msg
from mobo_msgs_py.action import EvaluateSetpoint, Tune
from mobo_msgs_py.srv import DescribeMachine

CONFIG = Path(__file__).parents[2] / "config"
Spin = Callable[..., None]


class GoalClient:
    """Sends goals to one action and waits for what comes back."""

    def __init__(self, node: Node, spin_until: Spin, action: type, name: str) -> None:
        self._client = ActionClient(node, action, name)
        self._spin_until = spin_until
        self._name = name
        self.feedback: list[Any] = []
        self.result: Future | None = None
        self.handle: Any = None

    def send(self, goal: Any) -> None:
        """Send a goal and wait until it is accepted."""
        self._spin_until(self._client.server_is_ready, f"the server of {self._name}")
        sent = self._client.send_goal_async(
            goal, feedback_callback=lambda message: self.feedback.append(message.feedback)
        )
        self._spin_until(sent.done, "the answer to a goal")
        self.handle = sent.result()
        assert self.handle.accepted
        self.result = self.handle.get_result_async()

    def cancel(self) -> None:
        """Ask to cancel the goal sent last."""
        self.handle.cancel_goal_async()

    def wait(self, timeout: float = 30.0) -> Any:
        """The result of the goal sent last."""
        assert self.result is not None
        self._spin_until(self.result.done, f"the result of {self._name}", timeout)
        return self.result.result().result


def tune_client(node: Node, spin_until: Spin) -> GoalClient:
    """A client of the `tune` action."""
    return GoalClient(node, spin_until, Tune, "tune")


def machine_client(node: Node, spin_until: Spin) -> GoalClient:
    """A client of the `evaluate_setpoint` action."""
    return GoalClient(node, spin_until, EvaluateSetpoint, "evaluate_setpoint")


Answerer = Callable[[EvaluateSetpoint.Goal], tuple[Mapping[str, float], int, str]]


class ScriptedMachine:
    """A machine of the toy problem's shape, written against the interface package alone.

    `answer` gives, for a goal, the diagnostics, the error code and the error message.
    """

    def __init__(self, node: Node, answer: Answerer) -> None:
        self.answer = answer
        self.goals: list[EvaluateSetpoint.Goal] = []
        node.create_service(DescribeMachine, "describe_machine", self._describe)
        self._server = ActionServer(
            node,
            EvaluateSetpoint,
            "evaluate_setpoint",
            self._execute,
            cancel_callback=lambda _: CancelResponse.ACCEPT,
        )

    @staticmethod
    def _describe(
        _: DescribeMachine.Request, response: DescribeMachine.Response
    ) -> DescribeMachine.Response:
        response.name = "scripted"
        response.variables = [msg.Variable(name=n, min=-2.0, max=2.0) for n in ("x1", "x2")]
        response.diagnostics = [msg.Observable(name=n) for n in ("f1", "f2")]
        return response

    def _execute(self, handle: Any) -> EvaluateSetpoint.Result:
        goal = handle.request
        self.goals.append(goal)
        values, code, text = self.answer(goal)
        result = EvaluateSetpoint.Result(
            run_id=goal.run_id,
            index=goal.index,
            attempt=goal.attempt,
            error_code=code,
            error_msg=text,
        )
        result.readbacks = list(goal.setpoint)
        result.diagnostics = [
            msg.NamedValue(name=n, value=v, stddev=math.nan) for n, v in values.items()
        ]
        if code == EvaluateSetpoint.Result.NONE:
            handle.succeed()
        else:
            handle.abort()
        return result


def toy_values(goal: EvaluateSetpoint.Goal) -> dict[str, float]:
    """The paper's toy problem, Eq. (eqn:toy_problem)."""
    x = {item.name: item.value for item in goal.setpoint}
    return {
        "f1": math.hypot(x["x1"] - 1.0, x["x2"] - 1.0),
        "f2": math.hypot(x["x1"] + 1.0, x["x2"] + 1.0),
    }
