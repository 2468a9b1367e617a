"""What tests with real ROS share: processes that always end, and waits that do."""

from __future__ import annotations

import os
import secrets
import subprocess
import sys
import time
from collections.abc import Callable

import pytest

from launcher import watchdog
from robustness.processes import TIMEOUT, NodeProcess, NodeStarter
from tests.support.fork_server import MODULES, ForkServer, Request

__all__ = [
    "TIMEOUT",
    "NodeForker",
    "NodeProcess",
    "NodeStarter",
    "end_with_this_process",
    "wait_until",
]


class NodeForker(NodeStarter):
    """A starter that forks the nodes that are imported already, which is faster."""

    server = ForkServer()

    def __call__(
        self,
        *arguments: str,
        preexec: Callable[[], None] | None = None,
        terminal: int | None = None,
        **environment: str,
    ) -> NodeProcess:
        is_known = arguments[0] == "-m" and arguments[1] in MODULES
        if not is_known or preexec or terminal is not None or environment:
            return super().__call__(*arguments, preexec=preexec, terminal=terminal, **environment)
        stem = self.folder / f"process{len(self.processes)}"
        stdout, stderr = stem.with_suffix(".out"), stem.with_suffix(".err")
        stdout.touch()
        stderr.touch()
        request = Request(arguments, stdout, stderr, dict(os.environ), self.folder)
        self.processes.append(NodeProcess(self.server.fork(request), stdout, stderr))
        return self.processes[-1]


def wait_until(
    condition: Callable[[], object], what: str, timeout: float = TIMEOUT, period: float = 0.02
) -> None:
    """Poll until `condition` holds; fail the test when it does not in time."""
    deadline = time.monotonic() + timeout
    while not condition():
        if time.monotonic() > deadline:
            pytest.fail(f"waited {timeout:g} s in vain for {what}")
        time.sleep(period)


def end_with_this_process() -> subprocess.Popen[bytes] | None:
    """Have all processes that this one will start ended when it ends, even if it is killed.

    Returns:
        The program that waits for that; None if another one does, as in `mobo.py test`.
    """
    if watchdog.MARKER in os.environ:
        return None
    mark = os.environ[watchdog.MARKER] = secrets.token_hex(8)
    return subprocess.Popen(
        [sys.executable, "-I", "-S", watchdog.__file__, mark],
        stdin=subprocess.PIPE,
        env={},
        cwd="/",
        start_new_session=True,
    )
