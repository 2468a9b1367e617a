"""A process that has imported the nodes and forks one for each test that starts a node.

A node of its own takes one to two seconds of a processor to import what it needs, which is most of the time of
most tests with nodes. A fork has it at once, and is a process as any other: in a session of its own, with its own
signals, environment, working folder, output and exit status. How a node starts from nothing is tested in
tests/system and in `tests/nodes/test_executables.py`.
"""

from __future__ import annotations

import gc
import importlib
import os
import signal
import subprocess
import sys
import threading
import time
import traceback
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from multiprocessing.connection import Connection, Pipe
from pathlib import Path
from typing import Any, NoReturn

import rclpy  # noqa: F401

from mobo_tuner.warmup import warm_up

MODULES = (
    "awa_sim_node.node",
    "mobo_tuner.nodes.console",
    "mobo_tuner.nodes.machine_bridge",
    "mobo_tuner.nodes.recorder",
    "mobo_tuner.nodes.steer",
    "mobo_tuner.nodes.tuner",
)
"""The modules that are imported beforehand; no other one is forked."""
POLL_PERIOD = 0.01  # [s]


@dataclass(frozen=True)
class Request:
    """What to fork.

    Attributes:
        arguments: Arguments of the interpreter, which begin with '-m' and one of `MODULES`.
        stdout: File to which standard output is appended.
        stderr: File to which standard error is appended.
        environment: All environment variables.
        folder: Working folder.
    """

    arguments: Sequence[str]
    stdout: Path
    stderr: Path
    environment: Mapping[str, str]
    folder: Path


class ForkServer:
    """The process that forks, from the side of the tests; it is started when it is first used."""

    def __init__(self) -> None:
        self._process: subprocess.Popen[bytes] | None = None
        self._connection: Connection | None = None
        self._lock = threading.Lock()

    def fork(self, request: Request) -> ForkedProcess:
        """Start a process."""
        return ForkedProcess(self, int(self.ask(request)))

    def ask(self, request: Request | int) -> Any:
        """Return the id of a new process, or the exit status of one, which is None while it is running."""
        with self._lock:
            if self._connection is None:
                self._connection = self._start()
            self._connection.send(request)
            return self._connection.recv()

    def _start(self) -> Connection:
        ours, theirs = Pipe()
        with theirs:
            self._process = subprocess.Popen(
                [sys.executable, "-c", f"import {__name__} as it; it.serve({theirs.fileno()})"],
                stdin=subprocess.DEVNULL,
                pass_fds=[theirs.fileno()],
                env={**os.environ, "OMP_NUM_THREADS": "1"},
                cwd=Path(__file__).parents[2],
                start_new_session=True,
            )
        return ours

    def close(self) -> None:
        """End the process that forks."""
        if self._connection is not None and self._process is not None:
            self._connection.close()
            self._process.wait(10.0)


class ForkedProcess:
    """A forked process, with what tests use of `subprocess.Popen`.

    Attributes:
        pid: Its id.
        returncode: Exit status, negative for a signal; None while it is running.
    """

    def __init__(self, server: ForkServer, pid: int) -> None:
        self.pid = pid
        self.returncode: int | None = None
        self._server = server

    def poll(self) -> int | None:
        """Return the exit status; None while it is running."""
        if self.returncode is None:
            self.returncode = self._server.ask(self.pid)
        return self.returncode

    def wait(self, timeout: float) -> int:
        """Return the exit status.

        Raises:
            TimeoutExpired: If the process is still running.
        """
        deadline = time.monotonic() + timeout
        while (status := self.poll()) is None:
            if time.monotonic() > deadline:
                raise subprocess.TimeoutExpired(f"process {self.pid}", timeout)
            time.sleep(POLL_PERIOD)
        return status

    def send_signal(self, number: int) -> None:
        """Send a signal unless the process has ended."""
        if self.poll() is None:
            os.kill(self.pid, number)


def serve(descriptor: int) -> None:
    """Fork what is asked for over a connection, until the other side is closed."""
    connection = Connection(descriptor)
    threads = len(
        os.listdir("/proc/self/task")
    )  # this one, and those in which rclpy waits for a tracer
    for module in MODULES:
        importlib.import_module(module)
    warm_up()  # loads the compiled code
    assert (
        len(os.listdir("/proc/self/task")) == threads
    )  # a fork has no other threads, only their locks
    gc.collect()
    gc.freeze()
    while True:
        try:
            request = connection.recv()
        except EOFError:
            return
        if isinstance(request, Request):
            pid = os.fork()
            if pid == 0:
                connection.close()
                _become(request)
            connection.send(pid)
        else:
            pid, status = os.waitpid(request, os.WNOHANG)
            connection.send(os.waitstatus_to_exitcode(status) if pid else None)


def _become(request: Request) -> NoReturn:
    """Be the process that was asked for, as `python -m MODULE ...` would be."""
    os.setsid()
    os.chdir(request.folder)
    for path, number in ((request.stdout, 1), (request.stderr, 2)):
        file = os.open(path, os.O_WRONLY | os.O_APPEND | os.O_CREAT)
        os.dup2(file, number)
        os.close(file)
    os.environ.clear()
    os.environ.update(request.environment)
    _, name, *arguments = request.arguments
    module = importlib.import_module(name)
    sys.argv = [str(module.__file__), *arguments]
    status: Any = 1
    try:
        status = module.main()
    except SystemExit as ended:
        status = ended.code
    except KeyboardInterrupt:
        signal.signal(signal.SIGINT, signal.SIG_DFL)
        os.kill(os.getpid(), signal.SIGINT)
    except BaseException:
        traceback.print_exc()
    finally:
        if isinstance(status, str):
            print(status, file=sys.stderr)
            status = 1
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(status or 0)
