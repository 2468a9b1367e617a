"""Ends the processes that `mobo.py` started if `mobo.py` itself was killed.

Every process that the entry script starts has a marker in its environment, which its children inherit.
This program waits, in a session of its own, until its standard input closes: only `mobo.py` has the
other end, which the kernel closes when `mobo.py` ends in any way. Processes that still have the marker
are then asked to stop (SIGTERM) and finally killed.

`python watchdog.py MARK`
"""

from __future__ import annotations

import contextlib
import os
import signal
import sys
import time

MARKER = "MOBO_PROCESS_MARK"  # environment variable
PATIENCE = 4.0  # [s] between SIGTERM and SIGKILL
_POLL_PERIOD = 0.05  # [s]
_KILL_TIMEOUT = 5.0  # [s] for the kernel to remove killed processes


def marked_processes(mark: str) -> list[int]:
    """Return the ids of the living processes with the mark, other than this one."""
    needle = f"{MARKER}={mark}".encode()
    found = []
    for name in os.listdir("/proc"):
        if not name.isdigit() or int(name) == os.getpid():
            continue
        try:
            with open(f"/proc/{name}/environ", "rb") as file:
                if needle in file.read().split(b"\0"):  # a zombie's reads as empty
                    found.append(int(name))
        except OSError:
            continue  # it has ended, or is someone else's
    return found


def end_marked_processes(mark: str, patience: float = PATIENCE) -> None:
    """Ask the marked processes to stop, and kill those that still run after `patience` seconds."""
    asked: set[int] = set()
    kill_at = time.monotonic() + patience
    give_up_at = kill_at + _KILL_TIMEOUT
    while (alive := marked_processes(mark)) and time.monotonic() < give_up_at:
        killing = time.monotonic() >= kill_at
        for process in alive:
            if killing or process not in asked:
                _send(process, signal.SIGKILL if killing else signal.SIGTERM)
                asked.add(process)
        time.sleep(_POLL_PERIOD)  # between two looks, until the deadline


def _send(process: int, number: signal.Signals) -> None:
    with contextlib.suppress(OSError):  # it has ended in between
        os.kill(process, number)


def main() -> None:
    """Wait for the end of standard input, then clean up."""
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)
    while os.read(0, 4096):
        pass
    end_marked_processes(sys.argv[1])


if __name__ == "__main__":
    main()
