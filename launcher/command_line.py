"""The command line of `mobo.py`: its verbs, their options and allowed values."""

from __future__ import annotations

import argparse
import math
import os
import re
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import NoReturn

from launcher.errors import UsageError
from launcher.logbook import ON_REQUEST, ON_RUN_END, VARIABLES
from launcher.machine import split_command
from launcher.page import FIRST_PORT, LOCAL, MAX_PORT
from launcher.ros_domain import HIGHEST as HIGHEST_DOMAIN
from launcher.run_folder import RUN_ID, RUN_ID_RULE

MAX_EVALUATIONS = 100_000
MAX_SEED = 2**31 - 1
MAX_WORKERS = 10_000
MIN_SPEED, MAX_SPEED = 1e-3, 1e6
RUN_HELP = "run id, or path of a run folder"
STEERING = {
    "status": "print the state of the tuner",
    "watch": "show the active run",
    "pause": "pause the run before its next evaluation",
    "continue": "continue a paused run",
    "step": "do one more evaluation, then pause",
    "skip": "end the current evaluation, which counts as failed",
    "stop": "end the run after the current evaluation",
    "cancel": "cancel the active run or move",
    "queue": "evaluate a set-point of your own next",
    "forget": "count an evaluation as never measured",
    "unforget": "count a withdrawn evaluation again",
    "set": "change bounds, limits, goals, costs or the budget",
    "points": "list the Pareto front of a run",
    "go": "go to a point of a Pareto front",
}
"""Verbs that concern a running tuner; a program of their own parses their arguments."""
LIVE = "live"
"""Verb that serves a running tuner to viewers."""

Act = Callable[[argparse.Namespace], None]


class Parser(argparse.ArgumentParser):
    """A parser whose errors are one sentence."""

    def error(self, message: str) -> NoReturn:
        """Raise UsageError instead of printing the usage."""
        raise UsageError(message)


def _whole(low: int, high: int) -> Callable[[str], int]:
    def convert(text: str) -> int:
        if not re.fullmatch(r"-?[0-9]{1,18}", text) or not low <= int(text) <= high:
            raise argparse.ArgumentTypeError(f"'{text}' is not an integer from {low} to {high}")
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
        raise argparse.ArgumentTypeError(f"'{text}' is not a run id; allowed are {RUN_ID_RULE}")
    return text


def _command(option: str) -> Callable[[str], str]:
    def check(text: str) -> str:
        split_command(text, option)
        return text

    return check


