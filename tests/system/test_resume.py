"""Going on with a run that was killed, and all that can be done with what was kept of it."""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import yaml

from launcher.supervisor import EXIT_LIMIT
from tests.support.mobo_run import ROOT, TIMEOUT, Run, mcap_messages


def mobo(*words: object, status: int | None = 0) -> tuple[str, str]:
    """What `mobo.py` says, on standard output and error; it must end with `status`."""
    done = subprocess.run(
        [sys.executable, str(ROOT / "mobo.py"), *map(str, words)],
        capture_output=True,
        text=True,
        timeout=TIMEOUT,
        check=False,
    )
    assert "Traceback" not in done.stderr
    if status is not None:
        assert done.returncode == status, done.stderr
    return done.stdout, done.stderr


def digest(folder: Path) -> dict[str, str]:
    """What every file of a folder holds."""
    return {
        str(path.relative_to(folder)): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in folder.rglob("*")
        if path.is_file()
    }


def killed_run(
    start: Callable[..., Run],
    module: str,
    evaluations: int,
    budget: int,
    config: str = "toy.yaml",
    speed: str = "20",
) -> Run:
    """A run in which one process, or mobo.py itself, was killed."""
    run = start("--evaluations", str(budget), "--seed", "3", "--speed", speed, config=config)
    run.until(lambda: len(run.evaluations()) >= evaluations, f"{evaluations} evaluations")
    if module:
        os.kill(run.node(module), signal.SIGKILL)
    else:
        run.process.kill()
    status, _, said = run.wait()
    assert status not in (0, None)
    assert "Traceback" not in said
    run.assert_nothing_left(timeout=20.0 if module else EXIT_LIMIT)
    told = mcap_messages(run.folder / "bag", "/evaluation")
    assert 2 <= len(told) <= len(run.evaluations())
    return run


