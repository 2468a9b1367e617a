"""The end of a node's process, which comes whatever the node is doing."""

from __future__ import annotations

import signal
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from mobo_tuner.ros.process import EXIT_TIMEOUT
from tests.support.processes import NodeProcess

NODE = """
import ctypes, sys, time
from rclpy.node import Node
from mobo_tuner.ros.process import Program, exit_process, run_node

class Stubborn:
    exit_code = None

    def __init__(self, executor):
        self.node = Node("stubborn")
        print("ready", file=sys.stderr, flush=True)

    async def stop(self):
        pass

    def close(self):
        {hang}

exit_process(run_node(Stubborn, Program("stubborn")))
"""


@pytest.mark.parametrize(
    "hang",
    ["time.sleep(60.0)", "ctypes.PyDLL(None).sleep(60)"],
    ids=["asleep", "holding the interpreter's lock"],
)
def test_a_node_that_hangs_ends_all_the_same_and_says_where(
    start_node: Callable[..., NodeProcess],
    spin_until: Callable[..., None],
    tmp_path: Path,
    hang: str,
) -> None:
    script = tmp_path / "stubborn.py"
    script.write_text(NODE.format(hang=hang))
    process = start_node(str(script))
    spin_until(lambda: "ready" in process.stderr, "the node")
    started = time.monotonic()
    assert process.stop(signal.SIGTERM, timeout=EXIT_TIMEOUT + 5.0) == 1
    assert time.monotonic() - started > 0.9 * EXIT_TIMEOUT
    assert "in close" in process.stderr
