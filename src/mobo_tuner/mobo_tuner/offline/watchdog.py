"""Kills the simulations of a campaign if the campaign itself was killed.

The campaign writes `+GROUP` to this program's standard input when it starts a simulation, by its process
group, and `-GROUP` when that has ended. Only the campaign has the other end, which the kernel closes when
it ends in any way; the groups that are left are then killed. It is started without the project's packages.
"""

from __future__ import annotations

import contextlib
import os
import signal
import sys


def main() -> None:
    """Keep the groups until the end of standard input, then kill those that are left."""
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)
    groups: set[int] = set()
    for line in sys.stdin:
        if line.endswith("\n"):  # else it was being written when the campaign was killed
            group = int(line[1:])
            (groups.add if line[0] == "+" else groups.discard)(group)
    for group in groups:
        with contextlib.suppress(OSError):  # it has ended in between
            os.killpg(group, signal.SIGKILL)


if __name__ == "__main__":
    main()
