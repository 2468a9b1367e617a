"""The method of a tuner's node: chosen by parameters, recorded, and what the core does with it."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import yaml
from rclpy.node import Node

from mobo_msgs_py import msg
from mobo_msgs_py.action import EvaluateSetpoint, Tune
from mobo_msgs_py.srv import Ask, Tell
from mobo_tuner.core import Optimizer, Problem
from mobo_tuner.core.settings import method_of
from mobo_tuner.runs.history import History
from mobo_tuner.runs.journal import read_journal
from mobo_tuner.runs.replay import compare
from tests.support.processes import NodeProcess, NodeStarter
from tests.support.tuner import CONFIG, GoalClient, Services, toy_machine, toy_values

CHOSEN: dict[str, Any] = {
    "initial_evaluations": 4,
    "acquisition": "ucb_hvi",
    "beta": 0.5,
    "kernel": "rbf",
    "noise": 0.01,
    "proximal": [2.0, 1.0, 1.0, 2.0],
    "maximizer_settings": {"screened": 64, "finished": 3},
}


@pytest.mark.parametrize("way", ["command line", "file"])
def test_a_tuner_asks_what_the_core_asks_with_the_same_choices(
    start_node: NodeStarter, services: Services, tmp_path: Path, way: str
) -> None:
    files = ["--params-file", str(CONFIG / "toy.yaml")]
    line = ["-p", f"runs_dir:={tmp_path}", "-p", "seed:=5"]
    if way == "file":
        chosen = tmp_path / "chosen.yaml"
        chosen.write_text(yaml.safe_dump({"tuner": {"ros__parameters": CHOSEN}}))
        files += ["--params-file", str(chosen)]
    else:
        line += ["-p", "acquisition:=ucb_hvi", "-p", "beta:=0.5", "-p", "kernel:=rbf"]
        line += ["-p", "noise:=0.01", "-p", "proximal:=[2.0, 1.0, 1.0, 2.0]"]
        line += ["-p", "maximizer_settings.screened:=64", "-p", "maximizer_settings.finished:=3"]
        line += ["-p", "initial_evaluations:=4"]
    start_node("-m", "mobo_tuner.nodes.tuner", "--ros-args", *files, *line)
    oracle = Optimizer(Problem.from_yaml(CONFIG / "toy.yaml"), seed=5, **CHOSEN)
    for _ in range(7):
        asked = services.call(Ask, "ask")
        assert asked.success, asked.message
        x = {item.name: item.value for item in asked.setpoint}
        assert x == oracle.ask()
        values = toy_values(EvaluateSetpoint.Goal(setpoint=asked.setpoint))
        diagnostics = [msg.NamedValue(name=n, value=v) for n, v in values.items()]
        told = services.call(
            Tell, "tell", Tell.Request(setpoint=asked.setpoint, diagnostics=diagnostics)
        )
        assert told.success, told.message
        measured = {d.name: (d.value, d.stddev) for d in diagnostics}
        oracle.tell(x, measured)
    (journal,) = tmp_path.glob("*/journal.jsonl")
    history = History.from_records(read_journal(journal.parent))
    assert method_of(history.settings) == oracle.settings
    assert not any(comparison.differs for comparison in compare(history))


def test_a_resumed_run_keeps_the_method_of_its_journal(
    start_tuner: Callable[..., NodeProcess], client: GoalClient, node: Node, tmp_path: Path
) -> None:
    toy_machine(node)
    first = start_tuner("initial_evaluations:=3", "kernel:=rbf", "maximizer_settings.steps:=2")
    client.send(Tune.Goal(run_id="first", evaluations=5))
    assert client.wait().error_code == Tune.Result.NONE
    assert first.stop() == 0
    start_tuner("kernel:=rbf_full", "preset:=paper")
    client.send(Tune.Goal(run_id="second", evaluations=7, resume_from="first"))
    result = client.wait()
    assert (result.error_code, result.evaluations) == (Tune.Result.NONE, 7)
    earlier, later = (
        History.from_records(read_journal(tmp_path / "runs" / name)) for name in ("first", "second")
    )
    assert method_of(later.settings) == method_of(earlier.settings)
    assert method_of(later.settings).maximizer_settings["steps"] == 2
    assert not any(comparison.differs for comparison in compare(later))


@pytest.mark.parametrize(
    ("parameters", "name", "value"),
    [
        (("acquisition:=ei",), "acquisition", "weights"),
        (("proximal:=true",), "proximal", "True"),
        (("maximizer_settings.screen:=5",), "maximizer_settings.screen", "screened"),
        (("constraint.f1.max:=1.0",), "constraint", "'constraints'"),
    ],
)
def test_a_choice_that_is_not_allowed_is_said_at_the_start(
    start_tuner: Callable[..., NodeProcess], parameters: tuple[str, ...], name: str, value: str
) -> None:
    process = start_tuner(*parameters)
    assert process.wait() == 2
    (line,) = process.stderr.strip().splitlines()
    assert line.startswith("cannot start: ")
    assert name in line
    assert value in line


def test_a_preset_of_the_manual_is_a_file_for_the_node(
    start_node: NodeStarter, services: Services, tmp_path: Path
) -> None:
    files = [CONFIG / "toy.yaml", CONFIG / "presets" / "paper.yaml"]
    options = [word for file in files for word in ("--params-file", str(file))]
    line = ["-p", f"runs_dir:={tmp_path}"]
    start_node("-m", "mobo_tuner.nodes.tuner", "--ros-args", *options, *line)
    assert services.call(Ask, "ask").success
    (journal,) = tmp_path.glob("*/journal.jsonl")
    history = History.from_records(read_journal(journal.parent))
    paper = Optimizer(Problem.from_yaml(CONFIG / "toy.yaml"), preset="paper")
    assert method_of(history.settings) == paper.settings
