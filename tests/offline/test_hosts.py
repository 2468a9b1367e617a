"""Workers on other hosts: they simulate, may be lost and replaced, and let nobody in who is a stranger."""

from __future__ import annotations

import json
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from mobo_tuner.errors import ParameterError
from mobo_tuner.offline import worker
from mobo_tuner.offline.hosts import FILE_NAME, Hosts

TIMEOUT = 60.0
PROGRAM = """
import json, os, sys, time
x = json.load(sys.stdin)
if x["x"] < 0.0:
    sys.exit("x is too small")
if x["x"] > 1.0:
    with open(f"worker-{os.getppid()}", "w"):
        pass
    while not os.path.exists("../go"):
        time.sleep(0.02)
print(json.dumps({"f": 2.0 * x["x"], "g": None}))
"""


class Cluster:
    """Some workers of one campaign."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        (folder / "program.py").write_text(PROGRAM)
        command = f"python {folder / 'program.py'}"
        self.hosts = Hosts("127.0.0.1", {"command": command, "timeout": TIMEOUT}, folder)
        self.workers: list[subprocess.Popen[str]] = []

    def add(self) -> None:
        words = [sys.executable, "-m", "mobo_tuner.offline.worker", str(self.folder)]
        self.workers.append(subprocess.Popen(words, stderr=subprocess.PIPE, text=True))

    def busy(self) -> list[int]:
        """Process ids of the workers that simulated one that waits, in no order."""
        return [int(p.name.split("-")[1]) for p in self.folder.glob("simulations/*/worker-*")]

    def wait_until(self, condition: Callable[[], bool]) -> None:
        deadline = time.monotonic() + TIMEOUT
        while not condition():
            assert time.monotonic() < deadline
            time.sleep(0.02)

    def close(self) -> None:
        self.hosts.stop()
        for each in self.workers:
            each.kill()
            each.communicate(timeout=TIMEOUT)


@pytest.fixture
def cluster(tmp_path: Path) -> Iterator[Cluster]:
    cluster = Cluster(tmp_path)
    yield cluster
    cluster.close()


def test_workers_simulate_and_end_with_the_campaign(cluster: Cluster) -> None:
    with ThreadPoolExecutor(4) as threads:  # more points than workers, which join later
        outcomes = threads.map(lambda i: cluster.hosts.run(i, {"x": i / 10.0 - 0.1}), range(4))
        cluster.add()
        cluster.add()
        failed, *good = outcomes
    assert "x is too small" in failed.error
    assert [outcome.outputs["f"] for outcome in good] == pytest.approx([0.0, 0.2, 0.4])
    assert all(outcome.outputs["g"] != outcome.outputs["g"] for outcome in good)  # NaN
    cluster.hosts.stop()
    assert [each.wait(TIMEOUT) for each in cluster.workers] == [0, 0]
    assert not (cluster.folder / FILE_NAME).exists()
    assert "stopped" in cluster.hosts.run(9, {"x": 0.0}).error


def test_what_a_lost_worker_simulated_is_simulated_by_another(cluster: Cluster) -> None:
    cluster.add()
    with ThreadPoolExecutor(1) as threads:
        outcome = threads.submit(cluster.hosts.run, 0, {"x": 2.0})
        cluster.wait_until(lambda: len(cluster.busy()) == 1)
        cluster.add()
        cluster.workers[0].kill()
        cluster.wait_until(lambda: len(cluster.busy()) == 2)
        (cluster.folder / "simulations" / "go").touch()
        assert outcome.result(TIMEOUT).outputs["f"] == 4.0
    assert set(cluster.busy()) == {each.pid for each in cluster.workers}


def test_a_point_with_which_workers_are_lost_again_and_again_has_failed(cluster: Cluster) -> None:
    with ThreadPoolExecutor(1) as threads:
        outcome = threads.submit(cluster.hosts.run, 0, {"x": 2.0})
        for i in range(3):
            cluster.add()
            cluster.wait_until(lambda: len(cluster.busy()) == len(cluster.workers))
            cluster.workers[i].kill()
        assert "3 workers were lost" in outcome.result(TIMEOUT).error


def test_a_stranger_gets_no_work_and_keeps_nobody_out(cluster: Cluster) -> None:
    place = json.loads((cluster.folder / FILE_NAME).read_text())
    assert (cluster.folder / FILE_NAME).stat().st_mode & 0o077 == 0
    silent = socket.create_connection((place["host"], place["port"]))
    other = cluster.folder / "other"
    other.mkdir()
    (other / FILE_NAME).write_text(json.dumps({**place, "key": "00" * 32}))
    with pytest.raises(ParameterError, match="Authentication"):
        worker.join(other, 0.0)
    cluster.add()
    assert cluster.hosts.run(0, {"x": 0.5}).outputs["f"] == 1.0
    silent.close()


def test_an_address_of_another_host_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ParameterError, match=r"listen is '192\.0\.2\.1'"):
        Hosts("192.0.2.1", {"command": "true", "timeout": 1.0}, tmp_path)
    with pytest.raises(ParameterError, match="no campaign"):
        worker.join(tmp_path, 0.0)


@pytest.mark.parametrize("patience", ["-1", "nan", "soon"])
def test_a_patience_that_is_no_duration_is_refused(
    patience: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit):
        worker.main([str(tmp_path), f"--patience={patience}"])
    assert f"--patience: '{patience}' is not a number of at least 0" in capsys.readouterr().err
