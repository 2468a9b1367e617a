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

__all__ = ["TIMEOUT", "NodeProcess", "NodeStarter", "end_with_this_process", "wait_until"]


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
