#!/usr/bin/env python3
"""Multi-objective tuning of a running machine, from one command.

    python3 mobo.py run          set up, start the nodes, tune, record, report, stop the nodes
    python3 mobo.py test         set up and run the tests
    python3 mobo.py check FILE   print what a parameter file means, without starting anything
    python3 mobo.py new FILE     write a parameter file from what a machine has
    python3 mobo.py layout FILE  write layouts for Lichtblick, Foxglove and PlotJuggler
    python3 mobo.py list         list the runs
    python3 mobo.py show RUN     print the result of a run
    python3 mobo.py resume RUN   continue an interrupted run, or one with a larger budget
    python3 mobo.py report RUN   create the report of a run again
    python3 mobo.py compare RUN RUN ...   compare runs in one page
    python3 mobo.py logbook RUN  have a command of your own write about a run
    python3 mobo.py export RUN   write the evaluations of a run as a table
    python3 mobo.py rebuild BAG  rebuild a run from its bag
    python3 mobo.py replay RUN   compute every suggestion again, and compare
    python3 mobo.py campaign     optimise a simulation, many at once, in place of a machine

With an active run, or with a tuner that is running permanently: status, watch, pause, continue, step,
skip, stop, cancel, queue NAME=VALUE ..., forget INDEX, unforget INDEX, set NAME=VALUE ...,
points, go INDEX, live.

It only needs Python 3.11, 3.12 or 3.13 on Linux and a C and C++ compiler; everything else is installed
into `.venv` beside this file.
"""

from __future__ import annotations

import contextlib
import os
import signal
import sys
from pathlib import Path

if not (3, 11) <= sys.version_info[:2] <= (3, 13) or sys.platform != "linux":
    sys.exit(
        "mobo.py needs Python 3.11, 3.12 or 3.13 on Linux, for which there are ROS 2 wheels; "
        f"this is Python {sys.version.split()[0]} on {sys.platform}"
    )

if __name__ == "__main__" and signal.getsignal(signal.SIGINT) is signal.default_int_handler:
    signal.signal(signal.SIGINT, signal.SIG_DFL)  # a Ctrl-C during the imports prints no traceback

from launcher import campaign, run, steering, verbs
from launcher.command_line import LIVE, STEERING, make_parser
from launcher.errors import LauncherError
from launcher.processes import Interrupted

ROOT = Path(__file__).resolve().parent
VERBS = {
    "run": run.run,
    "check": verbs.check,
    "new": verbs.new,
    "layout": verbs.layout,
    "list": verbs.list_runs,
    "show": verbs.show,
    "resume": run.resume,
    "report": verbs.report,
    "compare": verbs.compare,
    "logbook": verbs.logbook,
    "export": verbs.export,
    "rebuild": verbs.rebuild,
    "replay": verbs.replay,
    "campaign": campaign.campaign,
}


def open_streams() -> None:
    """Give this process and its children the standard streams that were closed, to and from nowhere."""
    while (number := os.open(os.devnull, os.O_RDWR)) < 3:
        os.set_inheritable(number, True)
    os.close(number)
    sys.stdout = sys.stdout or open(1, "w", closefd=False)  # noqa: SIM115
    sys.stderr = sys.stderr or open(2, "w", closefd=False)  # noqa: SIM115


def main(arguments: list[str]) -> int:
    """Carry out the command line; return the exit status."""
    try:
        if arguments[:1] == ["test"]:
            return verbs.test(ROOT, arguments[1:])
        if arguments and arguments[0] in (*STEERING, LIVE):
            steering.steer(ROOT, arguments)
        options = make_parser(__doc__ or "", ROOT, VERBS).parse_args(arguments)
        options.act(options)
    except (LauncherError, Interrupted) as error:
        return complain(error, error.exit_status)
    except BrokenPipeError:  # the reader of the output has closed it
        return 1
    except OSError as error:
        where = f"'{error.filename}': " if error.filename else ""
        return complain(f"{where}{error.strerror or error}", 1)
    except KeyboardInterrupt:
        return complain("stopped by SIGINT", 128 + signal.SIGINT)
    return 0


def complain(what: object, exit_status: int = 1) -> int:
    """Print an error; return the exit status."""
    with contextlib.suppress(OSError):  # the terminal may be gone
        print(f"mobo.py: {what}", file=sys.stderr, flush=True)
    return exit_status


if __name__ == "__main__":
    if signal.getsignal(signal.SIGINT) == signal.SIG_DFL:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    open_streams()
    status = main(sys.argv[1:])
    try:
        sys.stdout.flush()
    except OSError:  # the reader of the output is gone; only the status can tell
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        status = status or 1
    sys.exit(status)
