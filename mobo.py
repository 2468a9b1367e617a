#!/usr/bin/env python3
"""Multi-objective tuning of a running machine, from one command.

    python3 mobo.py run          set up, start the nodes, tune, record, report, stop everything
    python3 mobo.py test         set up and run the tests
    python3 mobo.py list         the runs there are
    python3 mobo.py show RUN     what came out of a run
    python3 mobo.py resume RUN   go on with a run that was cut short, or with more evaluations
    python3 mobo.py report RUN   make its report anew
    python3 mobo.py rebuild BAG  make a run anew from its bag alone
    python3 mobo.py replay RUN   ask for every suggestion again, and compare

It needs nothing but Python 3.11, 3.12 or 3.13 on Linux and a C and C++ compiler; the rest goes to
`.venv` beside this file.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import shutil
import signal
import sys
import tempfile
from datetime import datetime
from importlib import metadata
from pathlib import Path

if not (3, 11) <= sys.version_info[:2] <= (3, 13) or sys.platform != "linux":
    sys.exit(
        "mobo.py needs Python 3.11, 3.12 or 3.13 on Linux, for which there are ROS 2 wheels; "
        f"this is Python {sys.version.split()[0]} on {sys.platform}"
    )

from launcher import conductor
from launcher.command_line import UsageError, make_parser
from launcher.environment import (
    DEVELOPMENT_STAGES,
    STAGES,
    Environment,
    SetupError,
    clean_environment,
)
from launcher.processes import Interrupted, Processes
from launcher.ros_domain import DomainError, RosDomain
from launcher.run_folder import JOURNAL_FILE, RunFolder, RunFolderError, process_start, table

ROOT = Path(__file__).resolve().parent
NODES = (conductor.MACHINE, conductor.TUNER, conductor.RECORDER, conductor.CONSOLE)
CHECK_TIMEOUT = 60.0  # [s] for a configuration, or a report
LONG = 3600.0  # [s] for what takes as long as a run's suggestions did
TEST_TIMEOUT = 3600.0  # [s]
# One thread each: the processes of a run share the cores.
THREADS = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
RECORDED_VERSIONS = (
    "mobo_tuner",
    "awa_sim_node",
    "mobo_msgs_py",
    "ros-jazzy-rclpy",
    "torch",
    "numpy",
    "scipy",
    "numba",
    "rosbags",
)
PARALLEL_TESTS = ("-n", "2", "--dist", "loadfile")


class RunError(Exception):
    """A run did not end well; the message is for the user."""

    def __init__(self, message: str, exit_status: int = 1) -> None:
        super().__init__(message)
        self.exit_status = exit_status


# ---------------------------------------------------------------------------- the verbs


def run(options: argparse.Namespace) -> None:
    """Tune the machine of a configuration, once.

    Raises:
        UsageError, SetupError, DomainError, RunFolderError, RunError, Interrupted, OSError
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
    with Processes() as processes:
        environment = Environment(ROOT, STAGES)
        environment.set_up(processes)
        consult(processes, environment.python, "awa_sim_node.check_config", config)
        with RosDomain(options.domain_id, network=options.network) as domain:
            folder = RunFolder.create(runs_dir, options.run_id, config.stem)
            carry_out(processes, environment, config, folder, domain, options)


def resume(options: argparse.Namespace) -> None:
    """Go on with a run, in a new one beside it that begins with its evaluations.

    Raises:
        UsageError, SetupError, DomainError, RunFolderError, RunError, Interrupted, OSError
    """
    earlier = RunFolder.find(options.run, options.runs_dir)
    facts = earlier.facts()
    if facts.get("state") == "running":
        raise UsageError(f"the run '{earlier.run_id}' is going on; stop it first")
    if options.config is not None and not options.config.is_file():
        raise UsageError(f"the configuration '{options.config}' is not a file")
    arguments = facts.get("arguments") or {}
    options.seed = arguments.get("seed")
    if options.speed is None:
        options.speed = arguments.get("speed")
    with Processes() as processes, tempfile.TemporaryDirectory() as scratch:
        environment = Environment(ROOT, STAGES)
        environment.set_up(processes)
        config = Path(scratch, "config.yaml")
        given = ["--config", options.config.resolve()] if options.config else []
        if options.evaluations:
            given += ["--evaluations", options.evaluations]
        module = "mobo_tuner.runs.resume_config"
        consult(processes, environment.python, module, earlier.path, config, *given)
        consult(processes, environment.python, "awa_sim_node.check_config", config)
        with RosDomain(options.domain_id, network=options.network) as domain:
            folder = RunFolder.create_after(earlier, options.run_id)
            carry_out(processes, environment, config, folder, domain, options, earlier.run_id)


