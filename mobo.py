#!/usr/bin/env python3
"""Multi-objective tuning of a running machine, from one command.

    python3 mobo.py run       set up, start the nodes, tune, record, report, stop everything
    python3 mobo.py test      set up and run the tests
    python3 mobo.py list      the runs there are
    python3 mobo.py show RUN  what came out of a run

It needs nothing but Python 3.11, 3.12 or 3.13 on Linux and a C and C++ compiler; the rest goes to
`.venv` beside this file.
"""

from __future__ import annotations

import argparse
import contextlib
import math
import os
import re
import signal
import sys
import tempfile
from collections.abc import Callable
from datetime import datetime
from importlib import metadata
from pathlib import Path
from typing import NoReturn

if not (3, 11) <= sys.version_info[:2] <= (3, 13) or sys.platform != "linux":
    sys.exit(
        "mobo.py needs Python 3.11, 3.12 or 3.13 on Linux, for which there are ROS 2 wheels; "
        f"this is Python {sys.version.split()[0]} on {sys.platform}"
    )

from tools import tuning
from tools.environment import (
    DEVELOPMENT_STAGES,
    STAGES,
    Environment,
    SetupError,
    clean_environment,
)
from tools.processes import Interrupted, Processes
from tools.ros_domain import LAST as LAST_DOMAIN
from tools.ros_domain import DomainError, RosDomain
from tools.run_folder import (
    RUN_ID,
    RUN_ID_RULE,
    RunFolder,
    RunFolderError,
    process_start,
    table,
)

ROOT = Path(__file__).resolve().parent
NODES = (tuning.MACHINE, tuning.TUNER, tuning.RECORDER, tuning.CONSOLE)
MAX_EVALUATIONS = 100_000
MAX_SEED = 2**31 - 1
MIN_SPEED, MAX_SPEED = 1e-3, 1e6
CHECK_TIMEOUT = 60.0  # [s] for the configuration
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


