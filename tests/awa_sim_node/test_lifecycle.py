"""The simulated machine's life: what each state allows."""

from __future__ import annotations

import math
import signal
from collections.abc import Callable
from typing import Any

from lifecycle_msgs.srv import GetState
from rclpy.node import Node
from std_msgs.msg import Float64

from mobo_msgs_py.action import EvaluateSetpoint
from mobo_msgs_py.srv import DescribeMachine
from mobo_tuner.ros.qos import STREAM
from tests.support.processes import NodeStarter
from tests.support.simulator import (
    ACTIVATE,
    CLEANUP,
    CONFIGURE,
    DEACTIVATE,
    SHUTDOWN,
    Services,
    evaluation_goal,
    start_machine,
)
from tests.support.tuner import machine_client

RESULT = EvaluateSetpoint.Result
POINT = {"x1": 1.0, "x2": -1.0}
# A measurement of the toy problem that takes ten seconds of wall time.
SLOW: dict[str, Any] = {"model": "toy", "mode": "ideal", "speed": 1.0, "beam_repetition_rate": 10.0}


def test_each_state_allows_what_it_should(
    start_node: NodeStarter, node: Node, spin_until: Callable[..., None]
) -> None:
    process = start_machine(start_node, autostart=False, **SLOW)
    services = Services(node, spin_until)
    client = machine_client(node, spin_until)

    def state() -> str:
        return str(services.call(GetState, "awa_sim/get_state").current_state.label)

    def refused(index: int) -> str:
        client.send(evaluation_goal(POINT, index=index, shots=1))
        result = client.wait()
        assert result.error_code == RESULT.NOT_ACTIVE
        assert len(result.diagnostics) == 0
        return str(result.error_msg)

    assert state() == "unconfigured"
    description = services.call(DescribeMachine, "describe_machine")
    assert [variable.name for variable in description.variables] == ["x1", "x2"]
    assert refused(0) == "the machine's node is not configured; nothing may move"
    assert services.change_state(CONFIGURE)
    assert (state(), refused(0)) == (
        "inactive",
        "the machine's node is not active; nothing may move",
    )
    assert services.change_state(ACTIVATE)
    for impossible in (ACTIVATE, CONFIGURE, CLEANUP, 200):
        assert not services.change_state(impossible)
    assert state() == "active"
    client.send(evaluation_goal(POINT, index=0, shots=1))
    assert client.wait().error_code == RESULT.NONE

    client.send(evaluation_goal(POINT, index=1, shots=100))
    spin_until(lambda: any(f.fraction > 0.02 for f in client.feedback), "some shots")
    assert services.change_state(DEACTIVATE)
    result = client.wait()
    assert result.error_code == RESULT.NOT_ACTIVE
    assert result.error_msg == "the machine's node was deactivated"
    assert 0 < result.shots < 100
    assert {d.name: d.value for d in result.diagnostics}["g"] == 1.0
    assert "was deactivated" in refused(2)

    assert services.change_state(CLEANUP)
    assert refused(2) == "the machine's node is not configured; nothing may move"
    client.send(evaluation_goal(POINT, index=2))
    assert all(math.isnan(item.value) for item in client.wait().readbacks)
    assert services.change_state(CONFIGURE)
    assert services.change_state(ACTIVATE)
    client.send(evaluation_goal(POINT, index=2, shots=1))
    assert client.wait().error_code == RESULT.NONE
    assert services.change_state(DEACTIVATE)
    assert services.change_state(SHUTDOWN)
    assert state() == "finalized"
    assert "was shut down" in refused(3) or "not configured" in refused(3)
    assert process.stop(signal.SIGTERM) == 0
    assert "Traceback" not in process.stderr


def test_a_device_does_not_move_before_the_node_is_active(
    start_node: NodeStarter, node: Node, spin_until: Callable[..., None]
) -> None:
    process = start_machine(start_node, autostart=False, **SLOW)
    services = Services(node, spin_until)
    assert services.change_state(CONFIGURE)
    publisher = node.create_publisher(Float64, "x1/setpoint", STREAM)
    spin_until(lambda: publisher.get_subscription_count() == 1, "the machine")
    publisher.publish(Float64(data=1.5))
    refusal = "set-point x1 = 1.5 is refused: the machine's node is not active; nothing may move"
    spin_until(lambda: refusal in process.stderr, "the refusal")