def test_a_run_whose_tuner_was_killed_goes_on_and_is_rebuilt_from_its_bag(
    start: Callable[..., Run], tmp_path: Path
) -> None:
    killed = killed_run(start, "mobo_tuner.nodes.tuner", 8, 12)
    told = killed.evaluations()
    assert 8 <= len(told) < 12
    before = digest(killed.folder)

    run = start("--evaluations", "12", resumed="run", run_id="more")
    status, out, said = run.wait()
    assert status == 0, said
    assert out.rstrip().splitlines()[-1] == str(run.folder)
    assert digest(killed.folder) == before
    assert run.evaluations()[: len(told)] == told
    assert len(run.evaluations()) == 12
    assert run.journal()[0]["resumed_from"] == {"run_id": "run", "evaluations": len(told)}
    facts = json.loads((run.folder / "run.json").read_text())
    assert (facts["resumed_from"], facts["state"]) == ("run", "finished")
    # What is asked for after the kill is what a run that was never killed asks for.
    out, _ = mobo("replay", run.folder)
    assert "12 evaluations, 12 suggestions computed again, 12 identical bit for bit" in out
    told_again = mcap_messages(run.folder / "bag", "/evaluation")
    assert [(m.run_id, m.index) for m in told_again] == [("more", i) for i in range(12)]

    # From the bag alone, as it is, and as it is when it was cut off.
    bag = tmp_path / "elsewhere" / "bag"
    shutil.copytree(run.folder / "bag", bag)
    mobo("rebuild", bag, "--runs-dir", tmp_path / "rebuilt", "--run-id", "whole")
    whole = Run(run.process, tmp_path / "rebuilt", "whole")
    kept = ("start", "evaluation", "change")
    assert [r for r in whole.journal() if r["type"] in kept] == [
        r for r in run.journal() if r["type"] in kept
    ]
    summary = json.loads((whole.folder / "summary.json").read_text())
    assert summary["hypervolume"] == run.evaluations()[-1]["hypervolume"]
    [file] = bag.glob("*.mcap")
    content = file.read_bytes()
    (tmp_path / "cut.mcap").write_bytes(content[: len(content) * 2 // 3])
    mobo("rebuild", tmp_path / "cut.mcap", "--runs-dir", tmp_path / "rebuilt", "--run-id", "cut")
    cut = Run(run.process, tmp_path / "rebuilt", "cut").evaluations()
    assert 0 < len(cut) <= 12
    assert cut == run.evaluations()[: len(cut)]
    out, _ = mobo("replay", bag)
    assert "12 identical bit for bit" in out


def test_a_run_with_a_context_is_killed_resumed_and_replayed_bit_for_bit(
    start: Callable[..., Run],
) -> None:
    killed = killed_run(start, "", 7, 500, "context.yaml", "100")
    told = killed.evaluations()
    charges = [record["diagnostics"]["charge"][0] for record in told]
    assert len(set(charges)) == len(charges)  # nobody sets it, and it changes
    budget = 10  # the initial design has 8 evaluations
    run = start("--evaluations", str(budget), resumed="run", run_id="more")
    status, _, err = run.wait()
    assert (status, err) == (0, "")
    assert run.evaluations()[: len(told)] == told
    assert run.evaluations()[-1]["source"] == "model"
    assert f"{budget} identical bit for bit" in mobo("replay", run.folder)[0]
    for message in mcap_messages(run.folder / "bag", "/evaluation"):
        [charge] = message.contexts
        assert charge.value == run.evaluations()[message.index]["diagnostics"]["charge"][0]
    last = mcap_messages(run.folder / "bag", "/status")[-1]
    assert [(c.name, c.unit) for c in last.contexts] == [("charge", "nC")]
    assert last.contexts[0].value == run.evaluations()[-1]["diagnostics"]["charge"][0]
    assert not last.stale_contexts
    mobo("export", run.folder)
    assert "charge" in (run.folder / "evaluations.csv").read_text().splitlines()[1]
    assert 'id="contexts"' in (run.folder / "report.html").read_text()


def test_bounds_constraints_and_objectives_may_change_when_a_killed_run_goes_on(
    start: Callable[..., Run], tmp_path: Path
) -> None:
    killed = killed_run(start, "", 5, 9)
    told = killed.evaluations()
    content = yaml.safe_load((ROOT / "config" / "toy.yaml").read_text())
    parameters = content["/**"]["ros__parameters"]
    parameters["variables"]["x1"] = {"min": -1.5, "max": 1.5}
    parameters["objectives"]["f2"] = {"reference": 3.5}
    parameters["constraints"] = {"g": {"max": 0.5}}
    config = tmp_path / "other.yaml"
    config.write_text(yaml.safe_dump(content))
    before = digest(killed.folder)

    run = start("--evaluations", "10", "--config", str(config), resumed="run", run_id="other")
    status, _, said = run.wait()
    assert status == 0, said
    assert digest(killed.folder) == before
    [change] = [r for r in run.journal() if r["type"] == "change"]
    assert (change["index"], change["budget"]) == (len(told), 10)
    assert change["problem"]["variables"]["x1"]["max"] == 1.5
    assert change["problem"]["constraints"]["g"]["max"] == 0.5
    later = run.evaluations()[len(told) :]
    assert len(later) == 10 - len(told)
    assert all(-1.5 <= r["setpoint"]["x1"] <= 1.5 for r in later)
    assert "identical bit for bit" in mobo("replay", run.folder)[0]
    summary = json.loads((run.folder / "summary.json").read_text())
    assert summary["reference_point"] == {"f1": 4.3, "f2": 3.5}
    out, _ = mobo("show", run.folder)
    assert "resumed from run" in out

    journal = (run.folder / "journal.jsonl").read_bytes()
    for name in ("summary.json", "report.html", "front.png", "hypervolume.png"):
        (run.folder / name).unlink()
    mobo("report", "other", "--runs-dir", run.runs_dir)
    assert json.loads((run.folder / "summary.json").read_text()) == summary
    assert (run.folder / "front.png").exists()
    assert "This run resumes run" in (run.folder / "report.html").read_text()
    assert (run.folder / "journal.jsonl").read_bytes() == journal

    runs_dir = ("--runs-dir", run.runs_dir)
    out, _ = mobo("export", "other", "--format", "parquet", *runs_dir)
    assert out == f"{run.folder / 'evaluations.parquet'}\n"
    out, _ = mobo("compare", "run", "other", *runs_dir)
    assert out == f"{run.runs_dir / 'compare.html'}\n"
    assert "another reference point" in (run.runs_dir / "compare.html").read_text()


@pytest.fixture
def spoilt(tmp_path: Path) -> Path:
    """A folder with runs and bags that are none."""
    (tmp_path / "runs" / "broken").mkdir(parents=True)
    (tmp_path / "runs" / "broken" / "journal.jsonl").write_text('{"type": "evaluation"}\n{}\n')
    (tmp_path / "runs" / "empty").mkdir()
    (tmp_path / "empty.mcap").write_bytes(b"\x89MCAP0\r\n")
    noise = np.random.default_rng(0).integers(0, 256, 5000, dtype=np.uint8).tobytes()
    (tmp_path / "noise.mcap").write_bytes(noise)
    return tmp_path


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        ("resume nothing", "there is no run 'nothing'"),
        ("resume empty", "there is no run 'empty'"),
        ("resume broken", "does not begin with a start record"),
        ("resume broken --run-id ../out", "'../out' is not a run id"),
        ("resume ../../etc", "there is no run '../../etc'"),
        ("report broken", "does not begin with a start record"),
        ("export broken", "does not begin with a start record"),
        ("compare broken broken", "does not begin with a start record"),
        ("compare broken nothing", "there is no run 'nothing'"),
        ("replay broken", "does not begin with a start record"),
        ("replay {0}/noise.mcap", "is not an MCAP file"),
        ("rebuild {0}/noise.mcap", "is not an MCAP file"),
        ("rebuild {0}/empty.mcap", "holds no run with its problem"),
        ("rebuild {0}/nowhere", "cannot be read: No such file"),
        ("rebuild {0}/runs/empty", "holds no MCAP file and no SQLite file"),
    ],
)
def test_what_is_no_run_is_refused_in_one_sentence(spoilt: Path, words: str, sentence: str) -> None:
    runs_dir = ("--runs-dir", spoilt / "runs")
    before = digest(spoilt)
    _, said = mobo(*words.format(spoilt).split(), *runs_dir, status=None)
    [line] = said.strip().splitlines()
    assert line.startswith("mobo.py: ")
    assert sentence in line
    assert digest(spoilt) == before
