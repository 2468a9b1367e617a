"""The verbs of `mobo.py` that do not start a run."""

from __future__ import annotations

import argparse
import os
import shlex
import signal
import subprocess
import sys
import tempfile
from pathlib import Path

from launcher.environment import (
    DEVELOPMENT_STAGES,
    LIVE_STAGES,
    OFFLINE_STAGES,
    PAGE_STAGES,
    STAGES,
    Environment,
    clean_environment,
)
from launcher.errors import LauncherError, RunFolderError, UsageError
from launcher.logbook import ON_REQUEST, VARIABLES, enter
from launcher.machine import Machine, split_command
from launcher.processes import Interrupted, Processes
from launcher.programs import LONG, THREADS, open_project
from launcher.run import check_arguments, now, open_domain
from launcher.run_folder import RunFolder, is_bag, table
from launcher.supervisor import EXIT_LIMIT

TEST_TIMEOUT = 3600.0  # [s]
# Three processes on two cores: tests with real nodes mostly wait. One that fails on a busy computer gets a second
# try, and is named at the end with what went wrong.
_PARALLEL_TESTS = (
    "-n",
    "3",
    "--dist",
    "loadfile",
    "--no-loadscope-reorder",  # tests/conftest.py orders them
    "--reruns",
    "1",
    "--rerun-show-tracebacks",
    "-rR",
)


def check(options: argparse.Namespace) -> None:
    """Print what a parameter file means, without starting anything.

    Raises:
        UsageError, SetupError, Interrupted, OSError
    """
    if not options.config.is_file():
        raise UsageError(f"the configuration '{options.config}' is not a file")
    with open_project(options.root) as project:
        module = "mobo_tuner.nodes.check_config"
        arguments = check_arguments(options.machine or "")
        arguments += ["--explain"]
        project.ask(module, options.config, *arguments, show=True)


def layout(options: argparse.Namespace) -> None:
    """Write layouts for viewers, whose paths are printed.

    Raises:
        UsageError, SetupError, Interrupted, OSError
    """
    with open_project(options.root) as project:
        module = "mobo_tuner.displays.layouts"
        project.ask(module, options.config, "--output", options.output, show=True)


def new(options: argparse.Namespace) -> None:
    """Write a parameter file from what a machine has, whose path is printed.

    The machine is that of another file, a program that is started for the purpose, or there already.

    Raises:
        UsageError, SetupError, DomainError, Interrupted, OSError
    """
    if options.config.exists():
        raise UsageError(f"'{options.config}' exists already, and nothing is written over it")
    if options.like is not None and options.machine:
        raise UsageError("--like and --machine both choose a machine; one of the two is allowed")
    if options.like is not None and not options.like.is_file():
        raise UsageError(f"the configuration '{options.like}' is not a file")
    module, arguments = "mobo_tuner.nodes.new_config", [options.config, *_wishes(options)]
    with open_project(options.root) as project:
        if options.like is not None:
            arguments += [f"--like={options.like}", *check_arguments("")]
            project.ask(module, *arguments)
        else:
            machine = Machine(command=options.machine or "")
            machine.check_program(project.search_path)
            with open_domain(options, machine) as domain:
                program = None
                if machine.command:
                    program = project.processes.start(
                        split_command(machine.command),
                        environment=clean_environment(
                            **domain.environment, **THREADS, PATH=project.search_path
                        ),
                        cwd=machine.folder,
                        stdout=subprocess.DEVNULL,
                    )
                    arguments.append(f"--how=--machine {shlex.quote(machine.command)}")
                project.ask(module, *arguments, surroundings=domain.environment, machine=program)
    print(options.config)


def _wishes(options: argparse.Namespace) -> list[str]:
    """Return the arguments that say what the file is about."""
    words = [f"--around={options.around}"] if options.around else []
    for direction in ("minimize", "maximize"):
        names = getattr(options, direction)
        words += [f"--{direction}", *names] if names else []
    return words


def test(root: Path, arguments: list[str]) -> int:
    """Run the tests with pytest's arguments, or all of them in parallel; return pytest's status.

    Raises:
        SetupError, Interrupted, OSError
    """
    stages = (*STAGES, *PAGE_STAGES, *LIVE_STAGES, *OFFLINE_STAGES, *DEVELOPMENT_STAGES)
    with open_project(root, stages) as project:
        process = project.processes.start(
            [str(project.environment.python), "-m", "pytest", *(arguments or _PARALLEL_TESTS)],
            environment=clean_environment(**THREADS, MPLBACKEND="Agg"),
            cwd=root,
            stdin=None,
        )
        try:
            status = project.processes.wait(process, TEST_TIMEOUT)
        except Interrupted:
            project.processes.stop([process], patience=EXIT_LIMIT - 1.5)
            raise
    if status is None:
        os.killpg(process.pid, signal.SIGABRT)  # at which pytest prints where each process stands
        project.processes.wait(process, EXIT_LIMIT)
        raise LauncherError(f"the tests were not done after {TEST_TIMEOUT:.0f} s")
    return status


