"""The tuner's node over real DDS: runs, cancels in every phase, refusals, and machines that fail."""

from __future__ import annotations

import math
import signal
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import yaml
from rclpy.node import Node
from std_msgs.msg import Float64

from mobo_msgs_py import msg
from mobo_msgs_py.action import EvaluateSetpoint, Tune
from mobo_tuner.machine.double import Answer
from mobo_tuner.ros.qos import LATCHED, STREAM
from tests.support.processes import NodeProcess, NodeStarter
from tests.support.tuner import (
    GoalClient,
    Listener,
    evaluated,
    journal,
    toy_machine,
    toy_values,
    tune_client,
)

NONE = EvaluateSetpoint.Result.NONE
FAILED = EvaluateSetpoint.Result.INVALID_MEASUREMENT


def test_a_goal_tunes_the_machine_and_everyone_hears_of_it(
    start_tuner: Callable[..., NodeProcess],
    start_machine: Callable[..., NodeProcess],
    client: GoalClient,
    node: Node,
    spin_until: Callable[..., None],
    tmp_path: Path,
) -> None:
    start_machine()
    start_tuner("seed:=3")
    evaluations = Listener(node, msg.Evaluation, "evaluation", STREAM)
    fronts = Listener(node, msg.ParetoFront, "pareto_front", LATCHED)
    plots = Listener(node, Float64, "plot/f1", STREAM)
    statuses = Listener(node, msg.TunerStatus, "status", LATCHED)
    spin_until(
        lambda: all(
            node.get_publishers_info_by_topic(topic) for topic in ("/evaluation", "/plot/f1")
        ),
        "the tuner's topics",
    )
    client.send(Tune.Goal(run_id="first", evaluations=12))
    result = client.wait()
    assert (result.stop_reason, result.error_code, result.error_msg) == ("budget", 0, "")
    assert (result.run_id, result.evaluations) == ("first", 12)
    spin_until(lambda: len(evaluations.messages) == len(plots.messages) == 12, "all messages")

    told = evaluations.messages
    assert [m.index for m in told] == list(range(12))
    assert {m.run_id for m in told} == {"first"}
    assert [m.source for m in told] == sorted(m.source for m in told)
    assert told[-1].source == msg.Evaluation.MODEL
    assert all(m.valid and m.feasible for m in told)
    hypervolumes = [m.hypervolume for m in told]
    assert hypervolumes == sorted(hypervolumes)
    assert [f.evaluations for f in client.feedback] == list(range(1, 13))
    for message in told:
        x = {s.name: s.value for s in message.setpoint}
        f = {o.name: o.value for o in message.objectives}
        assert f["f1"] == pytest.approx(math.hypot(x["x1"] - 1, x["x2"] - 1), abs=1e-12)
        assert message.total_seconds >= message.machine_seconds + message.suggest_seconds

    front = result.pareto_front
    assert [p.index for p in fronts.messages[-1].points] == [p.index for p in front.points]
    assert front.hypervolume == hypervolumes[-1]
    indices = {p.index for p in front.points}
    assert all(told[i].index == i for i in indices)
    latched = Listener(node, msg.Problem, "problem", LATCHED)
    spin_until(lambda: latched.messages, "the latched problem")
    assert [v.name for v in latched.messages[0].variables] == ["x1", "x2"]
    spin_until(lambda: statuses.messages[-1].state == msg.TunerStatus.IDLE, "an idle tuner")

    records = journal(tmp_path, "first")
    assert [r["type"] for r in records] == ["start", "state", *["evaluation"] * 12, "end"]
    assert [r["hypervolume"] for r in records[2:-1]] == hypervolumes


def test_the_same_seed_gives_the_same_run(
    start_tuner: Callable[..., NodeProcess],
    start_machine: Callable[..., NodeProcess],
    client: GoalClient,
    tmp_path: Path,
) -> None:
    start_machine()
    start_tuner("seed:=7", "initial_evaluations:=4")
    for run_id in ("a", "b"):
        client.send(Tune.Goal(run_id=run_id, evaluations=8))
        assert client.wait().error_code == 0
    a, b = ([r["setpoint"] for r in evaluated(tmp_path, run)] for run in "ab")
    assert a == b


