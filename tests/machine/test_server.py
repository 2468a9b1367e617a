"""What every machine serves, shown on the simulated one: identity, early ends, and lost clients."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from typing import Any

import pytest
from rclpy.node import Node

from mobo_msgs_py import msg
from mobo_msgs_py.action import ApplySetpoint, EvaluateSetpoint
from mobo_tuner.ros.qos import STREAM
from tests.support.processes import NodeProcess, NodeStarter
from tests.support.tuner import GoalClient, machine_client

RESULT = EvaluateSetpoint.Result
# 8 A/s: from the middle, 475 A, to either end takes some nine simulated seconds.
MIDDLE = {"K1": 475.0, "K2": 230.0, "phi1": -5.0, "phi2": -5.0, "G1": 67.5, "G2": 20.0}
FAR = MIDDLE | {"K1": 550.0}
SAFE = MIDDLE | {"K1": 450.0}


@pytest.fixture
def start_machine(start_node: NodeStarter) -> Callable[..., NodeProcess]:
    def start(speed: float) -> NodeProcess:
        options = ("-p", "mode:=ideal", "-p", f"speed:={speed}")
        return start_node("-m", "awa_sim_node.node", "--ros-args", *options)

    return start


@pytest.fixture
def client(node: Node, spin_until: Callable[..., None]) -> GoalClient:
    return machine_client(node, spin_until)


@pytest.fixture
def mover(node: Node, spin_until: Callable[..., None]) -> GoalClient:
    return GoalClient(node, spin_until, ApplySetpoint, "apply_setpoint")


def point(setpoint: dict[str, float]) -> list[msg.NamedValue]:
    return [msg.NamedValue(name=name, value=value) for name, value in setpoint.items()]


def goal(setpoint: dict[str, float], **fields: Any) -> EvaluateSetpoint.Goal:
    return EvaluateSetpoint.Goal(**{"run_id": "run", "setpoint": point(setpoint), **fields})


def k1(named: Any) -> float:
    return float({item.name: item.value for item in named}["K1"])


def position(mover: GoalClient) -> float:
    """Where K1 is: a goal without a set-point moves nothing, and says where the machine is."""
    mover.send(ApplySetpoint.Goal())
    result = mover.wait()
    assert result.error_code == RESULT.NONE
    return k1(result.readbacks)


class Heart:
    """Beats for one run, ten times a second."""

    def __init__(self, node: Node) -> None:
        self._publisher = node.create_publisher(msg.Heartbeat, "heartbeat", STREAM)
        self.run_id: str | None = "run"
        node.create_timer(0.1, self.beat)

    def beat(self) -> None:
        if self.run_id is not None:
            self._publisher.publish(msg.Heartbeat(run_id=self.run_id))


def test_an_evaluation_that_is_not_newer_is_refused(
    start_machine: Callable[..., NodeProcess], client: GoalClient
) -> None:
    process = start_machine(1000.0)

    def code(**fields: Any) -> int:
        client.send(goal(MIDDLE, shots=1, **fields))
        result = client.wait()
        assert (result.run_id, result.index, result.attempt) == (
            fields.get("run_id", "run"),
            fields["index"],
            fields.get("attempt", 0),
        )
        return int(result.error_code)

    assert code(index=3) == RESULT.NONE
    assert code(index=3) == RESULT.UNKNOWN
    assert "evaluation 3, attempt 0 of run 'run' is a duplicate" in process.stderr
    assert code(index=2, attempt=5) == RESULT.UNKNOWN
    assert code(index=3, attempt=1) == RESULT.NONE
    assert code(index=3, attempt=0) == RESULT.UNKNOWN
    assert code(index=0, run_id="other") == RESULT.NONE
    assert code(index=4) == RESULT.NONE
    for _ in range(3):  # by hand, as `ros2 action send_goal` does
        assert code(index=0, run_id="") == RESULT.NONE


def test_apply_setpoint_moves_without_measuring(
    start_machine: Callable[..., NodeProcess], client: GoalClient, mover: GoalClient
) -> None:
    start_machine(20.0)
    mover.send(ApplySetpoint.Goal(setpoint=point(FAR)))
    client.send(goal(MIDDLE))
    assert client.wait().error_code == RESULT.BUSY
    arrived = mover.wait()
    assert (arrived.error_code, k1(arrived.readbacks)) == (ApplySetpoint.Result.NONE, 550.0)
    assert {f.phase for f in mover.feedback} == {"ramping", "settling"}
    positions = [k1(f.readbacks) for f in mover.feedback]
    assert positions == sorted(positions)
    mover.send(ApplySetpoint.Goal(setpoint=point(MIDDLE)))
    mover.cancel()
    stopped = mover.wait()
    assert stopped.error_code == ApplySetpoint.Result.CANCELED
    assert 475.0 < k1(stopped.readbacks) <= 550.0
    assert position(mover) == k1(stopped.readbacks)


def test_a_limit_on_a_sum_is_kept_at_the_set_point_and_on_the_way(
    start_machine: Callable[..., NodeProcess], client: GoalClient, mover: GoalClient
) -> None:
    start_machine(20.0)
    limit = msg.Limit(
        name="total", coefficients=point({"K1": 1.0, "K2": 1.0}), min=-math.inf, max=705.0
    )
    client.send(goal(MIDDLE, limits=[limit]))
    assert client.wait().error_code == RESULT.NONE
    client.send(goal(MIDDLE | {"K1": 476.0}, limits=[limit]))
    refused = client.wait()
    assert refused.error_code == RESULT.INVALID_SETPOINT
    assert "limits.total is 706 at the set-point" in refused.error_msg
    # Along the limit, the variable that leads away from it moves first, by the faster of the two.
    along = MIDDLE | {"K1": 495.0, "K2": 210.0}
    mover.send(ApplySetpoint.Goal(setpoint=point(along), limits=[limit]))
    arrived = mover.wait()
    assert (arrived.error_code, k1(arrived.readbacks)) == (RESULT.NONE, 495.0)
    for feedback in mover.feedback:
        at = {item.name: item.value for item in feedback.readbacks}
        assert at["K1"] + at["K2"] <= 705.0 + 1e-6


def test_one_shot_beyond_a_critical_limit_ends_the_evaluation(
    start_machine: Callable[..., NodeProcess], client: GoalClient, mover: GoalClient
) -> None:
    start_machine(20.0)
    limits = [
        msg.Constraint(name="eps_x", unit="mm mrad", min=-math.inf, max=1e6),
        msg.Constraint(name="transmission", min=-math.inf, max=0.1),
    ]
    beyond = point(SAFE | {"K1": 440.0})
    client.send(
        goal(MIDDLE, shots=1000, critical=limits, if_violated=point(SAFE), if_violated_via=beyond)
    )
    result = client.wait()
    assert (result.error_code, result.shots) == (RESULT.VIOLATION, 1)
    assert "transmission = " in result.error_msg
    assert "critical limits, -inf to 0.1" in result.error_msg
    assert {d.name for d in result.diagnostics} >= {"transmission", "eps_x"}
    assert k1(result.readbacks) == 475.0  # where it was measured
    # It went to the safe set-point on a ramp from the other side: feedback on the way shows it in between.
    assert any(450.0 < k1(f.readbacks) < 475.0 for f in client.feedback)
    assert any(440.0 <= k1(f.readbacks) < 450.0 for f in client.feedback)
    assert position(mover) == 450.0


def test_without_a_fallback_the_machine_holds_where_the_limit_was_violated(
    start_machine: Callable[..., NodeProcess], client: GoalClient, mover: GoalClient
) -> None:
    start_machine(20.0)
    limit = msg.Constraint(name="transmission", min=2.0, max=math.inf)
    client.send(goal(SAFE, critical=[limit]))
    assert client.wait().error_code == RESULT.VIOLATION
    assert position(mover) == 450.0


def test_a_client_that_falls_silent_is_lost_amid_its_evaluation(
    start_machine: Callable[..., NodeProcess],
    client: GoalClient,
    mover: GoalClient,
    node: Node,
    spin_until: Callable[..., None],
) -> None:
    start_machine(5.0)
    heart = Heart(node)
    client.send(goal(FAR, shots=500, client_timeout=1.0, if_client_lost=point(SAFE)))
    started = time.monotonic()
    spin_until(lambda: time.monotonic() - started > 1.5, "time")  # longer than the timeout
    assert client.result is not None
    assert not client.result.done()
    heart.run_id = None
    silent = time.monotonic()
    result = client.wait()
    assert result.error_code == RESULT.CLIENT_LOST
    assert "the heartbeat of run 'run' stopped for more than 1 s" in result.error_msg
    assert time.monotonic() - silent > 0.9
    assert position(mover) == 450.0
    client.send(goal(MIDDLE))  # its answer may have been missed: it may be asked again
    assert client.wait().error_code == RESULT.NONE


def test_a_client_is_watched_between_its_evaluations_until_it_ends_its_run(
    start_machine: Callable[..., NodeProcess],
    client: GoalClient,
    mover: GoalClient,
    node: Node,
    spin_until: Callable[..., None],
) -> None:
    process = start_machine(200.0)
    heart = Heart(node)
    watched = {"shots": 1, "client_timeout": 0.5, "if_client_lost": point(SAFE)}
    client.send(goal(MIDDLE, **watched))
    assert client.wait().error_code == RESULT.NONE
    heart.run_id = "another run"
    spin_until(lambda: "machine went to the set-point" in process.stderr, "the machine to go")
    assert position(mover) == 450.0

    heart.run_id = "run"
    client.send(goal(FAR, **watched))
    assert client.wait().error_code == RESULT.NONE
    heart.run_id = ""
    heart.beat()
    heart.run_id = None
    ended = time.monotonic()
    spin_until(lambda: time.monotonic() - ended > 1.2, "time")  # more than twice the timeout
    assert position(mover) == 550.0


def test_an_evaluation_of_another_run_takes_the_watch_over(
    start_machine: Callable[..., NodeProcess],
    client: GoalClient,
    mover: GoalClient,
    spin_until: Callable[..., None],
) -> None:
    start_machine(200.0)
    client.send(goal(MIDDLE, shots=1, client_timeout=0.6, if_client_lost=point(SAFE)))
    assert client.wait().error_code == RESULT.NONE
    client.send(goal(FAR, run_id="unwatched", shots=1))
    assert client.wait().error_code == RESULT.NONE
    ended = time.monotonic()
    spin_until(lambda: time.monotonic() - ended > 1.2, "time")
    assert position(mover) == 550.0
