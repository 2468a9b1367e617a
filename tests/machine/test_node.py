"""A machine of one's own that `serve` serves: its node's life, and all the safety, over real DDS."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from diagnostic_msgs.msg import DiagnosticArray
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState, GetState
from rclpy.node import Node

from mobo_msgs_py import msg
from mobo_msgs_py.action import ApplySetpoint, EvaluateSetpoint, Tune
from mobo_tuner.ros.qos import STREAM
from tests.support.processes import NodeProcess, NodeStarter
from tests.support.tuner import GoalClient, Listener, Services, machine_client, toy_machine

EXAMPLE = Path(__file__).parents[2] / "examples" / "served_machine.py"
RESULT = EvaluateSetpoint.Result
Spin = Callable[..., None]


def goal(x1: float, x2: float, index: int = 0, **fields: Any) -> EvaluateSetpoint.Goal:
    return EvaluateSetpoint.Goal(run_id="run", index=index, setpoint=point(x1, x2), **fields)


def point(x1: float, x2: float) -> list[msg.NamedValue]:
    return [msg.NamedValue(name="x1", value=x1), msg.NamedValue(name="x2", value=x2)]


def values(named: Any) -> dict[str, float]:
    return {item.name: item.value for item in named}


@pytest.fixture
def start(start_node: NodeStarter, tmp_path: Path) -> Callable[..., NodeProcess]:
    def start(*options: str) -> NodeProcess:
        return start_node(str(EXAMPLE), "--ros-args", *options, TMPDIR=str(tmp_path))

    return start


@pytest.fixture
def machine(node: Node, spin_until: Spin) -> GoalClient:
    return machine_client(node, spin_until)


def said(health: Listener) -> str:
    """What the machine said of itself so far."""
    parts = [status for array in health.messages for status in array.status]
    return " ".join(status.message for status in parts if status.name.endswith(": machine"))


def until_ready(machine: GoalClient) -> None:
    """Until the machine was read for the first time."""
    deadline = time.monotonic() + 20.0
    code = -1
    while code != RESULT.NONE:
        assert time.monotonic() < deadline
        machine.send(EvaluateSetpoint.Goal(setpoint=point(0.0, 0.0)))
        code = machine.wait().error_code


def test_it_has_all_the_safety(
    start: Callable[..., NodeProcess],
    machine: GoalClient,
    node: Node,
    spin_until: Spin,
    tmp_path: Path,
) -> None:
    process = start()
    until_ready(machine)
    mover = GoalClient(node, spin_until, ApplySetpoint, "apply_setpoint")
    machine.send(goal(2.1, 0.0))
    assert machine.wait().error_code == RESULT.INVALID_SETPOINT  # limits

    machine.feedback.clear()
    machine.send(goal(1.0, 0.0, 1))
    result = machine.wait()
    assert (result.error_code, values(result.diagnostics)["f1"]) == (RESULT.NONE, 1.0)
    on_the_way = [values(f.readbacks)["x1"] for f in machine.feedback]
    assert any(0.0 < x < 1.0 for x in on_the_way)  # a ramp, read back

    machine.feedback.clear()
    machine.send(goal(-2.0, 0.0, 2))
    spin_until(lambda: any(values(f.readbacks)["x1"] < 0.9 for f in machine.feedback), "the ramp")
    machine.cancel()
    result = machine.wait()
    assert result.error_code == RESULT.CANCELED
    held = values(result.readbacks)["x1"]
    assert -2.0 < held < 0.9

    limit = msg.Constraint(name="f1", min=-float("inf"), max=0.5)
    machine.send(goal(0.0, 0.0, 3, critical=[limit], if_violated=point(1.0, 1.0)))
    assert machine.wait().error_code == RESULT.VIOLATION
    mover.send(ApplySetpoint.Goal())
    assert values(mover.wait().readbacks) == {"x1": 1.0, "x2": 1.0}

    lost = point(-1.0, -1.0)
    machine.send(goal(0.0, 0.0, 4, shots=10_000, client_timeout=0.5, if_client_lost=lost))
    assert machine.wait().error_code == RESULT.CLIENT_LOST  # nobody sends a heartbeat
    mover.send(ApplySetpoint.Goal())
    assert values(mover.wait().readbacks) == {"x1": -1.0, "x2": -1.0}

    (tmp_path / "no_permit").touch()
    machine.send(goal(0.0, 0.0, 5, shots=10_000))
    result = machine.wait()
    assert result.error_code == RESULT.INTERLOCK
    assert "no_permit forbids to move" in result.error_msg

    (tmp_path / "no_permit").unlink()
    health = Listener(node, DiagnosticArray, "/diagnostics", STREAM)
    toy_machine(node)
    spin_until(lambda: "1 more serve /describe_machine" in said(health), "the second machine")
    assert process.stop() == 0


def test_an_inactive_node_reads_and_moves_nothing(
    start: Callable[..., NodeProcess], machine: GoalClient, node: Node, spin_until: Spin
) -> None:
    process = start("-p", "autostart:=false")
    services = Services(node, spin_until, of="my_machine")

    def change(transition: int) -> bool:
        request = ChangeState.Request(transition=Transition(id=transition))
        return bool(services.call(ChangeState, "my_machine/change_state", request).success)

    def code(x: float) -> int:
        machine.send(EvaluateSetpoint.Goal(setpoint=point(x, 0.0)))
        return int(machine.wait().error_code)

    assert code(1.0) == RESULT.NOT_ACTIVE
    assert change(Transition.TRANSITION_CONFIGURE)
    state = services.call(GetState, "my_machine/get_state").current_state.label
    assert (state, code(1.0)) == ("inactive", RESULT.NOT_ACTIVE)
    mover = GoalClient(node, spin_until, ApplySetpoint, "apply_setpoint")
    mover.send(ApplySetpoint.Goal())
    assert values(mover.wait().readbacks) == {"x1": 0.0, "x2": 0.0}
    assert not change(77)
    assert change(Transition.TRANSITION_ACTIVATE)
    assert code(0.5) == RESULT.NONE

    machine.feedback.clear()
    machine.send(goal(-2.0, 0.0))
    spin_until(lambda: any(values(f.readbacks)["x1"] < 0.4 for f in machine.feedback), "the ramp")
    assert change(Transition.TRANSITION_DEACTIVATE)
    result = machine.wait()
    assert result.error_code == RESULT.NOT_ACTIVE
    assert -2.0 < values(result.readbacks)["x1"] < 0.4
    assert process.stop() == 0


def test_the_tuner_tunes_it(
    start: Callable[..., NodeProcess],
    start_tuner: Callable[..., NodeProcess],
    machine: GoalClient,
    client: GoalClient,
) -> None:
    start()
    until_ready(machine)
    start_tuner("client_timeout:=5.0")
    client.send(Tune.Goal(evaluations=5))
    result = client.wait(60.0)
    assert (result.stop_reason, result.evaluations) == ("budget", 5)
    assert result.pareto_front.hypervolume > 0.0
