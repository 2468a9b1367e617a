"""Processes of campaigns, which end with the process that started them."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

from launcher.watchdog import MARKER
from tests.support.processes import wait_until

ROOT = Path(__file__).parents[2]
PARENT = """
import multiprocessing, sys, time
from robustness.processes import end_with_parent

def work(path):
    end_with_parent(lambda: open(path + ".cleaned", "w").close())
    print(multiprocessing.current_process().pid, flush=True)
    time.sleep(60.0)

if __name__ == "__main__":
    worker = multiprocessing.get_context("spawn").Process(target=work, args=sys.argv[1:])
    worker.start()
    worker.join()
"""


def test_a_worker_ends_when_its_parent_is_killed(tmp_path: Path) -> None:
    program, mark = tmp_path / "parent.py", tmp_path / "worker"
    program.write_text(PARENT)
    parent = subprocess.Popen(
        [sys.executable, str(program), str(mark)],
        env={**os.environ, "PYTHONPATH": f"{ROOT}:{os.environ.get('PYTHONPATH', '')}"},
        stdout=subprocess.PIPE,
        text=True,
    )
    assert parent.stdout is not None
    worker = int(parent.stdout.readline())
    parent.send_signal(signal.SIGKILL)
    parent.wait(10.0)
    deadline = time.monotonic() + 20.0
    while is_running(worker) and time.monotonic() < deadline:
        time.sleep(0.05)
    parent.stdout.close()
    assert not is_running(worker)
    assert mark.with_suffix(".cleaned").exists()


LEAVING = """
import os, subprocess, sys, time

def test_that_is_killed():
    process = subprocess.Popen([sys.executable, "-c", "import time; time.sleep(60.0)"], start_new_session=True)
    with open({path!r}, "w") as file:
        file.write(f"{{process.pid}}\\n")
    time.sleep(60.0)
"""


def test_nothing_is_left_of_tests_that_are_killed(tmp_path: Path) -> None:
    pid, program = tmp_path / "pid", tmp_path / "test_leaving.py"
    program.write_text(LEAVING.format(path=str(pid)))
    outside = {n: v for n, v in os.environ.items() if n != MARKER}
    pytest = subprocess.Popen(
        [
            sys.executable,
            "-m",
            "pytest",
            "-q",
            "-p",
            "tests.conftest",
            "-p",
            "no:xdist",
            str(program),
        ],
        env=outside,
        cwd=ROOT,
        stdout=subprocess.DEVNULL,
    )
    wait_until(lambda: pid.exists() and pid.read_text().endswith("\n"), "the test", 60.0)
    left = int(pid.read_text())
    assert is_running(left)
    pytest.kill()
    pytest.wait(10.0)
    wait_until(lambda: not is_running(left), "its process to end")


def is_running(pid: int) -> bool:
    """Whether a process exists that has not ended; nobody may have waited for it yet."""
    try:
        state = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]
    except OSError:
        return False
    return state != "Z"
