"""What tests with real ROS share: processes that always end, and waits that do."""

from __future__ import annotations

import time
from collections.abc import Callable

import pytest

from robustness.processes import TIMEOUT, NodeProcess, NodeStarter

__all__ = ["TIMEOUT", "NodeProcess", "NodeStarter", "wait_until"]


def wait_until(
    condition: Callable[[], object], what: str, timeout: float = TIMEOUT, period: float = 0.02
) -> None:
    """Poll until `condition` holds; fail the test when it does not in time."""
    deadline = time.monotonic() + timeout
    while not condition():
        if time.monotonic() > deadline:
            pytest.fail(f"waited {timeout:g} s in vain for {what}")
        time.sleep(period)
