"""The main job, as a user starts it: `python3 mobo.py run`, and what happens when things break."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import pytest
from rosbags.highlevel import AnyReader

from tests.support.mobo_run import ROOT, TIMEOUT, Run, mcap_messages, rosbags_count
from tests.system.conftest import runs_in

EXIT_LIMIT = 5.0  # [s] from a signal to the end, as promised


class Ended(NamedTuple):
    """A run that has ended by itself, its exit status and what it printed."""

    run: Run
    status: int
    out: str
    err: str


@pytest.fixture(scope="module")
def pair(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Ended, Ended]]:
    """Two runs at once, with different seeds."""
    with runs_in(tmp_path_factory.mktemp("pair")) as start:
        one = start("--evaluations", "9", "--seed", "4", "--speed", "10", run_id="one")
        two = start("--evaluations", "8", "--seed", "2", run_id="two")
        yield Ended(one, *one.wait()), Ended(two, *two.wait())


def test_a_run_leaves_a_summary_pictures_a_journal_and_a_bag(pair: tuple[Ended, Ended]) -> None:
    run, status, out, err = pair[0]
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
    assert [beat.run_id for beat in beats][-2:] == ["one", ""]
    [problem] = mcap_messages(run.folder / "bag", "/problem")
    assert [o.name for o in problem.objectives] == ["f1", "f2"]
    with AnyReader([run.folder / "bag"]) as reader:
        [latched] = [c for c in reader.connections if c.topic == "/problem"]
        extension: Any = latched.ext
        [profile] = extension.offered_qos_profiles
        assert profile.durability.name == "TRANSIENT_LOCAL"
        assert profile.reliability.name == "RELIABLE"


def test_a_run_of_the_same_name_is_refused(pair: tuple[Ended, Ended]) -> None:
    run = pair[0].run
    with runs_in(run.runs_dir.parent) as start:
        status, _, err = start("--evaluations", "1", run_id="one").wait()
    assert status != 0
    assert "exists" in err
    assert len(run.evaluations()) == 9


def test_two_runs_side_by_side_do_not_disturb_each_other(pair: tuple[Ended, Ended]) -> None:
    for (run, status, _, err), count in zip(pair, (9, 8), strict=True):
        assert status == 0, err
        told = mcap_messages(run.folder / "bag", "/evaluation")
        assert [(m.run_id, m.index) for m in told] == [(run.run_id, i) for i in range(count)]
    first, second = ([r["setpoint"] for r in ended.run.evaluations()] for ended in pair)
    assert first[:8] != second


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
@pytest.mark.parametrize("moment", ["starting", "tuning"])
def test_a_signal_ends_everything_in_time(
    start: Callable[..., Run], number: signal.Signals, moment: str
) -> None:
    is_open = number == signal.SIGINT  # to other hosts, which is asked for
    run = start("--speed", "50", *["--network"][: int(is_open)], config="awa.yaml")
    if moment == "starting":
        run.until(lambda: (run.folder / "run.json").exists(), "the run folder")
    else:
        run.until(lambda: len(run.evaluations()) >= 2, "two evaluations")
        assert_reach(run, "SUBNET" if is_open else "LOCALHOST")
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


def assert_reach(run: Run, reach: str) -> None:
    """Check how far the nodes of a run may be found."""
    for module in ("mobo_tuner.nodes.tuner", "awa_sim_node", "mobo_tuner.nodes.recorder"):
        environment = Path(f"/proc/{run.node(module)}/environ").read_bytes().split(b"\0")
        assert f"ROS_AUTOMATIC_DISCOVERY_RANGE={reach}".encode() in environment


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
