"""Each kind of machine from the one command: run, kill -9 of the machine and of mobo.py, resume."""

from __future__ import annotations

import csv
import json
import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
import rclpy
import yaml
from action_msgs.srv import CancelGoal
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node

from launcher.ros_domain import RosDomain
from launcher.supervisor import EXIT_LIMIT
from tests.support.mobo_run import ROOT, TIMEOUT, Run, mcap_messages

FILES = {"bag", "config.yaml", "journal.jsonl", "journal.lines", "log", "run.json", "summary.json"}
PROGRAM = "python examples/my_machine.py"


@dataclass
class Lab:
    """What is there of a machine before a run, and how a run gets it.

    Attributes:
        config: Parameter file.
        options: Options of the first run.
        elsewhere: Program that runs elsewhere; empty if there is none.
        node: Words by which the machine's process is known; empty if it runs elsewhere.
        folder: For files.
    """

    config: Path
    options: tuple[str, ...]
    elsewhere: str
    node: str
    folder: Path
    process: subprocess.Popen[bytes] | None = None

    def start(self, *parameters: str) -> None:
        """Start what runs elsewhere."""
        if not self.elsewhere:
            return
        given = [word for text in parameters for word in ("-p", text)]
        with (self.folder / "elsewhere.log").open("ab") as log:
            self.process = subprocess.Popen(
                [sys.executable, str(ROOT / "examples" / self.elsewhere), "--ros-args", *given],
                stdout=log,
                stderr=log,
                env={**os.environ, "ROS_LOG_DIR": str(self.folder)},
            )

    def kill_machine(self, run: Run) -> None:
        """Kill the machine's node."""
        if self.node:
            os.kill(run.node(self.node), signal.SIGKILL)
        else:
            self.stop()

    def stop(self) -> None:
        """Kill what runs elsewhere."""
        if self.process is not None:
            self.process.kill()
            self.process.wait(10.0)
            self.process = None


KINDS = {
    "simulator": ("toy.yaml", ("--speed", "1000"), "", "awa_sim_node.node"),
    "bridge": ("laboratory.yaml", (), "foreign_machine.py", "machine_bridge"),
    "program": ("my_machine.yaml", ("--machine", PROGRAM), "", "my_machine.py"),
    "external": ("my_machine.yaml", (), "my_machine.py", ""),
}


def use_free_domain(monkeypatch: pytest.MonkeyPatch) -> None:
    """Set the environment to a ROS domain that is free; a run takes it again."""
    with RosDomain() as domain:
        for variable, value in domain.environment.items():
            monkeypatch.setenv(variable, value)


