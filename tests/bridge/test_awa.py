"""The simulated injector tuned through its plain topics: the bridge sees none of our types there."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from rclpy.node import Node
from std_msgs.msg import Float64
from std_srvs.srv import Trigger

from awa_sim_node.surrogate import Surrogate
from mobo_msgs_py.action import EvaluateSetpoint, Tune
from mobo_tuner.runs.history import History
from mobo_tuner.runs.journal import read_journal
from tests.support.processes import NodeStarter
from tests.support.simulator import LOSSY, MIDDLE, Listener, evaluation_goal, start_machine
from tests.support.tuner import CONFIG, GoalClient, Services, machine_client, tune_client

MAPPING = CONFIG / "bridge_awa.yaml"
RESULT = EvaluateSetpoint.Result
Spin = Callable[..., None]


def values(named: object) -> dict[str, float]:
    return {item.name: item.value for item in named}  # type: ignore[attr-defined]


class Injector:
    """The injector in its namespace, the bridge beside it, and a client of the bridge."""

    def __init__(self, start_node: NodeStarter, node: Node, spin_until: Spin, **more: Any) -> None:
        self.machine = start_machine(
            start_node, namespace="/injector", speed=100.0, stream_rate=50.0, **more
        )
        options = ("--ros-args", "-p", f"mapping:={MAPPING}")
        self.bridge = start_node("-m", "mobo_tuner.nodes.machine_bridge", *options)
        self.client: GoalClient = machine_client(node, spin_until)
        self.index = 0

    def evaluate(self, point: dict[str, float], **fields: object) -> EvaluateSetpoint.Result:
        """Evaluate a set-point through the bridge."""
        self.send(point, **fields)
        return self.client.wait()

    def send(self, point: dict[str, float], **fields: object) -> None:
        """Ask the bridge for an evaluation."""
        self.index += 1
        self.client.send(evaluation_goal(point, index=self.index, **fields))

    def until_ready(self) -> EvaluateSetpoint.Result:
        """Until the bridge hears all of the injector: before that, it says what is missing."""
        deadline = time.monotonic() + 20.0
        while (result := self.evaluate(MIDDLE)).error_code != RESULT.NONE:
            assert time.monotonic() < deadline, result.error_msg
        return result


def test_the_mapping_needs_no_type_of_ours() -> None:
    assert "mobo_" not in MAPPING.read_text(encoding="utf-8")


def test_the_bridge_moves_and_measures_by_plain_topics(
    start_node: NodeStarter, node: Node, spin_until: Spin
) -> None:
    injector = Injector(
        start_node, node, spin_until, mode="ideal", beam_loss_limit=0.9, interlock_shots=10
    )
    surrogate = Surrogate.load()
    assert values(injector.until_ready().diagnostics) == pytest.approx(
        surrogate.predict(MIDDLE) | {"charge": 40.0}, rel=1e-6
    )
    commands = Listener(node, Float64, "injector/K1/setpoint")
    other = MIDDLE | {"K1": 435.0, "G1": 66.0, "phi2": -2.0}
    result = injector.evaluate(other, shots=3)
    assert (result.error_code, result.error_msg, result.shots) == (RESULT.NONE, "", 3)
    assert values(result.readbacks) == pytest.approx(other, abs=1e-6)
    assert values(result.diagnostics) == pytest.approx(
        surrogate.predict(other) | {"charge": 40.0}, rel=1e-6
    )
    assert commands.data == pytest.approx([455.0, 435.0])  # two of the largest steps

    lost = injector.evaluate(LOSSY, shots=100)
    assert lost.error_code == RESULT.INTERLOCK
    assert lost.error_msg == "interlock beam_loss forbids to move"
    assert injector.evaluate(MIDDLE).error_code == RESULT.INTERLOCK
    services = Services(node, spin_until, of="injector/awa_sim")
    assert services.call(Trigger, "injector/clear_interlock").success
    injector.until_ready()

    injector.send(MIDDLE | {"K1": 550.0})
    injector.machine.kill()
    gone = injector.client.wait()
    assert gone.error_code == RESULT.MACHINE_LOST
    assert (
        "of K1 is not known: the topic 'injector/K1/readback' gave no value for" in gone.error_msg
    )
    commands.messages.clear()
    assert injector.evaluate(MIDDLE).error_code in (RESULT.MACHINE_LOST, RESULT.INTERLOCK)
    assert commands.data == []
    assert injector.bridge.stop() == 0
    assert "Traceback" not in injector.bridge.stderr


def test_the_tuner_tunes_the_injector_through_the_bridge(
    start_node: NodeStarter, node: Node, spin_until: Spin, tmp_path: Path
) -> None:
    Injector(start_node, node, spin_until, mode="nominal", trip_rate=0.0).until_ready()
    options = ["--params-file", str(CONFIG / "awa.yaml")]
    for parameter in (f"runs_dir:={tmp_path}", "model_input:=readback"):
        options += ["-p", f"tuner:{parameter}"]
    start_node("-m", "mobo_tuner.nodes.tuner", "--ros-args", *options)
    client = tune_client(node, spin_until)
    client.send(Tune.Goal(run_id="bridged", evaluations=3))
    result = client.wait(60.0)
    assert (result.stop_reason, result.evaluations) == ("budget", 3)
    history = History.from_records(read_journal(tmp_path / "bridged"))
    for told, feedback in zip(history.evaluations, client.feedback, strict=True):
        evaluation = feedback.evaluation
        assert (evaluation.error_code, evaluation.error_msg) == (RESULT.NONE, "")
        assert len(evaluation.diagnostics) == 10
        assert all(math.isfinite(d.value) for d in evaluation.diagnostics)
        point, where = values(evaluation.setpoint), values(evaluation.readbacks)
        for name, tolerance in {"K1": 0.5, "phi1": 0.15, "G1": 0.1}.items():
            assert where[name] == pytest.approx(point[name], abs=tolerance)
            assert where[name] != point[name]
        assert (told.setpoint, told.readbacks) == (point, where)
