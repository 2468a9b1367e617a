"""Ctrl-C while a program still imports its modules, which takes a second."""

from __future__ import annotations

import os
import signal
import sys
from collections.abc import Collection
from pathlib import Path
from types import FrameType


def end_quietly(scripts: Collection[str]) -> None:
    """Let SIGINT end this process with status 130 and without a traceback, until its program handles it.

    To be called by the package of a program before anything else is imported. It does nothing in a process that
    only imports the package's modules, or that ignores or handles SIGINT already.

    Args:
        scripts: File names of the scripts that start a program of the package; `python -m` starts one, too.
    """
    # It is "-m" while Python locates the module of `-m`.
    started = Path(sys.argv[0]).name if sys.argv else ""
    if started not in ("-m", *scripts):
        return
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, _end)
    # `mobo.py` blocks it while Python starts.
    signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})


def _end(number: int, _frame: FrameType | None) -> None:
    os._exit(128 + number)
