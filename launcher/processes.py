"""The processes that the entry script starts, and their end.

Each runs in a session of its own, so that a Ctrl-C at the terminal only reaches `mobo.py`, which stops
the processes in order. None remains after an error, after a signal or, by the watchdog, after a
`kill -9` of `mobo.py`.
"""

from __future__ import annotations

import contextlib
import os
import secrets
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from types import FrameType, TracebackType
from typing import IO, Any

from launcher import watchdog

STOP_SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
_POLL_PERIOD = 0.03  # [s]
_SWEEP_PATIENCE = 1.0  # [s] for remaining processes to react to SIGTERM


class Interrupted(Exception):  # noqa: N818 - not an error, but a request
    """A signal requested a stop; `number` is the signal's number."""

    def __init__(self, number: int) -> None:
        self.number = number
        self.name = signal.Signals(number).name
        self.exit_status = 128 + number
        super().__init__(f"stopped by {self.name}")


class Processes:
    """Starts, watches and ends processes; the end of the `with` block ends all that remain.

    Within the block the first SIGINT, SIGTERM or SIGHUP raises `Interrupted`, only in the waiting
    functions of this class. Later signals are ignored, because the processes are already being stopped,
    unless `heed_next_signal` was called.
    """

    def __init__(self) -> None:
        self._mark = secrets.token_hex(8)
        self._signal: int | None = None
        self._interrupted = False
        self._started: list[subprocess.Popen[bytes]] = []
        self._asked: set[int] = set()  # ids of processes that were sent SIGINT
        self._handlers: dict[int, Any] = {}

    def __enter__(self) -> Processes:
        self._watchdog = subprocess.Popen(
            [sys.executable, "-I", "-S", watchdog.__file__, self._mark],
            stdin=subprocess.PIPE,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            env={},
            cwd="/",
            start_new_session=True,
        )
        for number in STOP_SIGNALS:
            ignored = signal.getsignal(number) == signal.SIG_IGN
            if not (number == signal.SIGHUP and ignored):  # as `nohup` wants it
                self._handlers[number] = signal.signal(number, self._handle)
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        watchdog.end_marked_processes(self._mark, _SWEEP_PATIENCE)
        for process in self._started:
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.wait(timeout=1.0)
        with contextlib.suppress(subprocess.TimeoutExpired):
            self._watchdog.communicate(timeout=watchdog.PATIENCE + 10.0)
        for number, handler in self._handlers.items():
            signal.signal(number, handler)

    def start(
        self,
        command: Sequence[str],
        *,
        environment: Mapping[str, str],
        cwd: Path,
        stdin: int | None = subprocess.DEVNULL,
        stdout: int | IO[bytes] | None = None,
        stderr: int | IO[bytes] | None = None,
    ) -> subprocess.Popen[bytes]:
        """Start a process in a session of its own; a stream that is None is inherited.

        Raises:
            OSError: If it cannot be started.
        """
        process = subprocess.Popen(
            command,
            env={**environment, watchdog.MARKER: self._mark},
            cwd=cwd,
            stdin=stdin,
            stdout=stdout,
            stderr=stderr,
            start_new_session=True,
        )
        self._started.append(process)
        return process

    def wait_until(self, condition: Callable[[], bool], timeout: float) -> bool:
        """Wait until the condition holds, at most `timeout` seconds; return whether it does.

        Raises:
            Interrupted: If a signal arrived.
        """
        deadline = time.monotonic() + timeout
        while not condition():
            if time.monotonic() >= deadline:
                return False
            self.check_signal()
            time.sleep(_POLL_PERIOD)  # between two looks, until the deadline
        return True

    def check_signal(self) -> None:
        """Raise Interrupted once if a signal arrived."""
        if self._signal is not None and not self._interrupted:
            self._interrupted = True
            raise Interrupted(self._signal)

    def heed_next_signal(self) -> None:
        """Let the next signal raise Interrupted again."""
        self._signal = None
        self._interrupted = False

    def wait(self, process: subprocess.Popen[bytes], timeout: float) -> int | None:
        """Wait for the end of a process for `timeout` seconds; return its status, None if it runs.

        Raises:
            Interrupted: If a signal arrived.
        """
        self.wait_until(lambda: process.poll() is not None, timeout)
        return process.returncode

    def stop(self, processes: Iterable[subprocess.Popen[bytes]], patience: float) -> bool:
        """Interrupt processes (SIGINT) together, and kill those that still run after `patience`.

        A process is interrupted only once, because many react to a second time by an immediate exit.

        Returns:
            Whether all of them ended without being killed.

        Raises:
            Interrupted: If a signal arrived.
        """
        running = [process for process in processes if process.poll() is None]
        for process in running:
            self.interrupt(process)
        if self.wait_until(lambda: all(p.poll() is not None for p in running), patience):
            return True
        for process in running:
            if process.poll() is None:
                _signal_group(process, signal.SIGKILL)
                process.wait(timeout=5.0)
        return False

    def interrupt(self, process: subprocess.Popen[bytes], again: bool = False) -> None:
        """Send SIGINT to a running process, unless it was sent before and `again` is false."""
        if process.poll() is None and (again or process.pid not in self._asked):
            self._asked.add(process.pid)
            _signal_group(process, signal.SIGINT)

    def _handle(self, number: int, _frame: FrameType | None) -> None:
        self._signal = number


def _signal_group(process: subprocess.Popen[bytes], number: signal.Signals) -> None:
    """Send a signal to a process and the children in its process group."""
    with contextlib.suppress(ProcessLookupError):
        os.killpg(process.pid, number)


def describe_status(status: int) -> str:
    """Return how a process ended, e.g. 'was killed by SIGKILL' or 'ended with status 3'."""
    if status >= 0:
        return f"ended with status {status}"
    try:
        return f"was killed by {signal.Signals(-status).name}"
    except ValueError:
        return f"was killed by signal {-status}"
