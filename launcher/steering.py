"""The verbs of `mobo.py` for a running tuner: find it, and start the program that calls it."""

from __future__ import annotations

import argparse
import contextlib
import os
import signal
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple, NoReturn

from launcher.command_line import LIVE, STEERING, Parser, add_domain_id, add_runs_dir
from launcher.environment import LIVE_STAGES, STAGES, clean_environment
from launcher.errors import RunFolderError, UsageError
from launcher.programs import open_project
from launcher.ros_domain import surroundings
from launcher.run_folder import RunFolder

PROGRAM = "mobo_tuner.nodes.steer"
LIVE_SERVER = "mobo_tuner.nodes.live_server"
# Variables of the user's environment that define how ROS programs find each other.
DISCOVERY = (
    "ROS_DOMAIN_ID",
    "ROS_AUTOMATIC_DISCOVERY_RANGE",
    "ROS_STATIC_PEERS",
    "FASTDDS_BUILTIN_TRANSPORTS",
    "FASTRTPS_DEFAULT_PROFILES_FILE",
)
WITH_RUN = ("points", "go")  # verbs that also concern earlier runs


def steer(root: Path, arguments: Sequence[str]) -> NoReturn:
    """Replace this process by the program of the verb.

    The program then handles signals and the terminal, and sets the exit status.

    Args:
        root: Folder of the project.
        arguments: Verb and its arguments.

    Raises:
        UsageError, SetupError, RunFolderError, Interrupted, OSError
    """
    verb = arguments[0]
    options, others = _parser(root, verb).parse_known_args(arguments[1:])
    if verb in WITH_RUN and options.run:
        others = [*others, "--run", Path(options.run).name]
    environment = {} if {"-h", "--help"} & {*others} else _find_tuner(options, verb, os.environ)
    live = verb == LIVE
    with open_project(root, (*STAGES, *LIVE_STAGES) if live else STAGES) as project:
        python = str(project.environment.python)
    words = [LIVE_SERVER, *_node_arguments(others)] if live else [PROGRAM, verb, *others]
    sys.stdout.flush()
    # A Ctrl-C while Python starts waits for the program, which ends quietly (`mobo_tuner.interrupts`).
    signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    os.execve(python, [python, "-P", "-m", *words], clean_environment(**environment))


def _node_arguments(words: Sequence[str]) -> list[str]:
    """Return the arguments of the live server's node.

    Raises:
        UsageError: If a word is not allowed.
    """
    parser = Parser(
        prog="mobo.py live",
        description="Serve the active run to Lichtblick, Foxglove or PlotJuggler, until Ctrl-C.",
        allow_abbrev=False,
    )
    parser.add_argument("--port", metavar="N", type=int, default=8765, help="port (default: 8765)")
    parser.add_argument(
        "--steer",
        action="store_true",
        help="let viewers on this host pause, step, skip, stop and set parameters; so can every web page "
        "that is open on this host then",
    )
    options = parser.parse_args(words)
    read_only = str(not options.steer).lower()
    given = (f"port:={options.port}", f"read_only:={read_only}")
    return ["--ros-args", *(word for value in given for word in ("-p", value))]


def _parser(root: Path, verb: str) -> argparse.ArgumentParser:
    """Return the parser of the options that define the tuner; the program parses the others."""
    assert verb in STEERING or verb == LIVE
    parser = Parser(prog=f"mobo.py {verb}", add_help=False, allow_abbrev=False)
    add_runs_dir(parser, root)
    add_domain_id(parser, "that of the run, or ROS_DOMAIN_ID")
    parser.add_argument("--run", metavar="RUN", default="")
    return parser


def _find_tuner(
    options: argparse.Namespace, verb: str, environment: Mapping[str, str]
) -> dict[str, str]:
    """Return the environment variables with which the program finds the tuner.

    An active run is found by its folder, permanent nodes by `ROS_DOMAIN_ID`.

    Raises:
        UsageError: If the choice of the tuner is not unique.
        RunFolderError: If there is no such run.
    """
    own = {name: environment[name] for name in DISCOVERY if name in environment}
    if options.domain_id is not None:
        return {**own, "ROS_DOMAIN_ID": str(options.domain_id)}
    if options.run:
        try:
            place = _place_of(RunFolder.find(options.run, options.runs_dir))
        except RunFolderError:
            if verb not in WITH_RUN:  # the tuner may know it
                raise
            place = None
        if place is not None:
            return surroundings(*place)
        if verb not in WITH_RUN:
            raise UsageError(f"the run '{options.run}' is not active")
    running = {}
    for folder in RunFolder.all(options.runs_dir):
        with contextlib.suppress(RunFolderError):  # one that cannot be read hides no other
            place = _place_of(folder)
            if place is not None:
                running[folder.run_id] = place
    given = own.get("ROS_DOMAIN_ID", "")
    domains = {str(place.domain_id) for place in running.values()} | ({given} if given else set())
    if not domains:
        raise UsageError(
            f"no run is active in '{options.runs_dir}', and ROS_DOMAIN_ID is not set: "
            "give --domain-id"
        )
    if len(domains) > 1:
        found = [f"run '{name}' in ROS domain {place.domain_id}" for name, place in running.items()]
        found += [f"ROS_DOMAIN_ID is {given}"] if given else []
        raise UsageError(f"several tuners are possible ({', '.join(found)}): give --domain-id")
    return surroundings(*next(iter(running.values()))) if running else own


class Place(NamedTuple):
    """Where an active run is found: its ROS domain, and whether other hosts take part."""

    domain_id: int
    network: bool


def _place_of(folder: RunFolder) -> Place | None:
    """Return where an active run is found; None if the run is not active.

    Raises:
        RunFolderError: If the folder cannot be read.
    """
    facts = folder.facts()
    domain = facts.get("domain_id")
    if facts.get("state") != "running" or not isinstance(domain, int):
        return None
    return Place(domain, facts.get("network") is True)
