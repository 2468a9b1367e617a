"""Clients of the tuner and of a machine, in plain rclpy, and a machine that answers as it is told."""

from __future__ import annotations

import math
import time
import uuid
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from action_msgs.srv import CancelGoal
from rcl_interfaces.srv import GetParameterTypes, SetParametersAtomically
from rclpy.action import ActionClient
from rclpy.client import Client
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.task import Future
from std_srvs.srv import Trigger

from mobo_msgs_py.action import EvaluateSetpoint, Tune
from mobo_tuner.machine.double import Answer, MachineDouble
from mobo_tuner.runs.journal import read_journal
from tests.support.processes import TIMEOUT

CONFIG = Path(__file__).parents[2] / "config"
# The injector with two objectives in which every point is good, so that there is a front at once.
EASY = """
/**:
  ros__parameters:
    variables:
      K1:   {min: 400.0, max: 550.0, unit: A}
      K2:   {min: 180.0, max: 280.0, unit: A}
      phi1: {min: -10.0, max: 0.0, unit: deg}
      phi2: {min: -10.0, max: 0.0, unit: deg}
      G1:   {min: 60.0, max: 75.0, unit: MV/m}
      G2:   {min: 15.0, max: 25.0, unit: MV/m}
    objectives:
      eps_x: {reference: 1.0e+6, unit: mm mrad}
      dE:    {reference: 1.0e+3, unit: MeV}
"""
Spin = Callable[..., None]


def meet(probe: Client, request: Any, spin_until: Spin) -> None:
    """Wait until a server knows of all the clients that were made before `probe`.

    Client and server discover each other in their own time, and a server drops the answer to a
    client that it has not discovered yet. So the server is asked what does no harm, until it answers.
    """
    spin_until(probe.service_is_ready, f"the service {probe.srv_name}")
    deadline = time.monotonic() + TIMEOUT
    while time.monotonic() < deadline:
        answer = probe.call_async(request)
        again = time.monotonic() + 1.0
        spin_until(lambda: answer.done() or time.monotonic() > again, "")  # noqa: B023
        if answer.done():
            return
        probe.remove_pending_request(answer)
    pytest.fail(f"waited {TIMEOUT:g} s in vain for an answer on '{probe.srv_name}'")


class GoalClient:
    """Sends goals to one action and waits for what comes back."""

    def __init__(self, node: Node, spin_until: Spin, action: type, name: str) -> None:
        self._client = ActionClient(node, action, name)
        # Made last: a server that answers it has discovered all of the action client.
        self._probe = node.create_client(CancelGoal, f"{name}/_action/cancel_goal")
        self._spin_until = spin_until
        self._name = name
        self.feedback: list[Any] = []
        self.result: Future | None = None
        self.handle: Any = None

    def send(self, goal: Any) -> None:
        """Send a goal and wait until it is accepted."""
        self._spin_until(self._client.server_is_ready, f"the server of {self._name}")
        nobodys = CancelGoal.Request()
        nobodys.goal_info.goal_id.uuid = list(uuid.uuid4().bytes)
        meet(self._probe, nobodys, self._spin_until)
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


class Services:
    """Calls services of a node by their type and name, and sets the tuner's parameters."""

    def __init__(self, node: Node, spin_until: Spin, of: str = "tuner") -> None:
        self._node = node
        self._spin_until = spin_until
        self._of = of

    def call(self, kind: Any, name: str, request: Any = None, timeout: float = 30.0) -> Any:
        """The response of one call."""
        client = self._node.create_client(kind, name)
        probe = self._node.create_client(GetParameterTypes, f"{self._of}/get_parameter_types")
        self._spin_until(client.service_is_ready, f"the service {name}")
        meet(probe, GetParameterTypes.Request(), self._spin_until)
        self._node.destroy_client(probe)
        future = client.call_async(kind.Request() if request is None else request)
        self._spin_until(future.done, f"the answer of {name}", timeout)
        self._node.destroy_client(client)
        return future.result()

    def trigger(self, name: str) -> Any:
        """The response of one of the tuner's triggers."""
        return self.call(Trigger, name)

    def set(self, **values: Any) -> Any:
        """Set parameters of the tuner at once; `__` stands for a dot. Gives the result."""
        parameters = [
            Parameter(name.replace("__", "."), value=value).to_parameter_msg()
            for name, value in values.items()
        ]
        request = SetParametersAtomically.Request(parameters=parameters)
        return self.call(SetParametersAtomically, "tuner/set_parameters_atomically", request).result


class Listener:
    """Keeps every message of one topic."""

    def __init__(self, node: Node, kind: type, topic: str, qos: Any) -> None:
        self.messages: list[Any] = []
        self.subscription = node.create_subscription(kind, topic, self.messages.append, qos)


def journal(tmp_path: Path, run_id: str) -> list[dict[str, Any]]:
    """The records of a run."""
    return read_journal(tmp_path / "runs" / run_id)


def evaluated(tmp_path: Path, run_id: str) -> list[dict[str, Any]]:
    """The records of the evaluations of a run."""
    return [record for record in journal(tmp_path, run_id) if record["type"] == "evaluation"]


def toy_values(goal: EvaluateSetpoint.Goal) -> dict[str, float]:
    """The paper's toy problem, Eq. (5) (eqn:toy_problem)."""
    x = {item.name: item.value for item in goal.setpoint}
    return {
        "f1": math.hypot(x["x1"] - 1.0, x["x2"] - 1.0),
        "f2": math.hypot(x["x1"] + 1.0, x["x2"] + 1.0),
    }


def toy_machine(
    node: Node,
    answer: Callable[[EvaluateSetpoint.Goal], Answer] = lambda goal: Answer(toy_values(goal)),
) -> MachineDouble:
    """A double of the toy problem's machine, which measures what the problem says or `answer`."""
    return MachineDouble(node, dict.fromkeys(("x1", "x2"), (-2.0, 2.0)), ("f1", "f2"), answer)