def make_parser(description: str, root: Path, verbs: Mapping[str, Act]) -> argparse.ArgumentParser:
    """Return the parser of the command line without the verb `test`, whose arguments go to pytest.

    Args:
        description: Text of `--help`.
        root: Folder of the project; verbs receive it as the option `root`.
        verbs: Function of each verb.
    """
    parser = Parser(
        prog="mobo.py",
        description=description,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,
    )
    subparsers = parser.add_subparsers(dest="verb", required=True, metavar="VERB")

    def add(name: str, what: str) -> Parser:
        verb = subparsers.add_parser(name, help=what, description=what, allow_abbrev=False)
        add_runs_dir(verb, root)
        verb.set_defaults(act=verbs[name], root=root)
        return verb

    run = add("run", "tune the machine of a parameter file in one run")
    run.add_argument(
        "--config",
        metavar="FILE",
        type=Path,
        default=root / "config" / "awa.yaml",
        help="ROS parameter file (default: config/awa.yaml, beside mobo.py)",
    )
    _add_budget(run, "budget of the run (default: that of the file, 60 in config/awa.yaml)")
    _add_seed(run, "seed of all random numbers, including the simulated noise")
    _add_run_id(run, "the time")
    run.add_argument(
        "--warm-start",
        metavar="SOURCE",
        nargs="+",
        default=[],
        help="runs, bags, tables (CSV) or archives of Badger or Xopt (YAML) whose evaluations the run begins with",
    )
    _add_machine(run, "the choice of the parameter file")
    _add_surroundings(run, "that of the file")

    check = add("check", "print what a parameter file means, without starting anything")
    check.add_argument("config", metavar="FILE", type=Path, help="ROS parameter file")
    _add_machine(check, "none")

    layout = add("layout", "write layouts for Lichtblick, Foxglove and PlotJuggler")
    layout.add_argument("config", metavar="FILE", type=Path, help="ROS parameter file")
    layout.add_argument(
        "--output",
        metavar="FOLDER",
        type=Path,
        default=Path(),
        help="folder for them (default: the current one)",
    )

    new = add("new", "write a parameter file from what a machine has")
    new.add_argument("config", metavar="FILE", type=Path, help="file to write; it must not exist")
    new.add_argument(
        "--like", metavar="FILE", type=Path, help="parameter file whose section chooses the machine"
    )
    _add_machine(new, "one that is there already")
    for direction in ("minimize", "maximize"):
        new.add_argument(
            f"--{direction}",
            metavar="NAME",
            nargs="+",
            default=[],
            help=f"diagnostics to {direction} (default: the first one is minimized)",
        )
    new.add_argument(
        "--around",
        metavar="WIDTH",
        default="",
        help="bounds around the present values: a number, or a share such as '10 %%' "
        "(default: the machine's limits)",
    )
    add_domain_id(new, "a free one; if the machine is already there, ROS_DOMAIN_ID or 0")
    new.set_defaults(network=False)

    for name, what in STEERING.items():
        subparsers.add_parser(name, help=what)
    subparsers.add_parser(LIVE, help="serve the run to Lichtblick, Foxglove or PlotJuggler")
    subparsers.add_parser("test", help="set up and run the tests; arguments go to pytest")
    add("list", "list the runs")
    add("show", "print the result of a run").add_argument("run", metavar="RUN", help=RUN_HELP)

    resume = add("resume", "continue a run in a new one that starts with its evaluations")
    resume.add_argument("run", metavar="RUN", help=RUN_HELP)
    resume.add_argument(
        "--config",
        metavar="FILE",
        type=Path,
        help="file with other bounds, objectives or constraints (default: those of the run's end)",
    )
    _add_budget(resume, "budget, including the earlier evaluations (default: that of the run)")
    _add_run_id(resume, "RUN-2, ...")
    _add_machine(resume, "that of the run")
    _add_surroundings(resume, "that of the run")

    report = add("report", "create the report of a run again, or that of a bag")
    report.add_argument("run", metavar="RUN", help=RUN_HELP + " or of a bag")
    compare = add("compare", "compare runs in one HTML file")
    compare.add_argument("runs", metavar="RUN", nargs="+", help=RUN_HELP)
    compare.add_argument(
        "--output",
        metavar="FILE",
        type=Path,
        help="file to write (default: compare.html, in the folder of the runs)",
    )
    logbook = add("logbook", "have a command of your own write about a run")
    logbook.add_argument("run", metavar="RUN", help=RUN_HELP)
    logbook.add_argument(
        "--command",
        metavar="COMMAND",
        type=_command("--command"),
        default=os.environ.get(VARIABLES[ON_REQUEST]) or None,
        help="command, which gets the run as JSON on its standard input (default: the environment variable "
        f"{VARIABLES[ON_REQUEST]})",
    )
    export = add("export", "write the evaluations of a run as a table into its folder")
    export.add_argument("run", metavar="RUN", help=RUN_HELP)
    export.add_argument(
        "--format", choices=("csv", "parquet"), default="csv", help="format (default: csv)"
    )
    rebuild = add("rebuild", "create a run from its bag alone, even an incomplete one")
    rebuild.add_argument(
        "bag", metavar="BAG", type=Path, help="folder of the bag, or one of its files"
    )
    rebuild.add_argument("--run-id", metavar="ID", type=_run_id, help="name of the new run folder")
    replay = add("replay", "compute every suggestion of a run or a bag again, and compare")
    replay.add_argument("run", metavar="RUN", help=RUN_HELP + " or of a bag")
    _add_campaign(add("campaign", "optimise a simulation in place of a machine"), root)
    for verb in (report, rebuild, replay):
        verb.add_argument("--of", metavar="ID", help="name of the run, if a bag holds several")
    return parser


