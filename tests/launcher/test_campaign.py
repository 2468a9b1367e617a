"""The verb `campaign`: folders, arguments and ends."""

from __future__ import annotations

import json
import signal
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from tests.support.fake_project import TIMEOUT, FakeProject


@pytest.fixture
def project(tmp_path: Path) -> Iterator[FakeProject]:
    project = FakeProject(tmp_path)
    (tmp_path / "config" / "campaign.yaml").write_text("/**: {}\n")
    yield project
    project.close()


def facts(project: FakeProject, run: str) -> dict[str, Any]:
    content: dict[str, Any] = json.loads((project.root / "runs" / run / "run.json").read_text())
    return content


def test_a_campaign_ends_with_its_folder_and_a_report(project: FakeProject) -> None:
    status, output, errors = project.run("campaign", "--run-id", "one", "--workers", "3")
    assert (status, errors) == (0, "")
    folder = project.root / "runs" / "one"
    assert output.splitlines()[-1] == str(folder)
    assert "the front" in output
    assert facts(project, "one")["state"] == "finished"
    config = project.root / "config" / "campaign.yaml"
    assert project.arguments("campaign")[-3:] == [str(folder), "--workers=3", f"--config={config}"]
    assert (folder / "config.yaml").read_text() == config.read_text()
    assert facts(project, "one")["arguments"] == {"config": str(config), "seed": None}


def test_a_campaign_is_continued_beside_the_earlier_one(project: FakeProject) -> None:
    project.run("campaign", "--run-id", "one")
    words = ("--evaluations", "90", "--listen", "10.0.0.1")
    status, output, _ = project.run("campaign", "--resume", "one", *words)
    assert status == 0
    assert output.splitlines()[-1] == str(project.root / "runs" / "one-2")
    earlier = project.root / "runs" / "one"
    given = ["--evaluations=90", "--listen=10.0.0.1", f"--resume={earlier}"]
    assert project.arguments("campaign")[-3:] == given
    assert facts(project, "one-2")["resumed_from"] == "one"


def test_a_campaign_that_is_refused_leaves_no_folder(project: FakeProject) -> None:
    status, _, errors = project.run("campaign", "--run-id", "one", campaign="crash")
    assert (status, errors) == (2, "mobo.py: the magnet quenched\n")
    assert not (project.root / "runs" / "one").exists()


def test_a_campaign_that_failed_has_a_report_and_the_reason(project: FakeProject) -> None:
    status, output, errors = project.run("campaign", "--run-id", "one", campaign="fail")
    assert (status, errors) == (2, "mobo.py: the klystron tripped\n")
    assert output.splitlines()[-2:] == ["the front", str(project.root / "runs" / "one")]
    assert facts(project, "one")["state"] == "failed"


def test_a_signal_ends_a_campaign_and_keeps_it(project: FakeProject) -> None:
    process = project.start("campaign", "--run-id", "one", campaign="wait")
    project.wait_for_event("campaign ready")
    assert facts(project, "one")["state"] == "running"
    process.send_signal(signal.SIGINT)
    process.communicate(timeout=TIMEOUT)
    assert process.returncode == 128 + signal.SIGINT
    assert facts(project, "one")["state"] == "interrupted"
    assert "campaign stopped" in project.events
    assert project.alive() == []
