"""The verbs that concern a running tuner: which one they find, and what they hand on."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

import pytest

from launcher.command_line import STEERING
from mobo_tuner.nodes.steer import VERBS
from tests.support.fake_project import FakeProject, wait_until


@pytest.fixture
def project(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[FakeProject]:
    monkeypatch.delenv("ROS_DOMAIN_ID", raising=False)
    monkeypatch.delenv("ROS_AUTOMATIC_DISCOVERY_RANGE", raising=False)
    project = FakeProject(tmp_path)
    yield project
    project.close()


def begin(project: FakeProject, run_id: str, *options: str) -> str:
    """Start a run that waits; return its ROS domain."""
    before = project.events.count("console ready")
    project.start("run", "--run-id", run_id, *options, console="wait")
    wait_until(lambda: project.events.count("console ready") > before, "the run")
    facts = json.loads((project.root / "runs" / run_id / "run.json").read_text())
    return str(facts["domain_id"])


def test_every_verb_of_the_program_is_a_verb_of_the_entry_script() -> None:
    assert [*STEERING] == [*VERBS]


def test_the_one_run_that_is_going_on_is_found(project: FakeProject) -> None:
    status, _, errors = project.run("pause")
    assert status == 2
    assert "ROS_DOMAIN_ID" in errors

    broken = project.root / "runs" / "broken"
    broken.mkdir(parents=True)
    (broken / "run.json").write_text("{")
    domain = begin(project, "one")
    status, output, _ = project.run("set", "variables.x.max=3", "a=[0, 1]")
    assert status == 0
    assert json.loads(output) == [["set", "variables.x.max=3", "a=[0, 1]"], domain, "LOCALHOST"]
    status, output, _ = project.run("go", "3", "--hold", "2", "--run", "old")
    assert json.loads(output)[:2] == [["go", "3", "--hold", "2", "--run", "old"], domain]
    status, output, _ = project.run("stop", "--run", "one", steer="refuse")
    assert (status, json.loads(output)[:2]) == (1, [["stop"], domain])
    status, _, errors = project.run("stop", "--run", "old")
    assert status != 0
    assert "'old'" in errors


def test_which_of_several_tuners_is_meant_must_be_said(
    project: FakeProject, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("ROS_DOMAIN_ID", "17")
    status, output, _ = project.run("status")
    assert (status, json.loads(output)) == (0, [["status"], "17", None])

    domain = begin(project, "one")
    assert domain != "17"
    status, _, errors = project.run("cancel")
    assert status == 2
    for named in ("'one'", domain, "17", "--domain-id"):
        assert named in errors
    assert json.loads(project.run("cancel", "--domain-id", "17")[1])[1] == "17"
    assert json.loads(project.run("cancel", "--run", "one")[1])[1] == domain
    monkeypatch.setenv("ROS_DOMAIN_ID", domain)
    assert json.loads(project.run("cancel")[1])[1] == domain
    monkeypatch.delenv("ROS_DOMAIN_ID")

    other = begin(project, "two", "--network")
    status, _, errors = project.run("cancel")
    assert status == 2
    assert "'one'" in errors
    assert "'two'" in errors
    # A verb looks for a run where the run is: on this host alone, or also on others.
    assert json.loads(project.run("watch", "--run", "two")[1]) == [["watch"], other, "SUBNET"]
    assert json.loads(project.run("watch", "--run", "one")[1]) == [["watch"], domain, "LOCALHOST"]
