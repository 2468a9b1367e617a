"""Which machine a run has, and where one that is there already is looked for."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from launcher.environment import Environment
from launcher.errors import UsageError
from launcher.machine import MACHINE_NODES, Machine, shared_domain, split_command
from launcher.processes import Processes
from launcher.programs import Project

FILE = Path("/runs/mine/config.yaml")


@pytest.mark.parametrize(
    "machine",
    [
        Machine(section="machine_bridge", files=("mapping.yaml",)),
        Machine(command="python 'my machine.py'", folder=Path("/lab")),
        Machine(),
    ],
)
def test_a_machine_is_read_as_it_was_recorded(machine: Machine) -> None:
    assert Machine.from_facts({"machine": machine.facts}).facts == machine.facts


def test_a_run_that_records_no_machine_has_one_that_is_there_already() -> None:
    assert Machine.from_facts({}).facts == {"external": True}


def test_only_what_is_there_already_needs_a_domain_that_others_know() -> None:
    private = {name: Machine(section=name).needs_private_domain for name in MACHINE_NODES}
    assert private == {"awa_sim": True, "machine_bridge": False}
    assert Machine(command="python mine.py").needs_private_domain
    assert not Machine().needs_private_domain


def test_a_program_gets_the_parameter_file_after_its_own_arguments() -> None:
    command = Machine(command="python 'my machine.py' --ros-args -p rate:=2")
    assert command.start_command(Path("python"), FILE, {"seed": 3}) == [
        *("python", "my machine.py", "--ros-args", "-p", "rate:=2"),
        *("--ros-args", "--params-file", str(FILE)),
    ]
    assert Machine().start_command(Path("python"), FILE, {}) is None


@pytest.mark.parametrize("command", ["", "   ", "python 'open"])
def test_what_is_not_a_command_is_refused(command: str) -> None:
    with pytest.raises(UsageError, match="--machine"):
        split_command(command)


def test_the_domain_is_that_of_the_option_then_of_the_run_then_of_the_environment(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setenv("ROS_DOMAIN_ID", "142")
    assert shared_domain(7, 8) == (7, "--domain-id")
    assert shared_domain(None, 8)[0] == 8
    assert shared_domain(None, None) == (142, "ROS_DOMAIN_ID")
    monkeypatch.setenv("ROS_DOMAIN_ID", "")
    assert shared_domain(None, None) == (0, "ROS_DOMAIN_ID is not set")


@pytest.mark.parametrize("value", ["233", "-1", "lab", "1e1", "9" * 5000])
def test_a_domain_that_is_not_allowed_is_refused(
    monkeypatch: pytest.MonkeyPatch, value: str
) -> None:
    monkeypatch.setenv("ROS_DOMAIN_ID", value)
    with pytest.raises(UsageError, match="ROS_DOMAIN_ID"):
        shared_domain(None, None)


def test_nobody_waits_for_the_answer_of_a_machine_that_has_ended(tmp_path: Path) -> None:
    environment = Environment(tmp_path, ())
    environment.python = Path(sys.executable)
    with Processes() as processes:
        machine = processes.start(
            [sys.executable, "-c", "raise SystemExit(3)"], environment={}, cwd=tmp_path
        )
        with pytest.raises(UsageError, match="the machine's program ended with status 3"):
            Project(environment, processes).ask("http.server", 0, machine=machine)