@pytest.fixture
def lab(
    request: pytest.FixtureRequest, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> Iterator[Lab]:
    """The lab of one kind of machine, in a ROS domain of its own where that matters."""
    name, options, elsewhere, node = KINDS[request.param]
    content = yaml.safe_load((ROOT / "config" / name).read_text())
    if elsewhere:
        # So that a run whose machine is gone does not wait for it for a minute.
        content["/**/tuner"]["ros__parameters"] |= {
            "machine_return_timeout": 1.0,
            "machine_timeout": 2.0,
        }
    bridge = content.get("/**/machine_bridge", {}).get("ros__parameters")
    if bridge:
        mapping = tmp_path / bridge["mapping"]
        mapping.write_bytes((ROOT / "config" / bridge["mapping"]).read_bytes())
    config = tmp_path / name
    config.write_text(yaml.safe_dump(content))
    use_free_domain(monkeypatch)
    monkeypatch.chdir(ROOT)
    lab = Lab(config, options, elsewhere, node, tmp_path)
    yield lab
    lab.stop()


def facts_of(run: Run) -> dict[str, Any]:
    facts: dict[str, Any] = json.loads((run.folder / "run.json").read_text())
    return facts


def state_in_list(run: Run) -> str:
    done = subprocess.run(
        [sys.executable, str(ROOT / "mobo.py"), "list", "--runs-dir", str(run.runs_dir)],
        capture_output=True,
        text=True,
        timeout=TIMEOUT,
        check=True,
    )
    [row] = [line.split() for line in done.stdout.splitlines() if line.split()[0] == run.run_id]
    return row[1]


@pytest.mark.timeout(240)
@pytest.mark.parametrize("lab", KINDS, indirect=True)
def test_a_run_is_killed_and_resumed_with_the_machine_that_it_had(
    lab: Lab, start: Callable[..., Run]
) -> None:
    lab.start()
    run = start("--evaluations", "500", *lab.options, config=str(lab.config), run_id="first")
    run.until(lambda: len(run.evaluations()) >= 2, "two evaluations")
    lab.kill_machine(run)
    finished = len(run.evaluations())
    status, out, err = run.wait()
    assert status == 1, err
    assert err.splitlines()[0].startswith("mobo.py: the run failed: the machine ")
    assert out.splitlines()[-1] == str(run.folder)
    assert "Traceback" not in err
    assert facts_of(run)["state"] == state_in_list(run) == "failed"
    run.assert_nothing_left()
    told = mcap_messages(run.folder / "bag", "/evaluation")
    assert [m.index for m in told] == [r["index"] for r in run.evaluations()]
    assert len(told) >= finished
    summary = json.loads((run.folder / "summary.json").read_text())
    assert summary["evaluations"] == len(told)
    if lab.node == "awa_sim_node.node":
        assert "awa_sim" in err
        # By mobo.py, which knows that the machine will not return.
        assert summary["stop_reason"] == "canceled"

    killed = run
    if lab.node == "machine_bridge":  # killed once more; test_resume.py does so with the simulator
        killed = resumed_and_killed(lab, start, run)
    lab.stop()
    lab.start()
    budget = len(killed.evaluations()) + 2
    resumed = start("--evaluations", str(budget), resumed=killed.run_id, run_id="resumed")
    status, out, err = resumed.wait()
    assert (status, err) == (0, "")
    assert f"{budget} of {budget} done: hypervolume " in out
    assert f"run resumed is finished (budget): {budget} evaluations" in out
    assert out.splitlines()[-1] == str(resumed.folder)
    assert resumed.evaluations()[: budget - 2] == killed.evaluations()
    facts = facts_of(resumed)
    assert (facts["state"], state_in_list(resumed)) == ("finished", "finished")
    assert facts["machine"] == facts_of(run)["machine"]
    for folder in (run.folder, resumed.folder):
        assert {path.name for path in folder.iterdir()} >= {
            *FILES,
            *facts["machine"].get("files", []),
        }
    resumed.assert_nothing_left()
    if lab.config.name == "laboratory.yaml":
        assert_names(resumed)


def resumed_and_killed(lab: Lab, start: Callable[..., Run], first: Run) -> Run:
    """Resume a run, kill mobo.py after two more evaluations, and return the killed run."""
    lab.stop()
    lab.start()
    second = start("--evaluations", "500", resumed=first.run_id, run_id="second")
    told = len(first.evaluations())
    second.until(lambda: len(second.evaluations()) >= told + 2, "two more evaluations")
    assert facts_of(second)["machine"] == facts_of(first)["machine"]
    second.process.kill()
    second.process.wait(TIMEOUT)
    second.assert_nothing_left(timeout=10.0)
    assert state_in_list(second) == "died"
    return second


def assert_names(run: Run) -> None:
    """Check that the files of a run have the names of its control system and of its choices."""
    targets = {"none", "foil", "mesh"}
    chosen = [record["chosen"]["LI20/target.1"] for record in run.evaluations()]
    assert {*chosen} <= targets
    for record in run.evaluations():
        assert record["setpoint"]["LI20/target.1"] in (0.0, 1.0, 2.0)
        x, y = (record["diagnostics"][f"LI20:CAM:1:S{axis}"][0] for axis in "XY")
        assert record["diagnostics"]["beam.area"][0] == pytest.approx(x * y)
    topics = (run.folder / "bag" / "metadata.yaml").read_text()
    assert "/plot/LI20_QUAD_Q1_BCTRL" in topics
    done = subprocess.run(
        [sys.executable, str(ROOT / "mobo.py"), "export", str(run.folder)],
        timeout=TIMEOUT,
        check=True,
    )
    assert done.returncode == 0
    _, *rows = (run.folder / "evaluations.csv").read_text().splitlines()
    table = list(csv.DictReader(rows))
    assert [row["LI20/target.1"] for row in table] == chosen
    assert all(float(row["LI20:QUAD:Q1:BCTRL"]) for row in table)
    front = json.loads((run.folder / "summary.json").read_text())["pareto_front"]
    assert {point["chosen"]["LI20/target.1"] for point in front} <= targets


@pytest.mark.parametrize("lab", ["bridge"], indirect=True)
def test_a_run_in_which_every_evaluation_failed_did_not_go_well(
    lab: Lab, start: Callable[..., Run]
) -> None:
    lab.start("fault:=unlit")
    run = start("--evaluations", "3", config=str(lab.config))
    status, out, err = run.wait()
    assert status == 1
    assert "all of its 3 evaluations failed" in err
    assert "LI20:CAM:1:SX could not be measured" in err
    assert out.splitlines()[-1] == str(run.folder)
    assert facts_of(run)["state"] == "failed"
    assert json.loads((run.folder / "summary.json").read_text())["failed"] == 3


@pytest.fixture
def slow_injector(tmp_path: Path) -> Path:
    """A parameter file with a machine that goes back after a cancel, for some seconds."""
    content = yaml.safe_load((ROOT / "config" / "awa.yaml").read_text())
    content["/**/awa_sim"]["ros__parameters"] |= {"mode": "ideal", "speed": 4.0}
    content["/**/tuner"]["ros__parameters"]["on_abort"] = "restore"
    config = tmp_path / "slow.yaml"
    config.write_text(yaml.safe_dump(content))
    return config


def test_ctrl_c_waits_until_the_machine_is_where_it_was(
    slow_injector: Path, start: Callable[..., Run]
) -> None:
    run = start(config=str(slow_injector))
    run.until(lambda: run.evaluations(), "an evaluation")
    run.process.send_signal(signal.SIGINT)
    status, out, err = run.wait()
    assert (status, err) == (130, "mobo.py: the run was stopped by SIGINT\n")
    assert any(re.match(r"moving: .*(ramping|settling) \d+%", line) for line in out.splitlines())
    assert run.journal()[-1]["error_msg"].endswith("the machine went to the state before the run")
    assert facts_of(run)["state"] == "interrupted"
    run.assert_nothing_left()


def test_a_second_ctrl_c_stops_a_machine_that_is_there_already(
    slow_injector: Path, start: Callable[..., Run], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    use_free_domain(monkeypatch)
    program = [sys.executable, "-m", "awa_sim_node.node", "--ros-args"]
    machine = subprocess.Popen(
        [*program, "--params-file", str(slow_injector)],
        stderr=subprocess.DEVNULL,
        env={**os.environ, "ROS_LOG_DIR": str(tmp_path)},
    )
    try:
        content = yaml.safe_load(slow_injector.read_text())
        del content["/**/awa_sim"]
        config = tmp_path / "external.yaml"
        config.write_text(yaml.safe_dump(content))
        run = start(config=str(config))
        run.until(lambda: run.evaluations(), "an evaluation")
        run.process.send_signal(signal.SIGINT)
        log = run.folder / "log" / "tuner.log"
        run.until(lambda: "goes to the state before the run" in log.read_text(), "the way back")
        run.process.send_signal(signal.SIGINT)
        sent = time.monotonic()
        assert run.wait()[0] == 130
        assert time.monotonic() - sent < EXIT_LIMIT
        assert "the machine was stopped on its way" in run.journal()[-1]["error_msg"]
        assert machine.poll() is None
    finally:
        machine.kill()
        machine.wait(10.0)


@contextmanager
def node_in(domain_id: int) -> Iterator[tuple[Node, SingleThreadedExecutor]]:
    context = Context()
    rclpy.init(context=context, domain_id=domain_id)
    executor = SingleThreadedExecutor(context=context)
    node = Node("canceler", context=context)
    executor.add_node(node)
    try:
        yield node, executor
    finally:
        executor.shutdown(timeout_sec=1.0)
        node.destroy_node()
        context.try_shutdown()


@pytest.mark.parametrize("lab", ["simulator"], indirect=True)
def test_a_run_that_another_client_cancels_is_canceled(lab: Lab, start: Callable[..., Run]) -> None:
    run = start("--evaluations", "500", config=str(lab.config), run_id="canceled")
    run.until(lambda: run.evaluations(), "an evaluation")
    with node_in(facts_of(run)["domain_id"]) as (node, executor):
        client = node.create_client(CancelGoal, "tune/_action/cancel_goal")
        assert client.wait_for_service(timeout_sec=TIMEOUT)
        answer = client.call_async(CancelGoal.Request())  # every goal of every client
        executor.spin_until_future_complete(answer, timeout_sec=TIMEOUT)
        assert len(answer.result().goals_canceling) == 1
    status, _, err = run.wait()
    assert status == 130
    assert "canceled" in err
    assert facts_of(run)["state"] == state_in_list(run) == "canceled"