@pytest.mark.parametrize("phase", ["waiting", "evaluating", "suggesting"])
def test_a_cancel_is_answered_soon_in_any_phase(
    start_tuner: Callable[..., NodeProcess],
    start_machine: Callable[..., NodeProcess],
    client: GoalClient,
    node: Node,
    spin_until: Callable[..., None],
    phase: str,
) -> None:
    if phase == "suggesting":  # the paper's 5000 Adam steps for seven models take seconds
        start_machine("speed:=100000.0", config="awa.yaml")
        start_tuner("preset:=paper", "initial_evaluations:=18", config="awa.yaml")
    elif phase == "evaluating":
        start_machine("speed:=1.0", config="awa.yaml")
        start_tuner(config="awa.yaml")
    else:
        start_tuner("discovery_timeout:=60.0")
    statuses = Listener(node, msg.TunerStatus, "status", LATCHED)
    beats = Listener(node, msg.Heartbeat, "heartbeat", STREAM)
    client.send(Tune.Goal(run_id="run", evaluations=50))
    done = 18 if phase == "suggesting" else 0
    state = getattr(msg.TunerStatus, phase.upper())

    def reached() -> bool:
        last = statuses.messages[-1] if statuses.messages else msg.TunerStatus()
        return last.state == state and last.evaluations == done and last.run_id == "run"

    spin_until(reached, f"the phase {phase}", 60.0)
    if phase == "evaluating":
        spin_until(lambda: statuses.messages[-1].phase == "ramping", "a ramp")
    heard = len(beats.messages)
    spin_until(lambda: len(beats.messages) >= heard + 2, "two heartbeats in this phase")
    assert statuses.messages[-1].state == state
    assert client.result is not None
    assert not client.result.done()
    started = time.monotonic()
    client.cancel()
    result = client.wait()
    assert time.monotonic() - started < 2.0  # one, and one more for a busy computer
    assert result.error_code == Tune.Result.CANCELED
    assert result.stop_reason == "canceled"
    assert result.evaluations == done
    assert bool(result.pareto_front.points) == bool(done)
    spin_until(lambda: not beats.messages[-1].run_id, "the last heartbeat")
    assert {beat.run_id for beat in beats.messages[:-1]} == {"run"}


def test_a_killed_machine_ends_the_run_with_an_error_and_loses_nothing(
    start_tuner: Callable[..., NodeProcess],
    start_machine: Callable[..., NodeProcess],
    client: GoalClient,
    spin_until: Callable[..., None],
    tmp_path: Path,
) -> None:
    machine = start_machine("speed:=50.0", config="awa.yaml")
    start_tuner("machine_timeout:=2.0", "machine_return_timeout:=0.0", config="awa.yaml")
    client.send(Tune.Goal(run_id="killed", evaluations=50))
    spin_until(lambda: len(client.feedback) >= 2, "two evaluations")
    machine.kill()
    result = client.wait()
    assert result.error_code == Tune.Result.MACHINE_LOST
    assert "silent for 2" in result.error_msg
    assert result.stop_reason == "error"
    assert len(result.pareto_front.points) >= 1
    records = journal(tmp_path, "killed")
    assert len(records) == result.evaluations + 3  # start, state, end
    assert records[-1]["error_msg"] == result.error_msg


def test_a_machine_that_does_not_fit_is_refused(
    start_tuner: Callable[..., NodeProcess],
    start_machine: Callable[..., NodeProcess],
    client: GoalClient,
) -> None:
    start_machine(config="toy.yaml")
    start_tuner(config="awa.yaml")
    client.send(Tune.Goal(evaluations=5))
    result = client.wait()
    assert result.error_code == Tune.Result.MACHINE_UNAVAILABLE
    assert "variable 'K1' is not one of the machine's: x1, x2" in result.error_msg


def test_no_machine_is_said_after_the_discovery_timeout(
    start_tuner: Callable[..., NodeProcess], client: GoalClient
) -> None:
    start_tuner("discovery_timeout:=0.5")
    client.send(Tune.Goal(evaluations=5))
    result = client.wait()
    assert result.error_code == Tune.Result.MACHINE_UNAVAILABLE
    assert "no machine answered" in result.error_msg


def test_goals_that_cannot_be_served_are_refused_with_a_reason(
    start_tuner: Callable[..., NodeProcess],
    start_machine: Callable[..., NodeProcess],
    client: GoalClient,
    node: Node,
    spin_until: Callable[..., None],
) -> None:
    start_machine("speed:=1.0", config="awa.yaml")
    start_tuner(config="awa.yaml")
    client.send(Tune.Goal(run_id="../escape", evaluations=5))
    result = client.wait()
    assert result.error_code == Tune.Result.INVALID_GOAL
    assert "run_id is '../escape'" in result.error_msg

    client.send(Tune.Goal(run_id="long", evaluations=5))
    other = tune_client(node, spin_until)
    other.send(Tune.Goal(run_id="other", evaluations=5))
    refused = other.wait()
    assert refused.error_code == Tune.Result.INVALID_GOAL
    assert "run 'long' is active" in refused.error_msg
    client.cancel()
    assert client.wait().error_code == Tune.Result.CANCELED

    client.send(Tune.Goal(run_id="long", evaluations=5))
    again = client.wait()
    assert again.error_code == Tune.Result.INVALID_GOAL
    assert "exists" in again.error_msg


