"""The machine driven by plain topics and services, without our actions."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.node import Node
from rclpy.publisher import Publisher
from std_msgs.msg import Bool, Float64
from std_srvs.srv import Trigger

from awa_sim_node.surrogate import Surrogate
from mobo_msgs_py import msg
from mobo_msgs_py.action import EvaluateSetpoint
from mobo_tuner.ros.qos import LATCHED, STREAM
from tests.support.processes import NodeStarter
from tests.support.simulator import (
    LOSSY,
    MIDDLE,
    Listener,
    Services,
    evaluation_goal,
    start_machine,
)
from tests.support.tuner import machine_client

RESULT = EvaluateSetpoint.Result


@pytest.fixture
def setpoint(node: Node, spin_until: Callable[..., None]) -> Callable[[str], Publisher]:
    def publisher(device: str) -> Publisher:
        made = node.create_publisher(Float64, f"{device}/setpoint", STREAM)
        spin_until(lambda: made.get_subscription_count() == 1, f"the device {device}")
        return made

    return publisher


def test_a_device_moves_and_says_when_it_is_there(
    start_node: NodeStarter,
    node: Node,
    spin_until: Callable[..., None],
    setpoint: Callable[[str], Publisher],
) -> None:
    start_machine(start_node, mode="ideal", speed=10.0, stream_rate=50.0)
    readback = Listener(node, Float64, "K1/readback")
    other = Listener(node, Float64, "K2/readback")
    settled = Listener(node, Bool, "K1/settled", LATCHED)
    emittance = Listener(node, Float64, "beam/eps_x")
    k1 = setpoint("K1")
    spin_until(lambda: emittance.data and settled.data and readback.data, "the streams")
    assert (settled.data[-1], readback.data[-1]) == (True, 475.0)
    before = emittance.data[-1]
    k1.publish(Float64(data=435.0))
    spin_until(lambda: not settled.data[-1], "the device to begin")
    spin_until(lambda: settled.data[-1], "the device to arrive")
    spin_until(lambda: readback.data[-1] == 435.0, "the readback")
    path = readback.data[readback.data.index(475.0) :]
    assert path == sorted(path, reverse=True)
    assert len(set(path)) > 5
    assert set(other.data) == {230.0}
    spin_until(lambda: emittance.data[-1] != before, "the beam to follow")
    assert math.isfinite(emittance.data[-1])


def test_direct_moves_keep_to_the_limits_and_out_of_the_way_of_actions(
    start_node: NodeStarter,
    node: Node,
    spin_until: Callable[..., None],
    setpoint: Callable[[str], Publisher],
) -> None:
    process = start_machine(start_node, mode="ideal", speed=1.0)
    k1, g1 = setpoint("K1"), setpoint("G1")
    k1.publish(Float64(data=551.0))
    limits = "set-point K1 = 551 is refused: set-point K1 = 551 A is outside "
    spin_until(lambda: limits in process.stderr, "the refusal")
    client = machine_client(node, spin_until)
    client.send(evaluation_goal(MIDDLE | {"K1": 550.0}))
    spin_until(lambda: len(client.feedback) > 1, "the evaluation to move")
    g1.publish(Float64(data=60.0))
    busy = "set-point G1 = 60 is refused: an action "
    spin_until(lambda: busy in process.stderr, "the refusal")

    answer = Services(node, spin_until).call(Trigger, "stop")
    assert answer.success
    assert "holds" in answer.message
    result = client.wait()
    assert result.error_code == RESULT.CANCELED
    assert {r.name: r.value for r in result.readbacks}["G1"] == 67.5

    g1.publish(Float64(data=75.0))
    readback = Listener(node, Float64, "G1/readback")
    spin_until(lambda: readback.data and readback.data[-1] > 67.6, "the device to move")
    client.send(evaluation_goal(MIDDLE, index=1))
    result = client.wait()
    assert result.error_code == RESULT.BUSY
    assert "set-point" in result.error_msg
    assert Services(node, spin_until).call(Trigger, "stop").success
    client.send(evaluation_goal(MIDDLE, index=1))
    spin_until(lambda: client.feedback, "the evaluation to begin")


def test_the_interlock_refuses_everything_until_it_is_cleared(
    start_node: NodeStarter,
    node: Node,
    spin_until: Callable[..., None],
    setpoint: Callable[[str], Publisher],
) -> None:
    process = start_machine(
        start_node, mode="ideal", speed=1000.0, beam_loss_limit=0.9, interlock_shots=8
    )
    interlock = Listener(node, Bool, "interlock", LATCHED)
    health = Listener(node, DiagnosticArray, "/diagnostics")
    client = machine_client(node, spin_until)
    services = Services(node, spin_until)

    def evaluate(point: dict[str, float], index: int, shots: int) -> EvaluateSetpoint.Result:
        client.send(evaluation_goal(point, index=index, shots=shots))
        return client.wait()

    lost = evaluate(LOSSY, 0, 2)
    assert lost.error_code == RESULT.INVALID_MEASUREMENT
    assert "lost in 2 of 2 shots" in lost.error_msg
    measured = {d.name: d.value for d in lost.diagnostics}
    assert set(measured) == {"transmission", "charge"}
    assert measured["transmission"] < 0.9
    raised = evaluate(LOSSY, 1, 100)
    assert raised.error_code == RESULT.INTERLOCK
    assert raised.error_msg.startswith("the interlock is raised: 8 ")
    assert 0 < raised.shots < 100
    assert evaluate(MIDDLE, 2, 1).error_code == RESULT.INTERLOCK
    spin_until(lambda: interlock.data and interlock.data[-1], "the interlock")
    setpoint("K1").publish(Float64(data=450.0))
    spin_until(lambda: "K1 = 450 is refused: the interlock" in process.stderr, "the refusal")

    def machine_level() -> bytes:
        levels = {s.name: s.level for s in health.messages[-1].status} if health.messages else {}
        return bytes(levels.get("awa_sim: machine", b""))

    spin_until(lambda: machine_level() == DiagnosticStatus.ERROR, "the alarm")
    answer = services.call(Trigger, "clear_interlock")
    assert answer.success
    assert "cleared" in answer.message
    assert evaluate(MIDDLE, 3, 1).error_code == RESULT.NONE
    spin_until(lambda: interlock.data[-1] is False, "the interlock to be gone")
    spin_until(lambda: machine_level() == DiagnosticStatus.OK, "the end of the alarm")
    values = {v.key: v.value for s in health.messages[-1].status for v in s.values}
    assert (values["evaluations"], values["failed evaluations"]) == ("3", "2")
    assert "not raised" in services.call(Trigger, "clear_interlock").message


@pytest.mark.parametrize(
    ("parameters", "parts"),
    [
        (
            {"trip_rate": 3600.0, "trip_recovery_max": 1e5, "trip_recovery_min": 1e5},
            ("tripped",),
        ),
        ({"beam_dropout": 1.0}, ("sigma_x", "40 shots")),
        (
            {"jitter_charge": 0.5, "beam_charge_window": 0.01, "beam_retakes": 0.0},
            ("charge", "1 shots", "40 nC", "1 %"),
        ),
    ],
)
def test_a_bad_moment_ends_an_evaluation_with_an_error(
    start_node: NodeStarter,
    node: Node,
    spin_until: Callable[..., None],
    parameters: dict[str, Any],
    parts: tuple[str, ...],
) -> None:
    start_machine(start_node, mode="ideal", speed=1000.0, trip_patience=0.0, **parameters)
    client = machine_client(node, spin_until)
    client.send(evaluation_goal(MIDDLE | {"G1": 68.0}, shots=40))
    result = client.wait()
    assert result.error_code == RESULT.INVALID_MEASUREMENT
    for part in parts:
        assert part in result.error_msg
    assert {r.name: r.value for r in result.readbacks}["G1"] == 68.0


def test_the_truth_is_told_to_tests_alone(
    start_node: NodeStarter, node: Node, spin_until: Callable[..., None]
) -> None:
    start_machine(start_node, mode="nominal", publish_truth=True)
    truth = Listener(node, msg.NamedValues, "truth")
    measured = Listener(node, Float64, "beam/eps_z")
    spin_until(lambda: len(truth.messages) > 20 and len(measured.data) > 20, "the truth")
    values = [{v.name: (v.value, v.unit) for v in m.values} for m in truth.messages]
    assert set(MIDDLE) | {"charge", "coupler_kick", "eps_z", "transmission"} <= set(values[0])
    assert values[0]["eps_z"][1] == "mm mrad"
    true = [value["eps_z"][0] for value in values]
    # Charge jitter moves the truth by some per cent, the streak camera's noise is 12 %.
    assert 0.0 < max(true) / min(true) - 1.0 < 0.5
    assert max(measured.data) / min(measured.data) > max(true) / min(true)


def test_the_models_uncertainty_follows_a_measurement(
    start_node: NodeStarter, node: Node, spin_until: Callable[..., None]
) -> None:
    start_machine(start_node, mode="ideal", speed=1000.0)
    uncertainty = Listener(node, msg.NamedValues, "model_uncertainty", LATCHED)
    client = machine_client(node, spin_until)
    client.send(evaluation_goal(MIDDLE, shots=1))
    assert client.wait().error_code == RESULT.NONE
    spin_until(lambda: uncertainty.messages, "the uncertainty")
    expected = Surrogate.load().spread(MIDDLE)
    published = {v.name: (v.value, v.unit) for v in uncertainty.messages[-1].values}
    assert {name: value for name, (value, _) in published.items()} == pytest.approx(expected)
    assert published["eps_x"][1] == "mm mrad"
    assert published["eps_x"][0] > 0.0


def test_the_truth_is_kept_unless_asked_for(
    start_node: NodeStarter, node: Node, spin_until: Callable[..., None]
) -> None:
    start_machine(start_node, model="toy")
    spin_until(lambda: node.count_publishers("beam/g") == 1, "the machine")
    assert node.count_publishers("truth") == 0
