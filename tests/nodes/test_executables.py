"""The executables: where `ros2 run` looks for them, their help, and the slips that they refuse."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from awa_sim_node.parameters import AWA_SIM
from mobo_tuner.bridge.describe import MACHINE_BRIDGE
from mobo_tuner.nodes.parameters import CONSOLE, LIVE_SERVER, PAGE, RECORDER
from mobo_tuner.parameter_spec import ParameterSpec
from mobo_tuner.tuner.parameters import TUNER
from tests.support.paths import CONFIG, ROOT
from tests.support.processes import NodeStarter, wait_until

PREFIX = Path(sys.prefix)
# Each started in a way that it must refuse at once, in a sentence of its own.
EXECUTABLES = {
    ("mobo_tuner", "tuner"): ([], "'variables' is missing or empty"),
    ("mobo_tuner", "recorder"): ([], "bag_path"),
    ("mobo_tuner", "machine_bridge"): ([], "the parameter mapping is empty"),
    ("mobo_tuner", "steer"): (["halt"], "halt"),
    ("mobo_tuner", "console"): (["-p", "evaluations:=-1"], "evaluations is -1"),
    ("mobo_tuner", "page"): (["-p", "port:=70000"], "port is 70000"),
    ("mobo_tuner", "live_server"): (["-p", "port:=-1"], "port is -1"),
    ("awa_sim_node", "awa_sim"): (["-p", "model:=lcls"], "model is 'lcls'"),
}
NODES: dict[str, tuple[str, tuple[ParameterSpec, ...]]] = {
    "tuner": ("mobo_tuner.nodes.tuner", TUNER),
    "recorder": ("mobo_tuner.nodes.recorder", RECORDER),
    "console": ("mobo_tuner.nodes.console", CONSOLE),
    "page": ("mobo_tuner.nodes.page", PAGE),
    "live_server": ("mobo_tuner.nodes.live_server", LIVE_SERVER),
    "machine_bridge": ("mobo_tuner.nodes.machine_bridge", MACHINE_BRIDGE),
    "awa_sim": ("awa_sim_node.node", AWA_SIM),
}
TOY = ["--ros-args", "--params-file", str(CONFIG / "toy.yaml")]


def run(*command: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)


@pytest.mark.usefixtures("ros_domain")
@pytest.mark.parametrize(("package", "name"), EXECUTABLES)
def test_an_executable_starts_from_where_ros2_run_looks(package: str, name: str) -> None:
    index = PREFIX / "share" / "ament_index" / "resource_index" / "packages" / package
    assert index.exists()
    assert (PREFIX / "share" / package / "package.xml").exists()
    executable = PREFIX / "lib" / package / name
    assert os.access(executable, os.X_OK)
    arguments, sentence = EXECUTABLES[package, name]
    done = run(str(executable), "--ros-args", *arguments)
    assert done.returncode == 2
    assert sentence in done.stderr
    assert "Traceback" not in done.stderr


@pytest.mark.parametrize("node", NODES)
def test_help_shows_every_parameter_and_ends_with_0(node: str) -> None:
    module, specs = NODES[node]
    done = run(sys.executable, "-m", module, "--help")
    assert (done.returncode, done.stderr) == (0, "")
    lines = done.stdout.splitlines()
    assert lines[0].startswith(f"usage: {node} ")
    for spec in specs:
        mark = " *" if spec.writable else ""
        where = next(i for i, line in enumerate(lines) if line.startswith(f"  {spec.name}{mark}: "))
        assert spec.type_name in lines[where]
        assert spec.range_text in lines[where]
        assert "default" in lines[where]
        assert lines[where + 1].strip() == spec.description


def test_help_of_steer_ends_with_0() -> None:
    done = run(sys.executable, "-m", "mobo_tuner.nodes.steer", "--help")
    assert done.returncode == 0
    assert "pause" in done.stdout


INTERRUPTED = """
import os, signal, time
os.kill(os.getpid(), signal.SIGINT)
time.sleep(60.0)
"""


@pytest.mark.parametrize(
    "command",
    [
        *(["-m", module] for module, _ in NODES.values()),
        ["-m", "mobo_tuner.nodes.steer", "status"],
        [str(PREFIX / "bin" / "tuner")],
        [str(PREFIX / "bin" / "awa_sim")],
        [str(ROOT / "mobo.py"), "status"],
    ],
    ids=" ".join,
)
def test_ctrl_c_during_the_imports_ends_quietly(command: list[str], tmp_path: Path) -> None:
    for module in ("rclpy", "secrets"):  # what nodes and what the entry script import early
        (tmp_path / f"{module}.py").write_text(INTERRUPTED)
    path = os.pathsep.join((str(tmp_path), os.environ.get("PYTHONPATH", "")))
    done = subprocess.run(
        [sys.executable, *command],
        env={**os.environ, "PYTHONPATH": path},
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    assert done.returncode in (130, -signal.SIGINT)  # both are 130 for a shell
    assert (done.stdout, done.stderr) == ("", "")


# A name that nobody knows, and the nearest right one.
MISSPELT = {
    "tuner": ("on_abrt:=restore", "on_abort"),
    "recorder": ("bag_pth:=x", "bag_path"),
    "console": ("resume_form:=x", "resume_from"),
    "page": ("red_only:=true", "read_only"),
    "live_server": ("red_only:=true", "read_only"),
    "machine_bridge": ("maping:=x", "mapping"),
    "awa_sim": ("sped:=5.0", "speed"),
}


@pytest.mark.usefixtures("ros_domain")
@pytest.mark.parametrize("node", NODES)
def test_a_slip_is_refused_with_the_nearest_right_name(node: str) -> None:
    module, _ = NODES[node]
    given, right = MISSPELT[node]
    done = run(sys.executable, "-m", module, *TOY, "-p", given)
    assert done.returncode == 2
    name = given.partition(":=")[0]
    assert f"'{name}' is unknown in the node; did you mean '{right}'?" in done.stderr
    assert "Traceback" not in done.stderr


@pytest.mark.usefixtures("ros_domain")
def test_what_is_not_a_ros_argument_is_refused() -> None:
    done = run(sys.executable, "-m", "mobo_tuner.nodes.tuner", "--config", "toy.yaml")
    assert done.returncode == 2
    assert "'--config' is unknown" in done.stderr


@pytest.mark.usefixtures("ros_domain")
def test_a_run_without_a_journal_must_be_asked_for() -> None:
    done = run(sys.executable, "-m", "mobo_tuner.nodes.tuner", *TOY, "-p", "runs_dir:=''")
    assert done.returncode == 2
    assert "runs_dir is empty" in done.stderr
    assert "journal" in done.stderr


def test_each_node_alone_says_what_it_serves_and_ends_soon_after_a_signal(
    start_node: NodeStarter, tmp_path: Path
) -> None:
    given = {
        "tuner": [*TOY, "-p", f"runs_dir:={tmp_path}"],
        "awa_sim": TOY,
        "recorder": ["--ros-args", "-p", f"bag_path:={tmp_path / 'bag'}"],
        "machine_bridge": ["--ros-args", "-p", f"mapping:={CONFIG / 'bridge_foreign.yaml'}"],
    }
    served = {
        "tuner": "/tune",
        "awa_sim": "/evaluate_setpoint",
        "recorder": "recorder_status",
        "machine_bridge": "/evaluate_setpoint",
    }
    for number, (node, arguments) in enumerate(given.items()):
        process = start_node("-m", NODES[node][0], *arguments)
        wait_until(lambda: "ready" in process.stderr, f"{node} to be ready")  # noqa: B023
        (ready,) = [line for line in process.stderr.splitlines() if "ready" in line]
        assert served[node] in ready
        begin = time.monotonic()
        assert process.stop((signal.SIGINT, signal.SIGTERM)[number % 2]) == 0
        assert time.monotonic() - begin < 2.5, node  # 0.1 to 0.4 s, on a busy machine, too
