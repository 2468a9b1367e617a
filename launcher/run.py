"""The verbs `run` and `resume`: check, start the nodes, tune, record, report, stop the nodes."""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import shlex
import shutil
import sys
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import datetime
from importlib import metadata
from pathlib import Path
from typing import Any

from launcher.environment import PAGE_STAGES, STAGES, Stage, clean_environment
from launcher.errors import LauncherError, RunFolderError, UsageError
from launcher.logbook import AWAITED_TIMEOUT, ON_RUN_END, TIMEOUT, enter
from launcher.machine import MACHINE_NODES, Machine, shared_domain
from launcher.page import PageDoor
from launcher.processes import Interrupted
from launcher.programs import (
    CONSOLE,
    LONG,
    PAGE,
    RECORDER,
    THREADS,
    TUNER,
    Project,
    open_project,
)
from launcher.ros_domain import RosDomain
from launcher.run_folder import CONFIG_FILE, RunFolder, process_start
from launcher.supervisor import Command, Conclusion, Launch, Supervisor, interrupted

_RECORDED_VERSIONS = (
    "mobo_tuner",
    "awa_sim_node",
    "mobo_msgs_py",
    "ros-jazzy-rclpy",
    "numpy",
    "scipy",
    "numba",
    "rosbags",
)


class UnsuccessfulRunError(LauncherError):
    """A run failed; the message is for the user."""

    def __init__(self, conclusion: Conclusion) -> None:
        super().__init__("\n".join((conclusion.reason, *conclusion.details)))
        self.exit_status = conclusion.exit_status


@dataclass(frozen=True)
class CheckedConfig:
    """A parameter file that was checked and copied with the files that its nodes need.

    Attributes:
        source: Path of the file that the user gave.
        copies: Folder of the copies.
        machine: Machine of the run.
        goes_back: Whether the machine is moved after a cancel.
    """

    source: Path
    copies: Path
    machine: Machine
    goes_back: bool


def run(options: argparse.Namespace) -> None:
    """Tune the machine of a parameter file in one run.

    Raises:
        UsageError, SetupError, DomainError, RunFolderError, UnsuccessfulRunError, Interrupted,
        OSError
    """
    config: Path = options.config.resolve()
    if not config.is_file():
        raise UsageError(f"the configuration '{options.config}' is not a file")
    runs_dir: Path = options.runs_dir.resolve()
    if options.run_id and (runs_dir / options.run_id).exists():
        raise UsageError(
            f"the run '{options.run_id}' exists already in '{runs_dir}', "
            "and no run is ever overwritten"
        )
    with open_project(options.root, _stages(options)) as project, PageDoor.open(options) as door:
        with tempfile.TemporaryDirectory() as scratch:
            machine = Machine(command=options.machine or "")
            checked = _check(project, config, Path(scratch), machine)
            _check_speed(options, checked.machine)
            data = _old_data(project, config, runs_dir, options) if options.warm_start else None
            domain = open_domain(options, checked.machine)
            folder = RunFolder.create(runs_dir, options.run_id, config.stem)
            folder.adopt(checked.copies)
        with domain:
            _carry_out(project, checked, folder, domain, door, options, data)


