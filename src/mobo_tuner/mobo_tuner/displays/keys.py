"""Keys of a terminal that steer the run which is shown in it."""

from __future__ import annotations

import contextlib
import os
import select
import sys
import termios
import threading
import tty
from collections.abc import Callable, Iterator

from mobo_tuner.client import TunerClient, TunerError

HELP = "keys: p pause or continue, s step, k skip, x stop"
_PATIENCE = 2.0  # [s] for a key that was pressed last
POLL_PERIOD = 0.2  # [s] between two looks whether the view is closed
CONFIRM = "y"


class Keys:
    """What each key does; `x` asks first.

    Args:
        client: Client of the tuner.
        say: Function that shows a sentence.
    """

    def __init__(self, client: TunerClient, say: Callable[[str], object]) -> None:
        self._client = client
        self._say = say
        self._asked = False  # whether the next key may confirm a stop

    def press(self, key: str) -> None:
        """Do what a key means, and show the tuner's answer; other keys do nothing."""
        asked, self._asked = self._asked, False
        if asked:
            if key == CONFIRM:
                self._ask(self._client.stop)
            else:
                self._say(f"the run is not stopped; {HELP}")
        elif key == "p":
            paused = self._client.status().state == "paused"
            self._ask(self._client.resume if paused else self._client.pause)
        elif key == "s":
            self._ask(self._client.step)
        elif key == "k":
            self._ask(self._client.skip)
        elif key == "x":
            self._asked = True
            self._say(f"stop the run after this evaluation? press {CONFIRM} to stop it")

    def _ask(self, request: Callable[[], str]) -> None:
        try:
            self._say(request())
        except TunerError as error:
            self._say(str(error))


@contextlib.contextmanager
def reading_keys(press: Callable[[str], object], terminal: int | None = None) -> Iterator[bool]:
    """Read keys one by one until the end of the block; then the terminal is as it was.

    Ctrl-C stays what it is.

    Args:
        press: Function that takes each key, on a thread of its own.
        terminal: File descriptor of the terminal; None for standard input.

    Yields:
        Whether there is a terminal to read from.
    """
    descriptor = sys.stdin.fileno() if terminal is None else terminal
    if not os.isatty(descriptor):
        yield False
        return
    before = termios.tcgetattr(descriptor)
    closed = threading.Event()

    def read() -> None:
        while not closed.is_set():
            try:
                key = os.read(descriptor, 1) if _is_readable(descriptor) else None
            except OSError:
                key = b""
            if key == b"":  # the terminal is gone
                return
            if key is not None:
                press(key.decode(errors="replace"))

    reader = threading.Thread(target=read, name="keys", daemon=True)
    try:
        tty.setcbreak(descriptor)
        reader.start()
        yield True
    finally:
        closed.set()
        if reader.is_alive():
            reader.join(_PATIENCE)
        with contextlib.suppress(termios.error):  # the terminal is gone
            termios.tcsetattr(descriptor, termios.TCSADRAIN, before)


def _is_readable(descriptor: int) -> bool:
    """Return whether there is something to read within a moment."""
    return bool(select.select([descriptor], [], [], POLL_PERIOD)[0])