def test_failed_evaluations_are_recorded_and_the_run_goes_on(
    start_tuner: Callable[..., NodeProcess],
    client: GoalClient,
    node: Node,
    tmp_path: Path,
) -> None:
    def answer(goal: EvaluateSetpoint.Goal) -> Answer:
        if goal.index == 1:
            return Answer({"f1": 1.0}, FAILED, "the camera saw nothing")
        if goal.index == 2:
            return Answer(dict.fromkeys(toy_values(goal), math.nan))
        return Answer(toy_values(goal))

    machine = toy_machine(node, answer)
    start_tuner("initial_evaluations:=5")
    client.send(Tune.Goal(run_id="failing", evaluations=7))
    result = client.wait()
    assert result.error_code == 0
    assert [g.index for g in machine.goals] == list(range(7))
    assert 2 not in {p.index for p in result.pareto_front.points}
    records = evaluated(tmp_path, "failing")
    assert [r["valid"] for r in records] == [True, True, False, True, True, True, True]
    assert not records[1]["feasible"]  # f2 is missing, what was measured is learned
    assert records[1]["error_code"] == FAILED
    assert records[1]["error_msg"] == "the camera saw nothing"
    assert "f1, f2" in records[2]["error_msg"]
    assert records[2]["error_code"] == FAILED
    assert [r["attempts"] for r in records] == [1] * 7
    assert records[1]["diagnostics"]["f1"][0] == 1.0


def test_a_machine_that_keeps_failing_ends_the_run(
    start_tuner: Callable[..., NodeProcess], client: GoalClient, node: Node
) -> None:
    toy_machine(node, lambda _: Answer({}, FAILED, "no beam"))
    start_tuner("max_consecutive_failures:=4")
    client.send(Tune.Goal(evaluations=50))
    result = client.wait()
    assert result.error_code == Tune.Result.MACHINE_ERROR
    assert result.error_msg == "4 evaluations failed in a row: no beam"
    assert result.evaluations == 4


def test_a_run_whose_own_evaluations_are_of_no_use_is_an_error(
    start_tuner: Callable[..., NodeProcess], client: GoalClient, node: Node, tmp_path: Path
) -> None:
    answers = [Answer({}, FAILED, "no beam"), Answer({"f1": (1.0, 0.0)})]
    machine = toy_machine(node, lambda _: answers[0])
    start_tuner()
    client.send(Tune.Goal(run_id="dark", evaluations=2))
    dark = client.wait()
    assert (dark.error_code, dark.evaluations) == (Tune.Result.MACHINE_ERROR, 2)
    assert dark.error_msg == "all of its 2 evaluations failed, the last one because no beam"
    assert journal(tmp_path, "dark")[-1]["stop_reason"] == "error"
    machine.answer = lambda _: answers[1]
    client.send(Tune.Goal(run_id="half", evaluations=1))
    assert client.wait().error_msg == "in 1 evaluation it never measured f2"
    machine.answer = lambda goal: Answer(toy_values(goal))
    client.send(Tune.Goal(run_id="bright", evaluations=2))
    assert client.wait().error_code == NONE
    machine.answer = lambda _: answers[0]
    client.send(Tune.Goal(run_id="dark-again", resume_from="bright", evaluations=3))
    assert "no beam" in client.wait().error_msg


def test_an_interlocked_machine_ends_the_run_with_its_own_words(
    start_tuner: Callable[..., NodeProcess], client: GoalClient, node: Node
) -> None:
    code = EvaluateSetpoint.Result.INTERLOCK
    toy_machine(node, lambda goal: Answer(toy_values(goal), code if goal.index else NONE, "vacuum"))
    start_tuner("on_interlock:=abort")
    client.send(Tune.Goal(evaluations=50))
    result = client.wait()
    assert result.error_code == Tune.Result.MACHINE_ERROR
    assert result.error_msg == "the machine refused evaluation 1: vacuum"


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_ends_run_and_process_in_order(
    start_tuner: Callable[..., NodeProcess],
    start_machine: Callable[..., NodeProcess],
    client: GoalClient,
    spin_until: Callable[..., None],
    tmp_path: Path,
    number: signal.Signals,
) -> None:
    start_machine("speed:=50.0", config="awa.yaml")
    tuner = start_tuner(config="awa.yaml")
    client.send(Tune.Goal(run_id="stopped", evaluations=50))
    spin_until(lambda: client.feedback, "an evaluation")
    assert tuner.stop(number) == 0
    result = client.wait()
    assert result.error_code == Tune.Result.CANCELED
    assert result.error_msg == "the run was stopped: the tuner was asked to stop"
    records = journal(tmp_path, "stopped")
    assert records[-1]["type"] == "end"
    assert len(records) == result.evaluations + 3  # start, state, end


@pytest.mark.parametrize(
    ("section", "words"),
    [
        (
            {"variables": {"x": {"min": 2.0, "max": 1.0}}},
            "variables.x.min is 2, which must be less than its max of 1",
        ),
        ({"fidelity": {"s": {"choices": [1.0, 2.0]}, "cost": "s"}}, "'fidelity' is given"),
    ],
)
def test_a_bad_problem_is_said_and_the_node_does_not_start(
    start_node: NodeStarter, tmp_path: Path, section: dict[str, Any], words: str
) -> None:
    file = tmp_path / "bad.yaml"
    problem = {
        "variables": {"x": {"min": 1.0, "max": 2.0}},
        "objectives": {"f": {"reference": 1.0}},
    }
    file.write_text(yaml.safe_dump({"/**": {"ros__parameters": problem | section}}))
    process = start_node("-m", "mobo_tuner.nodes.tuner", "--ros-args", "--params-file", str(file))
    assert process.wait() == 2
    assert words in process.stderr
    assert "Traceback" not in process.stderr