class UsageError(Exception):
    """The command line is wrong; the message is one sentence for the user."""


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
        check_config(processes, environment.python, config)
        with RosDomain(options.domain_id) as domain:
            folder = RunFolder.create(runs_dir, options.run_id, config.stem)
            facts = {
                "run_id": folder.run_id,
                "state": "running",
                "started": now(),
                "pid": os.getpid(),
                "pid_started": process_start(os.getpid()),
                "domain_id": domain.id,
                "arguments": {
                    "config": str(config),
                    "evaluations": options.evaluations,
                    "seed": options.seed,
                    "speed": options.speed,
                },
                "versions": versions(environment.folder),
            }
            ending = tuning.Ending("failed", "the run failed: mobo.py met an error of its own", 1)
            try:
                folder.record(facts)
                ending = tune(processes, environment.python, config, folder, domain, options)
            except Interrupted as interruption:
                ending = tuning.interrupted(interruption)
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
    options: argparse.Namespace,
) -> tuning.Ending:
    """Run the nodes until the console is done, and make the report."""
    used = folder.path / "config.yaml"
    used.write_bytes(config.read_bytes())
    values = {
        "seed": options.seed,
        "speed": options.speed,
        "runs_dir": folder.path.parent,
        "bag_path": folder.path / "bag",
        "run_id": folder.run_id,
        "evaluations": options.evaluations,
    }
    launch = tuning.Launch(
        commands={node.name: node.command(python, used, values) for node in NODES},
        foreground=tuning.CONSOLE.name,
        last=tuning.RECORDER.name,
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
    conductor = tuning.Conductor(processes, launch)
    ending = conductor.run()
    if folder.has_journal or ending.state == "finished":
        failure = conductor.report([str(python), "-P", "-m", "mobo_tuner.report", str(folder.path)])
        if failure and ending.state == "finished":
            return tuning.Ending("failed", failure, 1)
    return ending


def check_config(processes: Processes, python: Path, config: Path) -> None:
    """Have the configuration checked against the machine.

    Raises:
        UsageError: it is wrong.
        Interrupted: a signal came.
    """
    with tempfile.TemporaryFile() as complaint:
        process = processes.start(
            [str(python), "-P", "-m", "awa_sim_node.check_config", str(config)],
            environment=clean_environment(**THREADS),
            cwd=ROOT,
            stderr=complaint,
        )
        status = processes.wait(process, CHECK_TIMEOUT)
        complaint.seek(0)
        words = complaint.read().decode(errors="replace").strip().splitlines()
    if status is None:
        raise UsageError(f"the check of '{config}' was not done after {CHECK_TIMEOUT:.0f} s")
    if status != 0:
        raise UsageError(words[-1] if words else f"the configuration '{config}' is wrong")


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
            processes.stop([process], patience=tuning.EXIT_LIMIT - 1.5)
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


def later(options: argparse.Namespace) -> NoReturn:
    """Say that a verb is not there yet.

    Raises:
        UsageError: always.
    """
    raise UsageError(f"'{options.verb}' comes in a later version; nothing was done")


def now() -> str:
    """The local time with its offset from UTC."""
    return datetime.now().astimezone().isoformat(timespec="seconds")


def versions(folder: Path) -> dict[str, str]:
    """Versions of what a virtual environment holds and a run depends on."""
    packages = [str(path) for path in folder.glob("lib/python3.*/site-packages")]
    found = metadata.distributions(path=packages)
    wanted = {d.name: d.version for d in found if d.name in RECORDED_VERSIONS}
    return {"python": (folder / "bin" / "python").resolve().name, **dict(sorted(wanted.items()))}


# ---------------------------------------------------------------------------- the command line


class _Parser(argparse.ArgumentParser):
    """A parser whose complaints are one sentence."""

    def error(self, message: str) -> NoReturn:
        """Raise UsageError instead of printing the usage."""
        raise UsageError(message)


def _whole(low: int, high: int) -> Callable[[str], int]:
    def convert(text: str) -> int:
        if not re.fullmatch(r"-?[0-9]{1,18}", text) or not low <= int(text) <= high:
            raise argparse.ArgumentTypeError(f"'{text}' is not a whole number from {low} to {high}")
        return int(text)

    return convert


def _speed(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not MIN_SPEED <= value <= MAX_SPEED:
        raise argparse.ArgumentTypeError(
            f"'{text}' is not a number from {MIN_SPEED:g} to {MAX_SPEED:g}"
        )
    return value


def _run_id(text: str) -> str:
    if not RUN_ID.fullmatch(text):
        raise argparse.ArgumentTypeError(f"'{text}' is no run id; allowed are {RUN_ID_RULE}")
    return text


def make_parser() -> argparse.ArgumentParser:
    """The parser of the command line, but for the verb `test`, whose arguments go to pytest."""
    parser = _Parser(
        prog="mobo.py",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,
    )
    verbs = parser.add_subparsers(dest="verb", required=True, metavar="VERB")

    def add(act: Callable[[argparse.Namespace], None], name: str, what: str) -> _Parser:
        verb = verbs.add_parser(name, help=what, description=what, allow_abbrev=False)
        folder = ROOT / "runs"
        what = "where runs are kept (default: runs, beside mobo.py)"
        verb.add_argument("--runs-dir", metavar="DIR", type=Path, default=folder, help=what)
        verb.set_defaults(act=act)
        return verb

    tuning_run = add(run, "run", "tune the machine of a configuration, once")
    option = tuning_run.add_argument
    option(
        "--config",
        metavar="FILE",
        type=Path,
        default=ROOT / "config" / "awa.yaml",
        help="ROS parameter file (default: config/awa.yaml, beside mobo.py)",
    )
    option(
        "--evaluations",
        metavar="N",
        type=_whole(1, MAX_EVALUATIONS),
        help="budget of the run (default: as configured, 60 for the shipped awa.yaml)",
    )
    option(
        "--seed",
        metavar="S",
        type=_whole(0, MAX_SEED),
        help="of every random choice, the simulated noise included (default: as configured)",
    )
    option("--run-id", metavar="ID", type=_run_id, help="name of the run (default: the time)")
    option("--no-dashboard", action="store_true", help="accepted; there is no page yet")
    option(
        "--speed",
        metavar="X",
        type=_speed,
        help="simulated seconds per second of the simulated machine (default: as configured)",
    )
    option(
        "--domain-id",
        metavar="N",
        type=_whole(0, LAST_DOMAIN),
        help="ROS domain (default: one that is free)",
    )
    verbs.add_parser("test", help="set up and run the tests; arguments go to pytest")
    add(list_runs, "list", "list the runs")
    for act, name, what in (
        (show, "show", "show what came out of a run"),
        (later, "resume", "go on with a run that was cut short (in a later version)"),
        (later, "report", "make the report of a run anew (in a later version)"),
    ):
        help_text = "run id, or path of a run folder"
        add(act, name, what).add_argument("run", metavar="RUN", help=help_text)
    return parser


def main(arguments: list[str]) -> int:
    """Do what the command line says; return the exit status."""
    try:
        if arguments[:1] == ["test"]:
            return test(arguments[1:])
        options = make_parser().parse_args(arguments)
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