def resume(options: argparse.Namespace) -> None:
    """Continue a run in a new one, which starts with its evaluations.

    Raises:
        UsageError, SetupError, DomainError, RunFolderError, UnsuccessfulRunError, Interrupted,
        OSError
    """
    earlier = RunFolder.find(options.run, options.runs_dir)
    facts = earlier.facts()
    if facts.get("state") == "running":
        raise UsageError(f"the run '{earlier.run_id}' is active; stop it first")
    if options.config is not None and not options.config.is_file():
        raise UsageError(f"the configuration '{options.config}' is not a file")
    with open_project(options.root, _stages(options)) as project, PageDoor.open(options) as door:
        with tempfile.TemporaryDirectory() as scratch:
            config = _config_to_resume(project, earlier, Path(scratch), options)
            checked = _check_again(project, config, Path(scratch), earlier, options)
            if options.config is None:
                checked = replace(checked, source=earlier.path / CONFIG_FILE)
            _check_speed(options, checked.machine)
            arguments = facts.get("arguments") or {}
            options.seed = arguments.get("seed")
            if options.speed is None and "speed" in checked.machine.options:
                options.speed = arguments.get("speed")
            was_external = Machine.from_facts(facts).facts == checked.machine.facts
            domain = open_domain(
                options, checked.machine, facts.get("domain_id") if was_external else None
            )
            folder = RunFolder.create_after(earlier, options.run_id)
            folder.adopt(checked.copies)
        with domain:
            _carry_out(project, checked, folder, domain, door, options, earlier.run_id)


def _old_data(project: Project, config: Path, runs_dir: Path, options: argparse.Namespace) -> str:
    """Collect the evaluations of `--warm-start` in a folder beside the runs, which the run resumes.

    Returns:
        Name of the folder.

    Raises:
        UsageError, RunFolderError: If a source cannot be read, or nothing of it fits.
    """
    sources = [
        Path(name) if Path(name).exists() else RunFolder.find(name, runs_dir).path
        for name in options.warm_start
    ]
    name = f"{options.run_id[:90]}-data" if options.run_id else None
    folder = RunFolder.create(runs_dir, name, f"{config.stem}-data")
    given = {key: getattr(options, key) for key in ("evaluations", "seed")}
    further = [f"--{key}={value}" for key, value in given.items() if value is not None]
    try:
        said = project.ask(
            "mobo_tuner.nodes.warm_start", config, folder.path, *sources, *further, timeout=LONG
        )
    except LauncherError:
        shutil.rmtree(folder.path, ignore_errors=True)
        raise
    folder.record({"run_id": folder.run_id, "state": "old data", "started": now()})
    options.evaluations = None  # the journal has the budget, old evaluations included
    print(said, end="", flush=True)
    return folder.run_id


def _stages(options: argparse.Namespace) -> Sequence[Stage]:
    """Return what must be installed for a run."""
    return STAGES if options.no_dashboard else (*STAGES, *PAGE_STAGES)


def check_arguments(command: str) -> list[str]:
    """Return the options of the check of a parameter file: the known machines.

    Args:
        command: Command of `--machine`; empty if there is none.
    """
    nodes = [f"--machine-node={name}={node.description}" for name, node in MACHINE_NODES.items()]
    return [*nodes, *([f"--program={command}"] if command else [])]


def _check(
    project: Project, config: Path, scratch: Path, machine: Machine, *further: str
) -> CheckedConfig:
    """Check a parameter file with the machine of the command line, if any, and copy it.

    Args:
        project: Project whose program checks it.
        config: Path of the file.
        scratch: Folder in which the copies are made.
        machine: Machine of the command line, or of the run that is resumed.
        further: Further options of the check.

    Raises:
        UsageError: If something is wrong.
    """
    machine.check_program(project.search_path)
    copies = scratch / "copies"
    copies.mkdir()
    answer = project.ask(
        "mobo_tuner.nodes.check_config",
        config,
        *check_arguments(machine.command),
        f"--copy-to={copies}",
        *further,
    )
    said: Mapping[str, Any] = json.loads(answer)
    if said["section"]:
        machine = Machine(section=said["section"], files=tuple(said["files"]))
    return CheckedConfig(config, copies, machine, said["on_abort"] != "hold")


