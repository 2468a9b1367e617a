"""The double that laboratories test their clients with, and that the tuner's tests use."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator

import pytest
from action_msgs.msg import GoalStatus
from rclpy.node import Node

from mobo_msgs_py import msg
from mobo_msgs_py.action import ApplySetpoint, EvaluateSetpoint
from mobo_msgs_py.srv import DescribeMachine
from mobo_tuner.machine.double import Answer, MachineDouble
from tests.support.tuner import GoalClient, machine_client

RESULT = EvaluateSetpoint.Result
Spin = Callable[..., None]


@pytest.fixture
def machine(node: Node) -> Iterator[MachineDouble]:
    machine = MachineDouble(
        node, {"q": (-1.0, 1.0)}, ["size"], lambda goal: Answer({"size": (float(goal.index), 0.1)})
    )
    yield machine
    machine.close()


def evaluate(client: GoalClient, index: int) -> None:
    setpoint = [msg.NamedValue(name="q", value=0.5)]
    client.send(EvaluateSetpoint.Goal(run_id="run", index=index, setpoint=setpoint))


def test_it_answers_as_the_test_says(machine: MachineDouble, node: Node, spin_until: Spin) -> None:
    client = machine_client(node, spin_until)
    evaluate(client, 3)
    result = client.wait()
    assert (result.run_id, result.index, result.error_code) == ("run", 3, RESULT.NONE)
    (size,) = result.diagnostics
    assert (size.name, size.value, size.stddev) == ("size", 3.0, 0.1)
    machine.answer = lambda _: Answer({"size": 1.0}, RESULT.TIMEOUT, "too late")
    evaluate(client, 4)
    result = client.wait()
    assert (result.error_code, result.error_msg) == (RESULT.TIMEOUT, "too late")
    assert math.isnan(result.diagnostics[0].stddev)
    assert [goal.index for goal in machine.goals] == [3, 4]
    mover = GoalClient(node, spin_until, ApplySetpoint, "apply_setpoint")
    mover.send(ApplySetpoint.Goal())
    assert mover.wait().readbacks[0].value == machine.position["q"] == 0.5


def test_it_is_held_until_it_is_canceled(
    machine: MachineDouble, node: Node, spin_until: Spin
) -> None:
    client = machine_client(node, spin_until)
    machine.held = True
    evaluate(client, 0)
    spin_until(lambda: client.feedback, "feedback")
    client.cancel()
    assert client.wait().error_code == RESULT.CANCELED
    assert client.result is not None
    assert client.result.result().status == GoalStatus.STATUS_CANCELED


def test_it_is_silent_as_long_as_the_test_says(
    machine: MachineDouble, node: Node, spin_until: Spin
) -> None:
    client = machine_client(node, spin_until)
    machine.silent = True
    evaluate(client, 0)
    spin_until(lambda: machine.goals, "the goal")
    client.cancel()
    assert not client.feedback
    machine.silent = False
    assert client.wait().error_code == RESULT.CANCELED
    assert not client.feedback


def test_it_describes_itself(machine: MachineDouble, node: Node, spin_until: Spin) -> None:
    del machine
    describe = node.create_client(DescribeMachine, "describe_machine")
    spin_until(describe.service_is_ready, "the service")
    answer = describe.call_async(DescribeMachine.Request())
    spin_until(answer.done, "the description")
    assert [(v.name, v.min, v.max) for v in answer.result().variables] == [("q", -1.0, 1.0)]
    assert [d.name for d in answer.result().diagnostics] == ["size"]