def carry_out(
    processes: Processes,
    environment: Environment,
    config: Path,
    folder: RunFolder,
    domain: RosDomain,
    options: argparse.Namespace,
    resumed_from: str | None = None,
) -> None:
    """Carry out a run in its folder, whose last words are its path.

    Raises:
        RunError: it did not end well.
        OSError: the folder cannot be written.
    """
    source = config if options.config is None else options.config.resolve()
    facts = {
        "run_id": folder.run_id,
        "state": "running",
        "started": now(),
        "pid": os.getpid(),
        "pid_started": process_start(os.getpid()),
        "domain_id": domain.id,
        "arguments": {
            "config": str(source),
            "evaluations": options.evaluations,
            "seed": options.seed,
            "speed": options.speed,
        },
        "versions": versions(environment.folder),
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
    ending = conductor.Ending("failed", "the run failed: mobo.py met an error of its own", 1)
    try:
        folder.record(facts)
        ending = tune(processes, environment.python, config, folder, domain, values)
    except Interrupted as interruption:
        ending = conductor.interrupted(interruption)
    finally:
        facts |= {"state": ending.state, "reason": ending.reason, "ended": now()}
        folder.record(facts)
        print(folder.path, flush=True)
    if ending.exit_status:
        raise RunError("\n".join((ending.reason, *ending.details)), ending.exit_status)


def tune(
    processes: Processes,
    python: Path,
    config: Path,
    folder: RunFolder,
    domain: RosDomain,
    values: dict[str, object],
) -> conductor.Ending:
    """Run the nodes until the console is done, and make the report."""
    used = folder.path / "config.yaml"
    used.write_bytes(config.read_bytes())
    launch = conductor.Launch(
        commands={node.name: node.command(python, used, values) for node in NODES},
        foreground=conductor.CONSOLE.name,
        last=conductor.RECORDER.name,
        environment=clean_environment(
            **domain.environment,
            **THREADS,
            PYTHONUNBUFFERED="1",
            MPLBACKEND="Agg",
            ROS_LOG_DIR=str(folder.path / "log"),
        ),
        folder=folder.path,
    )
    print(f"run {folder.run_id} in ROS domain {domain.id}; to join from another terminal:")
    print("  export " + " ".join(f"{k}={v}" for k, v in domain.environment.items()), flush=True)
    tuning_run = conductor.Conductor(processes, launch)
    ending = tuning_run.run()
    if folder.has_journal or ending.state == "finished":
        failure = tuning_run.report(
            [str(python), "-P", "-m", "mobo_tuner.runs.report", str(folder.path)]
        )
        if failure and ending.state == "finished":
            return conductor.Ending("failed", failure, 1)
    return ending


def consult(
    processes: Processes,
    python: Path,
    module: str,
    *arguments: object,
    timeout: float = CHECK_TIMEOUT,
) -> None:
    """Run one of the project's programs, whose last line on standard error says what is wrong.

    Raises:
        UsageError: it says that something is.
        Interrupted: a signal came.
    """
    with tempfile.TemporaryFile() as complaint:
        process = processes.start(
            [str(python), "-P", "-m", module, *map(str, arguments)],
            environment=clean_environment(**THREADS, MPLBACKEND="Agg"),
            cwd=Path.cwd(),
            stderr=complaint,
        )
        status = processes.wait(process, timeout)
        complaint.seek(0)
        words = complaint.read().decode(errors="replace").strip().splitlines()
    if status is None:
        raise UsageError(f"{module} was not done after {timeout:.0f} s")
    if status != 0:
        raise UsageError(words[-1] if words else f"{module} ended with status {status}")


def test(arguments: list[str]) -> int:
    """Run the tests with pytest's arguments, or all of them in parallel; return pytest's status.

    Raises:
        SetupError, Interrupted, OSError
    """
    with Processes() as processes:
        environment = Environment(ROOT, (*STAGES, *DEVELOPMENT_STAGES))
        environment.set_up(processes)
        process = processes.start(
            [str(environment.python), "-m", "pytest", *(arguments or PARALLEL_TESTS)],
            environment=clean_environment(**THREADS, MPLBACKEND="Agg"),
            cwd=ROOT,
            stdin=None,
        )
        try:
            status = processes.wait(process, TEST_TIMEOUT)
        except Interrupted:
            processes.stop([process], patience=conductor.EXIT_LIMIT - 1.5)
            raise
    if status is None:
        raise RunError(f"the tests were not done after {TEST_TIMEOUT:.0f} s")
    return status


def list_runs(options: argparse.Namespace) -> None:
    """Print the runs in a folder as a table.

    Raises:
        RunFolderError: the folder cannot be read.
    """
    rows = []
    for folder in RunFolder.all(options.runs_dir):
        try:
            rows.append(folder.row())
        except RunFolderError as error:
            complain(error)
            rows.append([folder.run_id, "unreadable", "-", "-", "-"])
    if not rows:
        print(f"there are no runs in '{options.runs_dir}'")
        return
    header = ["run", "state", "evaluations", "hypervolume", "started"]
    print("\n".join(table(header, rows)))


def show(options: argparse.Namespace) -> None:
    """Print what came out of a run.

    Raises:
        RunFolderError: there is no such run, or it cannot be read.
    """
    print(RunFolder.find(options.run, options.runs_dir).description())


def report(options: argparse.Namespace) -> None:
    """Make the report of a run anew, from its journal.

    Raises:
        UsageError, SetupError, RunFolderError, Interrupted, OSError
    """
    folder = RunFolder.find(options.run, options.runs_dir)
    with Processes() as processes:
        environment = Environment(ROOT, STAGES)
        environment.set_up(processes)
        consult(processes, environment.python, "mobo_tuner.runs.report", folder.path)
    print(folder.path)


def rebuild(options: argparse.Namespace) -> None:
    """Make a run anew from its bag alone.

    Raises:
        UsageError, SetupError, RunFolderError, Interrupted, OSError
    """
    bag: Path = options.bag.resolve()
    with Processes() as processes, tempfile.TemporaryDirectory() as scratch:
        environment = Environment(ROOT, STAGES)
        environment.set_up(processes)
        which = ["--of", options.of] if options.of else []
        arguments = (bag, scratch, *which)
        consult(processes, environment.python, "mobo_tuner.runs.rebuild", *arguments, timeout=LONG)
        folder = RunFolder.create(options.runs_dir, options.run_id, "rebuilt")
        shutil.copy(Path(scratch, JOURNAL_FILE), folder.path)
        folder.record(
            {"run_id": folder.run_id, "state": "rebuilt", "started": now(), "bag": str(bag)}
        )
        consult(processes, environment.python, "mobo_tuner.runs.report", folder.path)
    print(folder.path)


def replay(options: argparse.Namespace) -> None:
    """Ask for every suggestion of a run again, and say whether they are the same.

    Raises:
        UsageError, SetupError, RunFolderError, Interrupted, OSError
    """
    path = Path(options.run)
    if not (path.suffix == ".mcap" or any(path.glob("*.mcap"))):
        path = RunFolder.find(options.run, options.runs_dir).path
    with Processes() as processes:
        environment = Environment(ROOT, STAGES)
        environment.set_up(processes)
        consult(
            processes, environment.python, "mobo_tuner.runs.replay", path.resolve(), timeout=LONG
        )


def now() -> str:
    """The local time with its offset from UTC."""
    return datetime.now().astimezone().isoformat(timespec="seconds")


def versions(folder: Path) -> dict[str, str]:
    """Versions of what a virtual environment holds and a run depends on."""
    packages = [str(path) for path in folder.glob("lib/python3.*/site-packages")]
    found = metadata.distributions(path=packages)
    wanted = {d.name: d.version for d in found if d.name in RECORDED_VERSIONS}
    return {"python": (folder / "bin" / "python").resolve().name, **dict(sorted(wanted.items()))}


VERBS = {
    "run": run,
    "list": list_runs,
    "show": show,
    "resume": resume,
    "report": report,
    "rebuild": rebuild,
    "replay": replay,
}


def main(arguments: list[str]) -> int:
    """Do what the command line says; return the exit status."""
    try:
        if arguments[:1] == ["test"]:
            return test(arguments[1:])
        options = make_parser(__doc__ or "", ROOT, VERBS).parse_args(arguments)
        options.act(options)
    except UsageError as error:
        return complain(error, 2)
    except RunError as error:
        return complain(error, error.exit_status)
    except Interrupted as interruption:
        return complain(interruption, interruption.exit_status)
    except BrokenPipeError:  # who read the output has seen enough
        return 1
    except (SetupError, DomainError, RunFolderError, OSError) as error:
        return complain(error, 1)
    except KeyboardInterrupt:
        return complain("stopped by SIGINT", 128 + signal.SIGINT)
    return 0


def complain(what: object, exit_status: int = 1) -> int:
    """Say what went wrong; return the exit status."""
    with contextlib.suppress(OSError):  # the terminal may be gone
        print(f"mobo.py: {what}", file=sys.stderr, flush=True)
    return exit_status


if __name__ == "__main__":
    status = main(sys.argv[1:])
    try:
        sys.stdout.flush()
    except OSError:  # whoever read it is gone; say so by the status alone
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        status = status or 1
    sys.exit(status)
