"""The main job, as a user starts it: `python3 mobo.py run`, and what happens when things break."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from rosbags.highlevel import AnyReader

ROOT = Path(__file__).resolve().parents[2]
TIMEOUT = 60.0  # [s] for anything but a whole run
EXIT_LIMIT = 5.0  # [s] from a signal to the end, as promised


@dataclass
class Run:
    """A run of mobo.py in a folder of its own."""

    process: subprocess.Popen[str]
    runs_dir: Path
    run_id: str

    @property
    def folder(self) -> Path:
        return self.runs_dir / self.run_id

    def wait(self, timeout: float = 150.0) -> tuple[int, str, str]:
        """Exit status, standard output and standard error."""
        out, err = self.process.communicate(timeout=timeout)
        return self.process.returncode, out, err

    def journal(self) -> list[dict[str, Any]]:
        path = self.folder / "journal.jsonl"
        if not path.exists():
            return []
        lines = path.read_text(encoding="utf-8").splitlines()
        with contextlib.suppress(ValueError):
            return [json.loads(line) for line in lines]
        return [json.loads(line) for line in lines[:-1]]

    def evaluations(self) -> list[dict[str, Any]]:
        return [r for r in self.journal() if r["type"] == "evaluation"]

    def processes(self) -> dict[int, str]:
        """Command lines of all processes that know of this run, but for mobo.py itself."""
        found = {}
        for path in Path("/proc").glob("[0-9]*/cmdline"):
            with contextlib.suppress(OSError):
                words = path.read_bytes().replace(b"\0", b" ").decode(errors="replace")
                if str(self.folder) in words and int(path.parent.name) != self.process.pid:
                    found[int(path.parent.name)] = words
        return found

    def node(self, module: str) -> int:
        """Process id of one of its nodes."""
        [pid] = [pid for pid, words in self.processes().items() if module in words]
        return pid

    def until(self, condition: Callable[[], object], what: str, timeout: float = TIMEOUT) -> None:
        deadline = time.monotonic() + timeout
        while not condition():
            if self.process.poll() is not None:
                pytest.fail(f"the run ended before {what}: {self.wait()}")
            if time.monotonic() > deadline:
                pytest.fail(f"waited {timeout:g} s in vain for {what}")
            time.sleep(0.02)

    def assert_nothing_left(self) -> None:
        deadline = time.monotonic() + 2.0
        while self.processes() and time.monotonic() < deadline:
            time.sleep(0.02)
        assert self.processes() == {}


@pytest.fixture
def start(tmp_path: Path) -> Iterator[Callable[..., Run]]:
    started: list[Run] = []

    def start(*arguments: str, config: str = "toy.yaml", run_id: str = "run") -> Run:
        runs_dir = tmp_path / "runs"
        process = subprocess.Popen(
            [
                *(sys.executable, str(ROOT / "mobo.py"), "run"),
                *("--config", str(ROOT / "config" / config), "--runs-dir", str(runs_dir)),
                *("--run-id", run_id, "--no-dashboard", *arguments),
            ],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            start_new_session=True,
        )
        started.append(Run(process, runs_dir, run_id))
        return started[-1]

    yield start
    for run in started:
        with contextlib.suppress(ProcessLookupError):
            os.killpg(run.process.pid, signal.SIGKILL)
        run.process.communicate(timeout=10.0)
        for pid in run.processes():
            with contextlib.suppress(ProcessLookupError):
                os.kill(pid, signal.SIGKILL)


def mcap_messages(bag: Path, topic: str) -> list[Any]:
    """All messages of a topic, read by the mcap libraries."""
    [file] = bag.glob("*.mcap")
    with file.open("rb") as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        return [decoded for *_, decoded in reader.iter_decoded_messages(topics=[topic])]


def rosbags_count(bag: Path, topic: str) -> int:
    with AnyReader([bag]) as reader:
        wanted = [c for c in reader.connections if c.topic == topic]
        return sum(1 for _ in reader.messages(connections=wanted)) if wanted else 0


def test_a_run_leaves_a_summary_pictures_a_journal_and_a_bag(start: Callable[..., Run]) -> None:
    run = start("--evaluations", "9", "--seed", "4")
    status, out, err = run.wait()
    assert status == 0, err
    assert out.rstrip().splitlines()[-1] == str(run.folder)
    run.assert_nothing_left()

    summary = json.loads((run.folder / "summary.json").read_text())
    assert (summary["evaluations"], summary["failed"], summary["feasible"]) == (9, 0, 9)
    assert summary["stop_reason"] == "budget"
    assert summary["reference_point"] == {"f1": 4.3, "f2": 4.3}
    assert summary["hypervolume"] == run.evaluations()[-1]["hypervolume"]
    assert set(summary["pareto_front"][0]) == {"index", "setpoint", "objectives"}
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
        [profile] = latched.ext.offered_qos_profiles
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
    deadline = time.monotonic() + EXIT_LIMIT
    while run.processes() and time.monotonic() < deadline:
        time.sleep(0.05)
    assert run.processes() == {}
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