def _config_to_resume(
    project: Project,
    earlier: RunFolder,
    scratch: Path,
    options: argparse.Namespace,
) -> Path:
    """Return the path of the parameter file with which a run is resumed.

    Raises:
        UsageError: If the run cannot be resumed with it.
    """
    folder = scratch / "config"
    folder.mkdir()
    config = folder / CONFIG_FILE
    given = ["--config", options.config.resolve()] if options.config else []
    if options.evaluations:
        given += ["--evaluations", options.evaluations]
    module = "mobo_tuner.runs.resume_config"
    project.ask(module, earlier.path, config, *given)
    if options.config is not None:
        return Path(options.config.resolve())
    for name in Machine.from_facts(earlier.facts()).files:
        with contextlib.suppress(FileNotFoundError):  # the check of the file reports it
            shutil.copyfile(earlier.path / name, folder / name)
    return config


def _check_again(
    project: Project,
    config: Path,
    scratch: Path,
    earlier: RunFolder,
    options: argparse.Namespace,
) -> CheckedConfig:
    """Check the parameter file of a run that is resumed, with the machine that the run had.

    The command line or the file may choose another machine.

    Raises:
        UsageError: If something is wrong.
    """
    before = Machine.from_facts(earlier.facts())
    if options.machine:
        return _check(project, config, scratch, Machine(command=options.machine))
    default = before if before.command else Machine()
    checked = _check(project, config, scratch, default, "--program-yields")
    if before.section and not checked.machine.section:
        file = options.config or earlier.path / CONFIG_FILE
        raise UsageError(
            f"'{file}' names no machine, and the run '{earlier.run_id}' had that of its "
            f"section '{before.section}'; add that section, or start a program by --machine"
        )
    return checked


def _check_speed(options: argparse.Namespace, machine: Machine) -> None:
    """Reject `--speed` for a machine that is not simulated.

    Raises:
        UsageError: If it is given.
    """
    if options.speed is not None and "speed" not in machine.options:
        raise UsageError(f"--speed is {options.speed:g}; only a simulated machine has a speed")


def open_domain(
    options: argparse.Namespace, machine: Machine, earlier: int | None = None
) -> RosDomain:
    """Reserve the ROS domain of a machine: a separate one, or that of its machine.

    Raises:
        DomainError: If it is reserved.
        UsageError: If the environment defines a domain that is not allowed.
    """
    domain_id = options.domain_id
    if not machine.needs_private_domain:
        domain_id, why = shared_domain(domain_id, earlier)
        print(f"the machine is expected in ROS domain {domain_id} ({why})", flush=True)
    return RosDomain(domain_id, network=options.network)


def _carry_out(
    project: Project,
    checked: CheckedConfig,
    folder: RunFolder,
    domain: RosDomain,
    door: PageDoor,
    options: argparse.Namespace,
    resumed_from: str | None = None,
) -> None:
    """Carry out a run in its folder; the last line that is printed is the folder's path.

    Raises:
        UnsuccessfulRunError: If it failed.
        OSError: If the folder cannot be written.
    """
    facts = {
        "run_id": folder.run_id,
        "state": "running",
        "started": now(),
        "pid": os.getpid(),
        "pid_started": process_start(os.getpid()),
        "domain_id": domain.id,
        "network": options.network,
        "machine": checked.machine.facts,
        "arguments": {
            "config": str(checked.source),
            "evaluations": options.evaluations,
            "seed": options.seed,
            "speed": options.speed,
        },
        "versions": _versions(project.environment.folder),
    }
    if resumed_from is not None:
        facts["resumed_from"] = resumed_from
    values = {
        "seed": options.seed,
        "speed": options.speed,
        "runs_dir": folder.path.parent,
        "bag_path": folder.path / "bag",
        "run_id": folder.run_id,
        "evaluations": options.evaluations,
        "resume_from": resumed_from,
    }
    conclusion = Conclusion("failed", "the run failed: mobo.py met an error of its own", 1)
    try:
        folder.record(facts)
        conclusion = _tune(project, checked, folder, domain, door, values)
    except Interrupted as interruption:
        conclusion = interrupted(interruption)
    finally:
        facts |= {"state": conclusion.state, "reason": conclusion.reason, "ended": now()}
        _record_end(folder, facts)
        if conclusion.state == "finished" and conclusion.reason:
            print(f"mobo.py: {conclusion.reason}", file=sys.stderr)
        if options.on_run_end:
            _enter_end(project, options.on_run_end, folder, conclusion)
        print(folder.path, flush=True)
    if conclusion.exit_status:
        raise UnsuccessfulRunError(conclusion)


