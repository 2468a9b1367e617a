"""Campaigns over real processes: their journal, their end, and what a kill leaves."""

from __future__ import annotations

import math
import os
import resource
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml

from mobo_tuner.errors import UserError
from mobo_tuner.files import load_yaml
from mobo_tuner.offline.campaign import resume, start
from mobo_tuner.offline.simulation import command_of
from mobo_tuner.runs.journal import FILE_NAME, Journal, read_journal
from mobo_tuner.runs.recorded_run import RecordedRun
from tests.support.paths import ROOT

TIMEOUT = 60.0
PROGRAM = """
import json, math, sys, time
x = json.load(sys.stdin)
if x["x1"] > 1.6:
    sys.exit("x1 is too large")
time.sleep(PAUSE)
print(json.dumps({"f1": math.hypot(x["x1"] - 1, x["x2"] - 1), "f2": math.hypot(x["x1"] + 1, x["x2"] + 1)}))
"""

FUNCTION = """
from optics import distance

def beam(point):
    x1, x2 = point["x1"], point["x2"]
    print("tracking")
    if x1 > 1.6:
        return {"f1": None, "f2": float("nan")}
    return {"f1": distance(x1 - 1, x2 - 1), "f2": distance(x1 + 1, x2 + 1)}
"""


class Bench:
    """Campaigns of the toy problem in a folder."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.started: list[subprocess.Popen[str]] = []

    def config(self, pause: float = 0.0, **campaign: Any) -> Path:
        (self.folder / "program.py").write_text(PROGRAM.replace("PAUSE", str(pause)))
        command = f"python {self.folder / 'program.py'}"
        bounds = {"min": -2.0, "max": 2.0}
        content = {
            "/**": {
                "variables": {"x1": bounds, "x2": bounds},
                "objectives": {"f1": {"reference": 4.3}, "f2": {"reference": 4.3}},
            },
            "tuner": {"evaluations": 10},
            "campaign": {"command": command, "timeout": 20.0, "workers": 3, **campaign},
        }
        path = self.folder / "campaign.yaml"
        sections = {name: {"ros__parameters": section} for name, section in content.items()}
        path.write_text(yaml.safe_dump(sections))
        return path

    def start(self, name: str, *arguments: object) -> subprocess.Popen[str]:
        words = [
            sys.executable,
            "-m",
            "mobo_tuner.offline.campaign",
            self.folder / name,
            *arguments,
        ]
        process = subprocess.Popen(
            [str(w) for w in words], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
        )
        self.started.append(process)
        return process

    def run(self, name: str, *arguments: object) -> tuple[int, str]:
        process = self.start(name, *arguments)
        _, errors = process.communicate(timeout=TIMEOUT)
        return process.returncode, errors

    def journal(self, name: str) -> list[dict[str, Any]]:
        path = self.folder / name
        return read_journal(path) if (path / FILE_NAME).exists() else []

    def evaluations(self, name: str) -> list[dict[str, Any]]:
        return [record for record in self.journal(name) if record["type"] == "evaluation"]

    def wait_until(self, condition: Callable[[], bool]) -> None:
        deadline = time.monotonic() + TIMEOUT
        while not condition():
            assert time.monotonic() < deadline
            time.sleep(0.05)

    def wait_for(self, name: str, evaluations: int) -> None:
        self.wait_until(lambda: len(self.evaluations(name)) >= evaluations)

    def simulating(self) -> list[str]:
        """Process ids of the simulations."""
        words = ["pgrep", "-f", str(self.folder / "program.py")]
        found = subprocess.run(words, capture_output=True, text=True, timeout=TIMEOUT, check=False)
        return found.stdout.split()

    def wait_until_none_simulates(self) -> None:
        self.wait_until(lambda: not self.simulating())


@pytest.fixture
def bench(tmp_path: Path) -> Iterator[Bench]:
    bench = Bench(tmp_path)
    yield bench
    for process in bench.started:
        process.kill()
        process.communicate(timeout=TIMEOUT)


def test_a_campaign_is_a_run_with_a_journal(bench: Bench) -> None:
    assert bench.run("one", "--config", bench.config(), "--seed", 3) == (0, "")
    run = RecordedRun.load(bench.folder / "one")
    assert len(run.evaluations) == 10
    assert run.stop_reason == "budget"
    assert run.settings["seed"] == 3
    assert run.optimizer.hypervolume == run.evaluations[-1].hypervolume > 8.0
    assert [e.index for e in run.evaluations] == list(range(10))
    for evaluation in run.evaluations:
        is_lost = evaluation.setpoint["x1"] > 1.6
        assert evaluation.failed == is_lost
        assert ("x1 is too large" in evaluation.error_msg) == is_lost


def test_the_shipped_file_with_fidelities_is_a_campaign(bench: Bench) -> None:
    content = load_yaml(ROOT / "config" / "fidelity.yaml")
    content["/**/tuner"]["ros__parameters"]["initial_evaluations"] = 2
    # After two cheap ones, a third costs more than may be spent before one at the highest fidelity.
    content["/**"]["ros__parameters"]["fidelity"]["cost"] = "0.4 + 0.6 * (mesh - 8) / 16"
    config = bench.folder / "fidelity.yaml"
    config.write_text(yaml.safe_dump(content))
    assert bench.run("one", "--config", config, "--evaluations", 4, "--workers", 2) == (0, "")
    run = RecordedRun.load(bench.folder / "one")
    meshes = [evaluation.setpoint["mesh"] for evaluation in run.evaluations]
    assert (len(meshes), meshes.count(8.0) >= 2, 24.0 in meshes) == (4, True, True)
    assert all(e.setpoint["mesh"] == 24.0 for e in run.evaluations if e.feasible)
    assert all(p["setpoint"]["mesh"] == 24.0 for p in run.optimizer.pareto_front())
    # A campaign that continues knows the fidelities, too.
    begun = resume(bench.folder / "one", bench.folder / "two", {"evaluations": 6})
    begun.log.close()
    assert [e.setpoint["mesh"] for e in begun.optimizer.dataset.evaluations] == meshes


def test_a_function_beside_the_file_simulates(bench: Bench) -> None:
    (bench.folder / "optics.py").write_text("from math import hypot as distance\n")
    (bench.folder / "beam.py").write_text(FUNCTION)
    config = bench.config(command="", function="beam.py:beam", workers=2)
    assert bench.run("one", "--config", config, "--evaluations", 5) == (0, "")
    evaluations = bench.evaluations("one")
    assert [e["valid"] for e in evaluations] == [e["setpoint"]["x1"] <= 1.6 for e in evaluations]
    assert sum(e["valid"] for e in evaluations) > 1
    for evaluation in evaluations:
        (value, _), x = evaluation["diagnostics"]["f1"], evaluation["setpoint"]
        assert value == (math.hypot(x["x1"] - 1.0, x["x2"] - 1.0) if x["x1"] <= 1.6 else None)


def test_files_beside_the_parameter_file_are_found_by_a_command(bench: Bench) -> None:
    path = bench.config()
    (bench.folder / "sub").mkdir()
    (bench.folder / "sub" / "deck").touch()
    (bench.folder / "evaluate").touch()
    section = {"function": ""}
    command = "python program.py evaluate sub/deck --in=program.py --no=other.py"
    found = command_of({**section, "command": command}, path.parent)
    program = bench.folder / "program.py"
    deck = bench.folder / "sub" / "deck"
    assert found == f"python {program} evaluate {deck} --in={program} --no=other.py"
    assert command_of({**section, "command": ""}, path.parent) == ""


def test_failures_from_the_start_are_told_and_end_in_an_error(bench: Bench) -> None:
    command = "python -c 'import sys; sys.exit(\"no licence\")'"
    words = ("--config", bench.config(command=command), "--evaluations", "8")
    process = bench.start("one", *words)
    output, errors = process.communicate(timeout=TIMEOUT)
    assert process.returncode == 1
    assert output.count("no licence") == 1
    assert errors.startswith("the campaign failed: all of its 8 evaluations failed")
    assert bench.journal("one")[-1]["stop_reason"] == "error"


def test_outputs_of_other_names_are_told(bench: Bench) -> None:
    command = """echo '{"F1": 1.0}'"""
    code, errors = bench.run("one", "--config", bench.config(command=command), "--evaluations", "4")
    assert code == 1
    assert "no number was given for any of f1, f2" in errors


def test_in_a_job_of_slurm_it_starts_no_step_of_its_own(
    bench: Bench, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    programs = tmp_path / "programs"
    programs.mkdir()
    for name in ("srun", "mpirun"):
        (programs / name).write_text(f"#!/bin/sh\ntouch {tmp_path / 'called'}\n")
        (programs / name).chmod(0o755)
    monkeypatch.setenv("SLURM_NODELIST", "node[1-2]")
    monkeypatch.setenv("PATH", f"{programs}:{os.environ['PATH']}")
    assert bench.run("one", "--config", bench.config(), "--evaluations", 3) == (0, "")
    assert len(bench.evaluations("one")) == 3
    assert not (tmp_path / "called").exists()


def test_what_was_finished_is_not_lost_by_a_kill(bench: Bench) -> None:
    first = bench.start("one", "--config", bench.config(pause=0.2), "--evaluations", 1000)
    bench.wait_for("one", 4)
    first.send_signal(signal.SIGKILL)
    first.wait(TIMEOUT)
    finished = bench.evaluations("one")
    budget = len(finished) + 3
    resumed = bench.run("two", "--resume", bench.folder / "one", "--evaluations", budget)
    assert resumed == (0, "")
    assert bench.evaluations("two")[: len(finished)] == finished
    assert len(bench.evaluations("two")) == budget
    assert RecordedRun.load(bench.folder / "two").stop_reason == "budget"
    status, error = bench.run("three", "--resume", bench.folder / "two", "--evaluations", budget)
    assert (status, len(error.splitlines())) == (1, 1)
    assert f"evaluations is {budget}" in error


def test_a_signal_ends_it_and_its_simulations(bench: Bench) -> None:
    process = bench.start("one", "--config", bench.config(pause=0.2), "--evaluations", 1000)
    bench.wait_for("one", 1)
    process.send_signal(signal.SIGTERM)
    process.communicate(timeout=TIMEOUT)
    assert process.returncode == 128 + signal.SIGTERM
    assert bench.journal("one")[-1]["stop_reason"] == "canceled"
    bench.wait_until_none_simulates()


def test_its_simulations_end_with_it_when_it_is_killed(bench: Bench) -> None:
    process = bench.start("one", "--config", bench.config(pause=600.0, timeout=900.0))
    bench.wait_until(lambda: len(bench.simulating()) == 3)
    process.kill()
    bench.wait_until_none_simulates()


@pytest.mark.parametrize(
    ("campaign", "words"),
    [
        ({"command": ""}, r"campaign\.command"),
        ({"workers": 0}, r"campaign\.workers is 0"),
        ({"function": "a.py:f"}, r"campaign\.command and campaign\.function"),
        ({"command": "python absent.py"}, r"campaign\.command .*'absent\.py'"),
        ({"command": "", "function": "absent.py:f"}, r"campaign\.function .*'absent\.py'"),
        ({"command": "", "function": "program.py"}, r"campaign\.function .*FILE\.py:FUNCTION"),
        ({"command": "", "function": "no.such:f"}, r"campaign\.function .*no\.such"),
        ({"command": "", "function": "math:no"}, r"campaign\.function .*no function 'no'"),
        ({"time_out": 3.0}, "time_out"),
    ],
)
def test_a_section_that_is_wrong_is_refused_before_anything_is_simulated(
    bench: Bench, campaign: dict[str, Any], words: str
) -> None:
    with pytest.raises(UserError, match=words):
        start(bench.config(**campaign), bench.folder / "one", {})
    assert not (bench.folder / "one").exists()


@pytest.mark.parametrize(
    ("path", "value", "words"),
    [
        (("campain", "workers"), 3, r"'campain' is unknown; did you mean 'campaign'"),
        (("tuner", "stop_after"), 60.0, r"tuner\.stop_after is 60"),
        (("tuner", "stop_without_gain"), 5, r"tuner\.stop_without_gain is 5"),
        (("tuner", "trust_distance"), 0.1, r"tuner\.trust_distance is 0\.1"),
        (("/**", "constraints", "c"), {"max": 1.0, "safe": 0.9}, r"constraints\.c\.safe is 0\.9"),
        (("/**", "variables", "x1"), {"around": "10 %"}, r"x1 depend on where a machine is"),
    ],
)
def test_what_a_campaign_cannot_obey_is_refused(
    bench: Bench, path: tuple[str, ...], value: Any, words: str
) -> None:
    file = bench.config()
    content = load_yaml(file)
    section, *names, last = path
    place = content.setdefault(section, {"ros__parameters": {}})["ros__parameters"]
    for name in names:
        place = place.setdefault(name, {})
    place[last] = value
    file.write_text(yaml.safe_dump(content))
    with pytest.raises(UserError, match=words):
        start(file, bench.folder / "one", {})
    assert not (bench.folder / "one").exists()


def test_a_journal_that_cannot_be_written_ends_it_with_one_sentence(bench: Bench) -> None:
    path = bench.config()
    process = bench.start("one", "--config", path)
    limit = 4000  # bytes of the largest file, with which the disk is full after some evaluations
    resource.prlimit(process.pid, resource.RLIMIT_FSIZE, (limit, limit))
    _, errors = process.communicate(timeout=TIMEOUT)
    assert process.returncode == 1
    assert errors.count("\n") == 1
    assert "cannot be written: File too large" in errors
    assert len(bench.evaluations("one")) in range(1, 10)
    bench.wait_until_none_simulates()


def test_a_run_that_was_no_campaign_is_not_resumed_as_one(bench: Bench) -> None:
    path = bench.config()
    optimizer, log, _ = start(path, bench.folder / "one", {})
    log.close()
    [record] = bench.journal("one")
    del record["settings"]["campaign"]
    (bench.folder / "one" / FILE_NAME).unlink()
    Journal.create(bench.folder / "one", [record]).close()
    with pytest.raises(UserError, match="no campaign"):
        resume(bench.folder / "one", bench.folder / "two", {"evaluations": 3})
    assert optimizer.pending == []