def list_runs(options: argparse.Namespace) -> None:
    """Print the runs in a folder as a table.

    Raises:
        RunFolderError: If the folder cannot be read.
    """
    rows = []
    for folder in RunFolder.all(options.runs_dir):
        try:
            rows.append(folder.row())
        except RunFolderError as error:
            print(f"mobo.py: {error}", file=sys.stderr)
            rows.append([folder.run_id, "unreadable", "-", "-", "-"])
    if not rows:
        print(f"there are no runs in '{options.runs_dir}'")
        return
    header = ["run", "state", "evaluations", "hypervolume", "started"]
    print("\n".join(table(header, rows)))


def show(options: argparse.Namespace) -> None:
    """Print the result of a run; its report is created first if the journal is newer, as with nodes that stay.

    Raises:
        UsageError: If its journal is damaged; the result is printed nevertheless.
        SetupError, RunFolderError, Interrupted, OSError
    """
    folder = RunFolder.find(options.run, options.runs_dir)
    ended = folder.facts().get("state") in ("finished", "canceled", "failed")
    needs_report = folder.has_journal and ended and not folder.is_summary_current
    is_ready = not Environment(options.root, STAGES).stale_stages()
    try:
        if folder.has_journal and (is_ready or needs_report):
            with open_project(options.root) as project:
                project.ask("mobo_tuner.runs.journal", folder.path)  # says what is wrong with it
                if needs_report:
                    project.ask("mobo_tuner.runs.report", folder.path)
    finally:
        print(folder.description(), flush=True)
    if folder.has_journal and not (is_ready or needs_report):
        print("mobo.py: the journal was not checked: .venv needs a set-up", file=sys.stderr)


def report(options: argparse.Namespace) -> None:
    """Create the report of a run from its journal; a bag is rebuilt first, in a folder of its own.

    Raises:
        UsageError, SetupError, RunFolderError, Interrupted, OSError
    """
    if is_bag(Path(options.run)):
        _rebuild(options, Path(options.run), None)
        return
    folder = RunFolder.find(options.run, options.runs_dir)
    with open_project(options.root) as project:
        project.ask("mobo_tuner.runs.report", folder.path, show=True)
    print(folder.path)


def compare(options: argparse.Namespace) -> None:
    """Compare several runs in one HTML file, whose path is printed.

    Raises:
        UsageError, SetupError, RunFolderError, Interrupted, OSError
    """
    folders = [RunFolder.find(run, options.runs_dir).path for run in options.runs]
    output = (options.output or options.runs_dir / "compare.html").resolve()
    with open_project(options.root) as project:
        module = "mobo_tuner.runs.report.comparison"
        project.ask(module, *folders, "--output", output, show=True)


def logbook(options: argparse.Namespace) -> None:
    """Have a command of the laboratory's own write about a run.

    Raises:
        UsageError: If no command is known.
        LauncherError: If it failed or took too long.
        RunFolderError: If there is no such run.
    """
    folder = RunFolder.find(options.run, options.runs_dir)
    if not options.command:
        name = VARIABLES[ON_REQUEST]
        raise UsageError(f"no command is given: use --command or the environment variable {name}")
    with Processes() as processes:
        trouble = enter(processes, options.command, ON_REQUEST, folder)
    if trouble:
        raise LauncherError(trouble)


def export(options: argparse.Namespace) -> None:
    """Write the evaluations of a run as a table, whose path is printed.

    Raises:
        UsageError, SetupError, RunFolderError, Interrupted, OSError
    """
    folder = RunFolder.find(options.run, options.runs_dir)
    with open_project(options.root) as project:
        project.ask("mobo_tuner.runs.export", folder.path, "--format", options.format, show=True)


def rebuild(options: argparse.Namespace) -> None:
    """Create a run from its bag alone.

    Raises:
        UsageError, SetupError, RunFolderError, Interrupted, OSError
    """
    _rebuild(options, options.bag, options.run_id)


def _rebuild(options: argparse.Namespace, path: Path, run_id: str | None) -> None:
    bag = path.resolve()
    with open_project(options.root) as project, tempfile.TemporaryDirectory() as scratch:
        arguments = (bag, scratch, *_which(options))
        project.ask("mobo_tuner.runs.rebuild", *arguments, show=True, timeout=LONG)
        folder = RunFolder.create(options.runs_dir, run_id, "rebuilt")
        folder.adopt(Path(scratch))
        folder.record(
            {"run_id": folder.run_id, "state": "rebuilt", "started": now(), "bag": str(bag)}
        )
        project.ask("mobo_tuner.runs.report", folder.path, show=True)
    print(folder.path)


def replay(options: argparse.Namespace) -> None:
    """Compute every suggestion of a run or a bag again, and say whether they are the same.

    Raises:
        UsageError, SetupError, RunFolderError, Interrupted, OSError
    """
    path = Path(options.run)
    if not is_bag(path):
        path = RunFolder.find(options.run, options.runs_dir).path
    with open_project(options.root) as project:
        module = "mobo_tuner.runs.replay"
        project.ask(module, path.resolve(), *_which(options), show=True, timeout=LONG)


def _which(options: argparse.Namespace) -> list[str]:
    """Return the arguments that name one of several runs in a bag."""
    return [f"--of={options.of}"] if options.of else []
