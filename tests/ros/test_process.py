"""The end of a node's process, which comes whatever the node is doing."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
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


@pytest.mark.parametrize("program", ["tuner", "steer"])
@pytest.mark.parametrize("domain", ["abc", "300", "-1"])
def test_a_domain_that_cannot_be_is_refused_by_name(program: str, domain: str) -> None:
    words = [sys.executable, "-m", f"mobo_tuner.nodes.{program}"]
    words += ["status"] if program == "steer" else []
    environment = {**os.environ, "ROS_DOMAIN_ID": domain}
    done = subprocess.run(
        words, env=environment, capture_output=True, text=True, timeout=60.0, check=False
    )
    assert done.returncode != 0
    sentence = f"ROS_DOMAIN_ID is '{domain}'; an integer from 0 to 232 is allowed"
    assert done.stderr.rstrip("\n").removeprefix("cannot start: ") == sentence


def test_an_argument_that_ros_does_not_know_is_named() -> None:
    words = [sys.executable, "-m", "mobo_tuner.nodes.tuner", "--ros-args", "--bogus"]
    done = subprocess.run(words, capture_output=True, text=True, timeout=60.0, check=False)
    assert done.returncode == 2
    assert done.stderr.startswith("cannot start: ROS knows none of the arguments ['--bogus']")
