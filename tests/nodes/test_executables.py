"""The executables stand where `ros2 run` looks for them, also after a plain pip install."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

PREFIX = Path(sys.prefix)
# Each started in a way that it must refuse at once, in a sentence of its own.
EXECUTABLES = {
    ("mobo_tuner", "tuner"): ([], "'variables' is missing or empty"),
    ("mobo_tuner", "recorder"): ([], "bag_path"),
    ("mobo_tuner", "machine_bridge"): ([], "the parameter mapping is empty"),
    ("mobo_tuner", "steer"): (["halt"], "halt"),
    ("mobo_tuner", "console"): (["-p", "evaluations:=-1"], "evaluations is -1"),
    ("awa_sim_node", "awa_sim"): (["-p", "model:=lcls"], "model is 'lcls'"),
}


@pytest.mark.usefixtures("ros_domain")
@pytest.mark.parametrize(("package", "name"), EXECUTABLES)
def test_an_executable_starts_from_where_ros2_run_looks(package: str, name: str) -> None:
    index = PREFIX / "share" / "ament_index" / "resource_index" / "packages" / package
    assert index.exists()
    assert (PREFIX / "share" / package / "package.xml").exists()
    executable = PREFIX / "lib" / package / name
    assert os.access(executable, os.X_OK)
    arguments, sentence = EXECUTABLES[package, name]
    done = subprocess.run(
        [str(executable), "--ros-args", *arguments],
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    assert done.returncode == 2
    assert sentence in done.stderr
    assert "Traceback" not in done.stderr
