"""A run that begins with old evaluations: collected by a program, resumed by the tuner."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
from rclpy.node import Node

from mobo_msgs_py.action import Tune
from mobo_tuner.nodes import warm_start
from tests.support.processes import NodeProcess
from tests.support.tuner import CONFIG, GoalClient, journal, toy_machine


def test_a_run_begins_with_old_evaluations(
    start_tuner: Callable[..., NodeProcess],
    client: GoalClient,
    node: Node,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    folder = tmp_path / "runs" / "data"
    sources = [str(CONFIG / "toy.yaml"), str(folder), str(CONFIG / "old_data.csv")]
    assert warm_start.main([*sources, "--evaluations=2"]) == 0
    assert "old_data.csv: 8 of 10 evaluations taken" in capsys.readouterr().out
    machine = toy_machine(node)
    start_tuner()
    client.send(Tune.Goal(run_id="new", resume_from="data"))
    result = client.wait(60.0)
    assert (result.error_code, result.evaluations, len(machine.goals)) == (0, 10, 2)
    records = journal(tmp_path, "new")
    sources = [record["source"] for record in records if record["type"] == "evaluation"]
    assert sources[:8] == ["operator"] * 8


def test_what_does_not_fit_is_said_and_leaves_nothing(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "other.csv").write_text("K1,dE\n1,2\n")
    words = [str(CONFIG / "toy.yaml"), str(tmp_path / "data"), str(tmp_path / "other.csv")]
    assert warm_start.main(words) == 2
    assert "1 left: without a value of 'x1'" in capsys.readouterr().err
    assert not (tmp_path / "data").exists()
