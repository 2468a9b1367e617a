"""The main job, as a user starts it: `python3 mobo.py run`, and what happens when things break."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from rosbags.highlevel import AnyReader

from tests.support.mobo_run import ROOT, TIMEOUT, Run, mcap_messages, rosbags_count

EXIT_LIMIT = 5.0  # [s] from a signal to the end, as promised


def test_a_run_leaves_a_summary_pictures_a_journal_and_a_bag(start: Callable[..., Run]) -> None:
    # Some seconds long: a recorder on a busy computer may miss part of a run of half a second.
    run = start("--evaluations", "9", "--seed", "4", "--speed", "10")
    status, out, err = run.wait()
    assert status == 0, err
    assert out.rstrip().splitlines()[-1] == str(run.folder)
    run.assert_nothing_left()

    summary = json.loads((run.folder / "summary.json").read_text())
    assert (summary["evaluations"], summary["failed"], summary["feasible"]) == (9, 0, 9)
    assert summary["stop_reason"] == "budget"
    assert summary["reference_point"] == {"f1": 4.3, "f2": 4.3}
    assert summary["hypervolume"] == run.evaluations()[-1]["hypervolume"]
    assert summary["hypervolume_measured"] == run.evaluations()[-1]["hypervolume_measured"]
    told_of_a_point = {"index", "setpoint", "objectives", "stddevs", "predicted", "probability"}
    assert set(summary["pareto_front"][0]) == told_of_a_point
    page = (run.folder / "report.html").read_text()
    assert "The run made 9 evaluations" in page
    assert "numpy" in page, "the versions of run.json"
    assert set(summary["pareto_front"][0]["setpoint"]) == {"x1", "x2"}
    seconds = summary["seconds"]
    assert 0.0 < seconds["overhead_median"] < seconds["evaluate_median"] + 1.0
    assert seconds["suggest_median"] > 0.0
    for picture in ("hypervolume.png", "front.png"):
        data = (run.folder / picture).read_bytes()
        assert data.startswith(b"\x89PNG")
        assert len(data) > 5000

    told = mcap_messages(run.folder / "bag", "/evaluation")
    assert [m.index for m in told] == list(range(9))
    assert [m.hypervolume for m in told] == [r["hypervolume"] for r in run.evaluations()]
    assert rosbags_count(run.folder / "bag", "/evaluation") == 9
    beats = mcap_messages(run.folder / "bag", "/heartbeat")
    assert [beat.run_id for beat in beats][-2:] == ["run", ""]
    [problem] = mcap_messages(run.folder / "bag", "/problem")
    assert [o.name for o in problem.objectives] == ["f1", "f2"]
    with AnyReader([run.folder / "bag"]) as reader:
        [latched] = [c for c in reader.connections if c.topic == "/problem"]
        extension: Any = latched.ext
        [profile] = extension.offered_qos_profiles
        assert profile.durability.name == "TRANSIENT_LOCAL"
        assert profile.reliability.name == "RELIABLE"

    again = start("--evaluations", "1")
    status, _, err = again.wait()
    assert status != 0
    assert "exists" in err
    assert len(run.evaluations()) == 9


def test_two_runs_side_by_side_do_not_disturb_each_other(start: Callable[..., Run]) -> None:
    runs = [
        start("--evaluations", "8", "--seed", "1", run_id="one"),
        start("--evaluations", "8", "--seed", "2", run_id="two"),
    ]
    for run in runs:
        status, _, err = run.wait()
        assert status == 0, err
        told = mcap_messages(run.folder / "bag", "/evaluation")
        assert [(m.run_id, m.index) for m in told] == [(run.run_id, i) for i in range(8)]
    setpoints = [[r["setpoint"] for r in run.evaluations()] for run in runs]
    assert setpoints[0] != setpoints[1]


@pytest.mark.parametrize(("options", "reach"), [((), "LOCALHOST"), (("--network",), "SUBNET")])
def test_a_run_is_open_to_other_hosts_only_where_that_is_asked_for(
    start: Callable[..., Run], options: tuple[str, ...], reach: str
) -> None:
    run = start("--evaluations", "1000", *options)
    run.until(lambda: run.evaluations(), "an evaluation")
    for module in ("mobo_tuner.nodes.tuner", "awa_sim_node", "mobo_tuner.nodes.recorder"):
        environment = Path(f"/proc/{run.node(module)}/environ").read_bytes().split(b"\0")
        assert f"ROS_AUTOMATIC_DISCOVERY_RANGE={reach}".encode() in environment
    run.process.send_signal(signal.SIGINT)
    assert run.wait()[0] == 130
    run.assert_nothing_left()


def test_a_killed_machine_ends_the_run_with_a_clear_error(start: Callable[..., Run]) -> None:
    run = start("--speed", "50", config="awa.yaml")
    run.until(lambda: len(run.evaluations()) >= 2, "two evaluations")
    os.kill(run.node("awa_sim_node.node"), signal.SIGKILL)
    finished = len(run.evaluations())
    status, out, err = run.wait()
    assert status not in (0, None)
    assert "awa_sim" in err
    assert "Traceback" not in err
    assert out.rstrip().splitlines()[-1] == str(run.folder)
    run.assert_nothing_left()
    assert len(run.evaluations()) >= finished
    told = mcap_messages(run.folder / "bag", "/evaluation")
    assert [m.index for m in told] == [r["index"] for r in run.evaluations()]
    summary = json.loads((run.folder / "summary.json").read_text())
    assert summary["evaluations"] == len(told)
    assert summary["stop_reason"] == "canceled"  # by mobo.py, which knows that it will not return


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
@pytest.mark.parametrize("moment", ["starting", "tuning"])
def test_a_signal_ends_everything_in_time(
    start: Callable[..., Run], number: signal.Signals, moment: str
) -> None:
    run = start("--speed", "50", config="awa.yaml")
    if moment == "starting":
        run.until(lambda: (run.folder / "run.json").exists(), "the run folder")
    else:
        run.until(lambda: len(run.evaluations()) >= 2, "two evaluations")
    run.process.send_signal(number)
    sent = time.monotonic()
    status, _, err = run.wait(timeout=30.0)
    assert time.monotonic() - sent < EXIT_LIMIT
    assert status == 128 + number
    assert "Traceback" not in err
    run.assert_nothing_left()
    if moment == "tuning":
        told = mcap_messages(run.folder / "bag", "/evaluation")
        assert [m.index for m in told] == [r["index"] for r in run.evaluations()]
        assert rosbags_count(run.folder / "bag", "/evaluation") == len(told)


def test_when_mobo_itself_is_killed_nothing_is_left(start: Callable[..., Run]) -> None:
    run = start("--speed", "50", config="awa.yaml")
    run.until(lambda: len(run.evaluations()) >= 2, "two evaluations")
    run.process.kill()
    run.process.wait(timeout=5.0)
    run.assert_nothing_left(timeout=EXIT_LIMIT)
    told = mcap_messages(run.folder / "bag", "/evaluation")
    assert len(told) >= 2


def test_a_bad_configuration_starts_nothing(tmp_path: Path) -> None:
    text = (ROOT / "config" / "awa.yaml").read_text()
    config = tmp_path / "bad.yaml"
    config.write_text(text.replace("min: 400.0", "min: 300.0"))
    done = subprocess.run(
        [
            *(sys.executable, str(ROOT / "mobo.py"), "run"),
            *("--config", str(config), "--runs-dir", str(tmp_path / "runs")),
        ],
        capture_output=True,
        text=True,
        timeout=TIMEOUT,
        check=False,
    )
    assert done.returncode not in (0, None)
    [sentence] = [line for line in done.stderr.splitlines() if "variables.K1.min" in line]
    assert "is 300 A, outside the machine's limits of 400 to 550" in sentence
    assert not (tmp_path / "runs").exists()
