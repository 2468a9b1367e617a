"""The action `tune`: a run whose bounds or first evaluation depend on where the machine is."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import yaml
from rclpy.node import Node

from mobo_msgs_py import msg
from mobo_msgs_py.action import Tune
from mobo_tuner.files import load_yaml
from mobo_tuner.ros.qos import LATCHED
from mobo_tuner.runs.history import History
from mobo_tuner.runs.journal import read_journal
from mobo_tuner.runs.replay import compare
from tests.support.processes import NodeProcess
from tests.support.tuner import CONFIG, GoalClient, Listener, journal, toy_machine


def test_bounds_around_the_machine_are_resolved_kept_and_resumed(
    start_tuner: Callable[..., NodeProcess],
    client: GoalClient,
    node: Node,
    spin_until: Callable[..., None],
    tmp_path: Path,
) -> None:
    content = load_yaml(CONFIG / "toy.yaml")
    variables = {"x1": {"around": "12.5 %"}, "x2": {"fixed": "present"}}
    content["/**"]["ros__parameters"]["variables"] = variables
    (tmp_path / "around.yaml").write_text(yaml.safe_dump(content))
    machine = toy_machine(node)
    machine.position = {"x1": 0.0, "x2": 1.25}
    problems = Listener(node, msg.Problem, "problem", LATCHED)
    start_tuner("initial_evaluations:=3", config=tmp_path / "around.yaml")
    client.send(Tune.Goal(run_id="around", evaluations=5))
    result = client.wait()
    assert result.error_code == 0, result.error_msg
    start = journal(tmp_path, "around")[0]["problem"]["variables"]
    assert (start["x1"]["min"], start["x1"]["max"], start["x2"]["fixed"]) == (-0.5, 0.5, 1.25)
    spin_until(lambda: problems.messages, "the problem")
    assert (problems.messages[-1].variables[0].min, problems.messages[-1].variables[0].max) == (
        -0.5,
        0.5,
    )
    client.send(Tune.Goal(run_id="again", evaluations=7, resume_from="around"))
    assert client.wait().error_code == 0
    assert journal(tmp_path, "again")[0]["problem"]["variables"] == start
    asked = [{item.name: item.value for item in goal.setpoint} for goal in machine.goals]
    assert len(asked) == 7
    assert all(abs(x["x1"]) <= 0.5 and x["x2"] == 1.25 for x in asked)


def test_a_run_begins_where_the_machine_is(
    start_tuner: Callable[..., NodeProcess], client: GoalClient, node: Node, tmp_path: Path
) -> None:
    machine = toy_machine(node)
    machine.position = {"x1": 0.5, "x2": -0.5}
    start_tuner("initial_evaluations:=3", config="safe.yaml")
    client.send(Tune.Goal(run_id="safe", evaluations=6))
    assert client.wait(60.0).error_code == 0
    asked = [{item.name: item.value for item in goal.setpoint} for goal in machine.goals]
    assert asked[0] == {"x1": 0.5, "x2": -0.5}
    assert max(abs(asked[1]["x1"] - 0.5), abs(asked[1]["x2"] + 0.5)) < 0.3
    history = History.from_records(read_journal(tmp_path / "runs" / "safe"))
    assert not any(comparison.differs for comparison in compare(history))
    assert all(e.feasible for e in history.evaluations)
