"""Python programs as processes that always end: for campaigns, benches and tests."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from multiprocessing import parent_process
from pathlib import Path
from threading import Thread
from typing import Protocol

TIMEOUT = 20.0  # [s] for a process to end by itself


def end_with_parent(clean_up: Callable[[], None]) -> None:
    """Let this process of a pool end as soon as its parent has ended, even if that was killed.

    Args:
        clean_up: Function that is called first, in a thread of its own.
    """
    parent = parent_process()
    assert parent is not None

    def watch() -> None:
        parent.join()
        try:
            clean_up()
        finally:
            os._exit(1)

    Thread(target=watch, daemon=True).start()


def exit_at_sigterm() -> None:
    """Have this process exit at SIGTERM as from any error, so that what it started is stopped, too."""
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(1))


class Child(Protocol):
    """What is used of `subprocess.Popen`, which describes it."""

    pid: int

    def poll(self) -> int | None:
        """Return the exit status; None while the process is running."""

    def wait(self, timeout: float) -> int:
        """Return the exit status."""

    def send_signal(self, sig: int) -> None:
        """Send a signal unless the process has ended."""


@dataclass
class NodeProcess:
    """A node in a process of its own, whose output goes to files.

    Attributes:
        popen: Process.
        stdout_path: File of its standard output.
        stderr_path: File of its standard error; may be the same.
    """

    popen: Child
    stdout_path: Path
    stderr_path: Path

    @classmethod
    def start(
        cls,
        *arguments: str,
        stdout_path: Path,
        stderr_path: Path,
        environment: Mapping[str, str] | None = None,
        preexec: Callable[[], None] | None = None,
        terminal: int | None = None,
        folder: Path | None = None,
    ) -> NodeProcess:
        """Run Python with `arguments`.

        Args:
            arguments: Arguments of the interpreter.
            stdout_path: File to which standard output is appended.
            stderr_path: File to which standard error is appended.
            environment: Environment variables beside those of this process.
            preexec: Function that runs in the new process first.
            terminal: File descriptor of a terminal that becomes its standard output.
            folder: Working folder; None for that of this process.
        """
        with stdout_path.open("ab") as stdout, stderr_path.open("ab") as stderr:
            popen = subprocess.Popen(
                [sys.executable, *arguments],
                stdin=subprocess.DEVNULL,
                stdout=stdout if terminal is None else terminal,
                stderr=stderr,
                env={**os.environ, **(environment or {})},
                start_new_session=True,
                preexec_fn=preexec,
                cwd=folder,
            )
        return cls(popen, stdout_path, stderr_path)

    @property
    def stdout(self) -> str:
        """Standard output so far."""
        return self.stdout_path.read_text(encoding="utf-8", errors="replace")

    @property
    def stderr(self) -> str:
        """Standard error so far."""
        return self.stderr_path.read_text(encoding="utf-8", errors="replace")

    @property
    def running(self) -> bool:
        """Whether the process has not ended."""
        return self.popen.poll() is None

    def stop(self, number: signal.Signals = signal.SIGINT, timeout: float = 5.0) -> int:
        """Send a signal and return the exit status.

        Raises:
            TimeoutError: If the process does not end in time; it is killed.
        """
        self.popen.send_signal(number)
        return self.wait(timeout)

    def wait(self, timeout: float = TIMEOUT) -> int:
        """Return the exit status.

        Raises:
            TimeoutError: If the process does not end in time; it is killed.
        """
        try:
            return self.popen.wait(timeout)
        except subprocess.TimeoutExpired:
            self.kill()
            raise TimeoutError(
                f"a process did not end within {timeout:g} s; it said:\n{self.stderr}"
            ) from None

    def kill(self) -> None:
        """End the process and everything it started, at once."""
        with contextlib.suppress(ProcessLookupError):
            os.killpg(self.popen.pid, signal.SIGKILL)
        self.popen.send_signal(signal.SIGKILL)  # it may not have its own group yet
        self.popen.wait(10.0)


@dataclass
class NodeStarter:
    """Starts processes in a folder, whose output goes to numbered files there.

    Attributes:
        folder: Folder of the files, in which a tuner keeps its runs unless it is told another place.
        processes: All processes that were started; the owner of the starter ends them.
    """

    folder: Path
    processes: list[NodeProcess] = field(default_factory=list)

    def __call__(
        self,
        *arguments: str,
        preexec: Callable[[], None] | None = None,
        terminal: int | None = None,
        **environment: str,
    ) -> NodeProcess:
        """Run Python with `arguments`, see `NodeProcess.start`."""
        stem = self.folder / f"process{len(self.processes)}"
        process = NodeProcess.start(
            *arguments,
            stdout_path=stem.with_suffix(".out"),
            stderr_path=stem.with_suffix(".err"),
            environment=environment,
            preexec=preexec,
            terminal=terminal,
            folder=self.folder,
        )
        self.processes.append(process)
        return process
