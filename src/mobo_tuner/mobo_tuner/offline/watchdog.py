"""Ends the simulations of a campaign if the campaign itself was killed.

The campaign writes `+GROUP` to this program's standard input when it starts a simulation, by its process
group, and `-GROUP` when that has ended. Only the campaign has the other end, which the kernel closes when
it ends in any way; the groups that are left are then ended. It is started without the project's packages.
"""

from __future__ import annotations

import os
import signal
import sys
import time

GRACE = 2.0  # [s] for a simulation to end by itself when it is asked to
_POLL = 0.02  # [s] between two looks whether it has


def send(group: int, number: signal.Signals) -> bool:
    """Send a signal to a process group, and return whether there is one."""
    try:
        os.killpg(group, number)
    except OSError:
        return False
    return True


def main() -> None:
    """Keep the groups until the end of standard input, then end those that are left."""
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)
    groups: set[int] = set()
    for line in sys.stdin:
        if line.endswith("\n"):  # else it was being written when the campaign was killed
            group = int(line[1:])
            (groups.add if line[0] == "+" else groups.discard)(group)
    groups = {group for group in groups if send(group, signal.SIGTERM)}
    deadline = time.monotonic() + GRACE
    while groups and time.monotonic() < deadline:
        time.sleep(_POLL)  # between two looks, until the deadline
        groups = {group for group in groups if send(group, signal.Signals(0))}
    for group in groups:
        send(group, signal.SIGKILL)


if __name__ == "__main__":
    main()