def _add_campaign(campaign: argparse.ArgumentParser, root: Path) -> None:
    source = campaign.add_mutually_exclusive_group()
    source.add_argument(
        "--config",
        metavar="FILE",
        type=Path,
        default=root / "config" / "campaign.yaml",
        help="parameter file with a section 'campaign' (default: config/campaign.yaml, beside mobo.py)",
    )
    source.add_argument("--resume", metavar="RUN", help=f"campaign to continue: {RUN_HELP}")
    campaign.add_argument(
        "--workers",
        metavar="N",
        type=_whole(1, MAX_WORKERS),
        help="simulations at the same time (default: that of the file)",
    )
    campaign.add_argument(
        "--listen",
        metavar="ADDRESS",
        help="simulate by workers on other hosts, which join at this address of this host",
    )
    _add_budget(campaign, "budget, including earlier evaluations (default: that of the file)")
    _add_seed(campaign, "seed")
    _add_run_id(campaign, "the time")


def _add_budget(verb: argparse.ArgumentParser, what: str) -> None:
    verb.add_argument("--evaluations", metavar="N", type=_whole(1, MAX_EVALUATIONS), help=what)


def _add_seed(verb: argparse.ArgumentParser, what: str) -> None:
    what += " (default: that of the file)"
    verb.add_argument("--seed", metavar="S", type=_whole(0, MAX_SEED), help=what)


def _add_run_id(verb: argparse.ArgumentParser, default: str) -> None:
    what = f"name of the new run (default: {default})"
    verb.add_argument("--run-id", metavar="ID", type=_run_id, help=what)


def add_runs_dir(verb: argparse.ArgumentParser, root: Path) -> None:
    """Add the option for the folder of the runs."""
    verb.add_argument(
        "--runs-dir",
        metavar="DIR",
        type=Path,
        default=root / "runs",
        help="folder of the runs (default: runs, beside mobo.py)",
    )


def add_domain_id(verb: argparse.ArgumentParser, default: str) -> None:
    """Add the option for the ROS domain."""
    verb.add_argument(
        "--domain-id",
        metavar="N",
        type=_whole(0, HIGHEST_DOMAIN),
        help=f"ROS domain (default: {default})",
    )


def _add_machine(verb: argparse.ArgumentParser, default: str) -> None:
    verb.add_argument(
        "--machine",
        metavar="COMMAND",
        type=_command("--machine"),
        help=f"program to start as the machine's node (default: {default})",
    )


def _add_surroundings(verb: argparse.ArgumentParser, speed: str) -> None:
    """Add the options for the environment of a run's nodes."""
    verb.add_argument(
        "--on-run-end",
        metavar="COMMAND",
        type=_command("--on-run-end"),
        default=os.environ.get(VARIABLES[ON_RUN_END]) or None,
        help="command of your own for the logbook, which gets the run at its end, however it ended, as JSON on its "
        f"standard input (default: the environment variable {VARIABLES[ON_RUN_END]})",
    )
    verb.add_argument("--no-dashboard", action="store_true", help="do not start the page")
    verb.add_argument(
        "--port",
        metavar="N",
        type=_whole(1, MAX_PORT),
        help=f"port of the page (default: the first free one from {FIRST_PORT})",
    )
    verb.add_argument(
        "--page-host",
        metavar="ADDRESS",
        default=LOCAL,
        help="address on which the page listens; on any other than this host's own, only who opens the "
        "printed address with its token may act (default: 127.0.0.1)",
    )
    verb.add_argument(
        "--no-browser",
        action="store_true",
        help="do not open the page in a browser, as happens from a terminal on a desktop",
    )
    verb.add_argument(
        "--speed",
        metavar="X",
        type=_speed,
        help=f"simulated seconds per second of the simulated machine (default: {speed})",
    )
    add_domain_id(verb, "a free one; if the machine's node is already running, ROS_DOMAIN_ID or 0")
    verb.add_argument(
        "--network",
        action="store_true",
        help="let other hosts of the network take part (default: this host alone)",
    )
