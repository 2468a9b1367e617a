"""The examples do what they say, with the real tuner between them."""

from __future__ import annotations

import math
import re
import signal
from collections.abc import Callable
from pathlib import Path

import pytest

from awa_sim_node.surrogate import Surrogate
from mobo_tuner.runs.export import main as export
from tests.support.processes import NodeProcess, NodeStarter, wait_until
from tests.support.run_folders import evaluation, write_run
from tests.support.simulator import MIDDLE
from tests.support.tuner import journal

ROOT = Path(__file__).resolve().parents[1]


def test_a_machine_and_a_client_of_ones_own_tune(start_node: NodeStarter, tmp_path: Path) -> None:
    machine = start_node(str(ROOT / "examples" / "my_machine.py"))
    config = ("--ros-args", "--params-file", str(ROOT / "config" / "toy.yaml"))
    start_node("-m", "mobo_tuner.nodes.tuner", *config, "-p", f"runs_dir:={tmp_path}")
    client = start_node("-u", str(ROOT / "examples" / "tune_client.py"), "9")
    assert client.wait(60.0) == 0, client.stderr
    lines = client.stdout.splitlines()
    assert [line.split(":")[0] for line in lines[:9]] == [str(i) for i in range(9)]
    assert lines[9].startswith("9 evaluations, ")
    assert lines[10].strip() == "stopped by budget"
    assert machine.stop() == 0


def shown(word: str) -> str:
    """The example of the README that contains a word."""
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    [block] = [b for b in re.findall(r"```python\n(.*?)```", text, re.DOTALL) if word in b]
    return block


def test_the_loop_that_the_readme_shows(capsys: pytest.CaptureFixture[str]) -> None:
    exec(compile(shown("Optimizer"), "README.md", "exec"), {})
    first, *front = capsys.readouterr().out.splitlines()
    assert float(re.findall(r"[0-9.]+", first)[0]) > 12.5  # of at most 14.5
    points = [[float(number) for number in re.findall(r"[0-9.]+", line)] for line in front]
    assert len(points) >= 4
    # A point of the true front is on the line between the two points that the distances are from.
    assert min(f + g for f, g in points) == pytest.approx(math.sqrt(8.0), abs=0.05)


def test_the_run_that_the_readme_shows(start_node: NodeStarter, tmp_path: Path) -> None:
    lines = shown("TunerClient")
    assert len([line for line in lines.splitlines() if line]) <= 10
    (tmp_path / "shown.py").write_text(lines)
    config = ("--ros-args", "--params-file", str(ROOT / "config" / "awa.yaml"))
    start_node("-m", "awa_sim_node.node", *config, "-p", "awa_sim:speed:=1000.0")
    start_node("-m", "mobo_tuner.nodes.tuner", *config, "-p", f"runs_dir:={tmp_path}")
    client = start_node("-u", str(tmp_path / "shown.py"))
    assert client.wait(90.0) == 0, client.stderr
    printed = client.stdout.splitlines()
    assert [line.split()[0] for line in printed[:10]] == [str(index) for index in range(10)]
    assert "'eps_x': " in printed[9]
    assert all(float(k1) <= 520.0 for k1 in re.findall(r"'K1': ([0-9.]+)", client.stdout))
    assert printed[-1] == "idle budget"


def test_a_loop_of_ones_own_asks_and_tells(start_node: NodeStarter, tmp_path: Path) -> None:
    config = ("--ros-args", "--params-file", str(ROOT / "config" / "toy.yaml"))
    start_node("-m", "mobo_tuner.nodes.tuner", *config, "-p", f"runs_dir:={tmp_path}")
    client = start_node("-u", str(ROOT / "examples" / "ask_tell_client.py"), "9")
    assert client.wait(60.0) == 0, client.stderr
    lines = client.stdout.splitlines()
    assert [line.split(":")[0] for line in lines[:9]] == [str(i) for i in range(9)]
    hypervolumes = [float(line.split()[-1]) for line in lines[:9]]
    assert hypervolumes == sorted(hypervolumes)
    assert len(lines) > 11
    assert all(line.startswith("f1 = ") for line in lines[9:])


def test_ctrl_c_at_a_client_cancels_its_run(
    start_node: NodeStarter,
    start_machine: Callable[..., NodeProcess],
    start_tuner: Callable[..., NodeProcess],
    tmp_path: Path,
) -> None:
    start_machine()
    start_tuner("initial_evaluations:=4")
    client = start_node("-u", str(ROOT / "examples" / "tune_client.py"), "1000")
    wait_until(lambda: len(client.stdout.splitlines()) >= 6, "evaluations", 60.0)
    client.popen.send_signal(signal.SIGINT)
    assert client.wait(20.0) == 1
    assert client.stderr == "the run was canceled\n"
    [folder] = (tmp_path / "runs").iterdir()
    assert journal(tmp_path, folder.name)[-1]["stop_reason"] == "canceled"


def test_the_machine_is_driven_by_plain_topics_alone(start_node: NodeStarter) -> None:
    start_node("-m", "awa_sim_node.node", "--ros-args", "-p", "mode:=ideal", "-p", "speed:=500.0")
    scan = start_node("-u", str(ROOT / "examples" / "solenoid_scan.py"))
    assert scan.wait(60.0) == 0, scan.stderr
    lines = scan.stdout.splitlines()
    assert [line.split("  ")[0] for line in lines] == [
        f"K2 = {current:.1f} A" for current in (200.0, 215.0, 230.0, 245.0, 260.0)
    ]
    widths = [float(re.findall(r"sigma_x = ([\d.]+) mm", line)[0]) for line in lines]
    assert widths == sorted(widths, reverse=True)
    at_230 = Surrogate.load().predict({**MIDDLE, "K2": 230.0})["sigma_x"]
    assert widths[2] == pytest.approx(at_230, abs=0.02)


def test_the_readmes_table_of_a_run_is_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    problem = {
        "variables": {"K1": {"min": 0.0, "max": 1.0}},
        "objectives": {"eps_x": {"reference": 10.0}, "dE": {"reference": 10.0}},
    }
    records = [
        evaluation(i, {"eps_x": 5.0 - i, "dE": 1.0 + i}, setpoint={"K1": 0.1 * i}) for i in range(3)
    ]
    assert export([str(write_run(tmp_path / "runs" / "RUN", records, problem))]) == 0
    monkeypatch.chdir(tmp_path)
    capsys.readouterr()
    exec(compile(shown("pandas"), "README.md", "exec"), {})
    _, *rows = capsys.readouterr().out.splitlines()
    assert [row.split()[1:3] for row in rows] == [["2", "3.0"], ["1", "4.0"], ["0", "5.0"]]
