"""What tests with real ROS share: processes that always end, and waits that do."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import pytest

TIMEOUT = 20.0  # [s] for anything that should happen soon


def wait_until(
    condition: Callable[[], object], what: str, timeout: float = TIMEOUT, period: float = 0.02
) -> None:
    """Poll until `condition` holds; fail the test when it does not in time."""
    deadline = time.monotonic() + timeout
    while not condition():
        if time.monotonic() > deadline:
            pytest.fail(f"waited {timeout:g} s in vain for {what}")
        time.sleep(period)


@dataclass
class NodeProcess:
    """A node that runs as a process of its own, with what it prints going to files."""

    popen: subprocess.Popen[bytes]
    stdout_path: Path
    stderr_path: Path

    @property
    def stdout(self) -> str:
        """What it printed so far."""
        return self.stdout_path.read_text(encoding="utf-8", errors="replace")

    @property
    def stderr(self) -> str:
        """What it printed on standard error so far."""
        return self.stderr_path.read_text(encoding="utf-8", errors="replace")

    @property
    def running(self) -> bool:
        """Whether it has not ended."""
        return self.popen.poll() is None

    def stop(self, number: signal.Signals = signal.SIGINT, timeout: float = 5.0) -> int:
        """Send a signal and return the exit status; fail the test if it does not end in time."""
        self.popen.send_signal(number)
        return self.wait(timeout)

    def wait(self, timeout: float = TIMEOUT) -> int:
        """The exit status; fail the test if the process does not end in time."""
        try:
            return self.popen.wait(timeout)
        except subprocess.TimeoutExpired:
            self.kill()
            pytest.fail(f"a process did not end within {timeout:g} s; it said:\n{self.stderr}")

    def kill(self) -> None:
        """End it and everything it started, at once."""
        with contextlib.suppress(ProcessLookupError):
            os.killpg(self.popen.pid, signal.SIGKILL)
        self.popen.wait(10.0)


@dataclass
class NodeStarter:
    """Starts Python modules as processes in a test's domain and ends them all with the test."""

    folder: Path
    processes: list[NodeProcess] = field(default_factory=list)

    def __call__(
        self,
        *arguments: str,
        preexec: Callable[[], None] | None = None,
        terminal: int | None = None,
        **environment: str,
    ) -> NodeProcess:
        """Run Python with `arguments`.

        Args:
            arguments: of the interpreter.
            preexec: runs in the new process first.
            terminal: file descriptor of a terminal that becomes its standard output.
            environment: is added to that of the test.
        """
        stem = self.folder / f"process{len(self.processes)}"
        out, err = stem.with_suffix(".out"), stem.with_suffix(".err")
        with out.open("wb") as stdout, err.open("wb") as stderr:
            popen = subprocess.Popen(
                [sys.executable, *arguments],
                stdin=subprocess.DEVNULL,
                stdout=stdout if terminal is None else terminal,
                stderr=stderr,
                env={**os.environ, **environment},
                start_new_session=True,
                preexec_fn=preexec,
            )
        process = NodeProcess(popen, out, err)
        self.processes.append(process)
        return process