def _enter_end(project: Project, command: str, folder: RunFolder, conclusion: Conclusion) -> None:
    """Have a command write about the end of a run, and say if it cannot; a signal ends the command.

    It has less time if somebody waits for the end, and nothing to write about a run that was interrupted before it
    began.
    """
    is_awaited = conclusion.state == "interrupted"
    if is_awaited and not folder.has_journal:
        return
    project.processes.heed_next_signal()
    timeout = AWAITED_TIMEOUT if is_awaited else TIMEOUT
    trouble = enter(project.processes, command, ON_RUN_END, folder, timeout)
    if trouble:
        print(f"mobo.py: {trouble}", file=sys.stderr)


def _record_end(folder: RunFolder, facts: Mapping[str, Any]) -> None:
    """Record how a run ended; if that cannot be written, say so and keep the run's own reason."""
    try:
        folder.record(facts)
    except RunFolderError as error:
        print(f"mobo.py: the end of the run is not recorded: {error}", file=sys.stderr)


def _tune(
    project: Project,
    checked: CheckedConfig,
    folder: RunFolder,
    domain: RosDomain,
    door: PageDoor,
    values: Mapping[str, object],
) -> Conclusion:
    """Run the nodes until the console ends, and create the report."""
    config, python = folder.path / CONFIG_FILE, project.environment.python
    commands = {}
    machine = checked.machine.start_command(python, config, values)
    if machine is not None:
        in_folder = checked.machine.folder if checked.machine.command else folder.path
        commands["machine"] = Command(machine, in_folder)
    for program in (TUNER, RECORDER, CONSOLE):
        commands[program.name] = Command(program.command(python, config, values), folder.path)
    if door.is_open:
        words = PAGE.command(python, config, {**values, **door.parameters})
        commands[PAGE.name] = Command(words, folder.path, door.stdin, door.environment)
    launch = Launch(
        commands=commands,
        foreground=CONSOLE.name,
        last=RECORDER.name,
        environment=clean_environment(
            **domain.environment,
            **THREADS,
            PATH=project.search_path,
            PYTHONUNBUFFERED="1",
            MPLBACKEND="Agg",
            ROS_LOG_DIR=str(folder.path / "log"),
        ),
        folder=folder.path,
        goes_back=checked.goes_back,
        onlookers=(PAGE.name,),
    )
    print(f"run {folder.run_id} in ROS domain {domain.id}; to join from another terminal:")
    variables = (f"{name}={shlex.quote(text)}" for name, text in domain.environment.items())
    print(f"  export {' '.join(variables)}", flush=True)
    door.announce()
    supervisor = Supervisor(project.processes, launch)
    conclusion = supervisor.run()
    if folder.has_journal or conclusion.state == "finished":
        failure = supervisor.report(
            [str(python), "-P", "-m", "mobo_tuner.runs.report", str(folder.path)]
        )
        if failure and conclusion.state == "finished":
            return Conclusion("failed", failure, 1)
    return conclusion


def now() -> str:
    """Return the local time with its offset from UTC."""
    return datetime.now().astimezone().isoformat(timespec="seconds")


def _versions(folder: Path) -> dict[str, str]:
    """Return the versions of the packages of a virtual environment on which a run depends."""
    packages = [str(path) for path in folder.glob("lib/python3.*/site-packages")]
    found = metadata.distributions(path=packages)
    wanted = {d.name: d.version for d in found if d.name in _RECORDED_VERSIONS}
    return {"python": (folder / "bin" / "python").resolve().name, **dict(sorted(wanted.items()))}
