"""A simulation as a command: one process for each point, killed when it takes too long."""

from __future__ import annotations

import contextlib
import json
import math
import os
import shlex
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

from mobo_tuner.errors import ParameterError
from mobo_tuner.offline.watchdog import GRACE, send

_MOST_OUTPUT = 1 << 20  # bytes of the standard output that are read
_PATIENCE = 10.0  # [s] for the watchdog to end
_POLL = 0.02  # [s] between two looks whether a simulation has ended


class Outcome(NamedTuple):
    """What came of one simulation.

    Attributes:
        outputs: Numbers by name, NaN where there is none; empty after an error.
        seconds: Wall time [s].
        error: One sentence; empty if it succeeded.
    """

    outputs: Mapping[str, float]
    seconds: float
    error: str


@dataclass
class Simulation:
    """A command that reads a point as one JSON object and prints its outputs as another.

    The point is one line on standard input; the outputs are the last line of standard output, with null for
    a number that there is none of. Each process runs in a folder of its own, where its files stay. All
    processes end with this one, even if it is killed (`watchdog`); `stop` ends the watchdog. One that must
    end is asked first (SIGTERM) and killed after `watchdog.GRACE`, since the starters of MPI and of batch
    systems end their processes, which are in sessions of their own or on other hosts, only when asked.

    Attributes:
        command: Program and arguments; a `python` is that of this environment.
        timeout: Longest time of one simulation [s]; it is ended then, with all its processes.
        folder: Folder in which the folders of the simulations are made.
    """

    command: str
    timeout: float
    folder: Path
    _running: set[int] = field(default_factory=set)
    _lock: threading.Lock = field(default_factory=threading.Lock)
    _stopped: bool = False
    _watchdog: subprocess.Popen[str] | None = None

    def __post_init__(self) -> None:
        """Check the command.

        Raises:
            ParameterError: If it is empty, or there is no such program.
        """
        try:
            words = shlex.split(self.command)
        except ValueError as error:
            raise ParameterError(f"campaign.command is {self.command!r:.80}: {error}") from None
        if not words or shutil.which(words[0], path=_search_path()) is None:
            raise ParameterError(
                f"campaign.command is {self.command!r:.80}; it must begin with a program that exists"
            )

    def run(self, number: int, point: Mapping[str, float]) -> Outcome:
        """Simulate a point; whatever goes wrong is said in the outcome.

        Args:
            number: Number of the simulation, the name of its folder.
            point: Every variable, in its unit.
        """
        started = time.monotonic()
        folder = self.folder / f"{number:06d}"
        try:
            folder.mkdir(parents=True, exist_ok=True)
            text = self._output(folder, json.dumps(dict(point)))
            outputs, error = _read(text), ""
        except (OSError, ValueError) as trouble:
            outputs, error = {}, str(trouble)
        return Outcome(outputs, time.monotonic() - started, error)

    def stop(self) -> None:
        """End all that run, and start none any more."""
        with self._lock:
            self._stopped = True
            for group in self._running:
                send(group, signal.SIGTERM)
        deadline = time.monotonic() + GRACE
        while self._running and time.monotonic() < deadline:
            time.sleep(_POLL)  # between two looks, until the deadline
        with self._lock:
            for group in self._running:
                send(group, signal.SIGKILL)
            if self._watchdog is not None:
                try:
                    self._watchdog.communicate(timeout=_PATIENCE)  # which closes its standard input
                except subprocess.TimeoutExpired:
                    self._watchdog.kill()
                    self._watchdog.communicate()
                self._watchdog = None

    def _watch(self, sign: str, group: int) -> None:
        """Tell the watchdog of a process group that starts or has ended; the lock is held."""
        if self._watchdog is None:
            if self._stopped:
                return
            self._watchdog = subprocess.Popen(
                [sys.executable, "-I", "-S", str(Path(__file__).with_name("watchdog.py"))],
                stdin=subprocess.PIPE,
                stdout=subprocess.DEVNULL,
                start_new_session=True,
                text=True,
            )
        assert self._watchdog.stdin is not None
        with contextlib.suppress(OSError):  # it was killed
            self._watchdog.stdin.write(f"{sign}{group}\n")
            self._watchdog.stdin.flush()

    def _output(self, folder: Path, text: str) -> str:
        """Return what the command prints.

        Raises:
            OSError, ValueError: If it cannot be started, fails or takes too long.
        """
        with (folder / "output").open("wb") as output, (folder / "errors").open("wb") as errors:
            with self._lock:
                if self._stopped:
                    raise ValueError("the campaign was stopped")
                process = subprocess.Popen(
                    shlex.split(self.command),
                    stdin=subprocess.PIPE,
                    stdout=output,
                    stderr=errors,
                    cwd=folder,
                    env={**os.environ, "PATH": _search_path()},
                    start_new_session=True,
                )
                self._running.add(process.pid)
                self._watch("+", process.pid)  # before the point is known to the process
            try:
                # A whole line, since the starter of Open MPI keeps the end of its input to itself.
                process.communicate(f"{text}\n".encode(), timeout=self.timeout)
            except subprocess.TimeoutExpired:
                send(process.pid, signal.SIGTERM)
                with contextlib.suppress(subprocess.TimeoutExpired):
                    process.wait(GRACE)
                raise ValueError(f"the simulation took more than {self.timeout:g} s") from None
            finally:
                with self._lock:
                    self._running.discard(process.pid)
                send(process.pid, signal.SIGKILL)  # to its children, too
                process.wait()
                with self._lock:
                    self._watch("-", process.pid)
        if process.returncode != 0:
            words = (folder / "errors").read_text(errors="replace").strip().splitlines()
            reason = words[-1][:300] if words else f"ended with status {process.returncode}"
            raise ValueError(f"the simulation failed: {reason}")
        return (folder / "output").read_bytes()[-_MOST_OUTPUT:].decode(errors="replace")


def command_of(campaign: Mapping[str, Any], folder: Path) -> str:
    """Return the command of a campaign, in which files have their whole names; empty if there is none.

    Args:
        campaign: Section of the parameter file.
        folder: Folder of the parameter file, in which files are looked for.

    Raises:
        ParameterError: If both a command and a function are given, or one names a Python file that does not exist.
    """
    command, function = str(campaign["command"]), str(campaign["function"])
    if command and function:
        raise ParameterError(
            "campaign.command and campaign.function are both given; one of them is allowed"
        )
    if function:
        place, colon, name = function.rpartition(":")
        if not (place and colon and name.isidentifier()):
            raise ParameterError(
                f"campaign.function is {function!r:.80}; FILE.py:FUNCTION and PACKAGE:FUNCTION are allowed"
            )
        if place.endswith(".py"):
            place = _whole_name(place, folder, f"campaign.function is {function!r:.80}")
        return shlex.join(("python", "-m", "mobo_tuner.offline.function", f"{place}:{name}"))
    try:
        words = shlex.split(command)
    except ValueError as error:
        raise ParameterError(f"campaign.command is {command!r:.80}: {error}") from None
    if len(words) > 1 and Path(words[0]).name.startswith("python") and words[1].endswith(".py"):
        words[1] = _whole_name(words[1], folder, f"campaign.command is {command!r:.80}")
    return shlex.join(_located(word, folder) for word in words)


def _whole_name(name: str, folder: Path, what: str) -> str:
    """Return the whole name of a Python file.

    Raises:
        ParameterError: If there is no such file.
    """
    if not (folder / name).is_file():
        raise ParameterError(f"{what}, and there is no file '{name}' in '{folder.resolve()}'")
    return str((folder / name).resolve())


def _located(word: str, folder: Path) -> str:
    """Return a word of a command, such as `deck.in` or `--deck=deck.in`; a file of the folder in its whole name."""
    start, equals, name = word.rpartition("=")
    is_name = "." in name or "/" in name  # else it may be any other word
    return (
        f"{start}{equals}{(folder / name).resolve()}"
        if is_name and (folder / name).is_file()
        else word
    )


def _search_path() -> str:
    """Return the PATH on which `python` is that of this environment."""
    return os.pathsep.join([str(Path(sys.executable).parent), os.environ.get("PATH", os.defpath)])


def _read(text: str) -> dict[str, float]:
    """Return the numbers in the last line of an output.

    Raises:
        ValueError: If it is not a JSON object of numbers.
    """
    lines = text.strip().splitlines()
    try:
        content = json.loads(lines[-1]) if lines else None
    except (ValueError, RecursionError):
        content = None
    if not isinstance(content, dict):
        raise ValueError("the simulation printed no JSON object in its last line")
    for name, value in content.items():
        if value is not None and (isinstance(value, bool) or not isinstance(value, int | float)):
            raise ValueError(f"the simulation printed {value!r:.40} for '{name}', not a number")
        if isinstance(value, int) and abs(value) > sys.float_info.max:
            raise ValueError(
                f"the simulation printed {value!r:.40} for '{name}', which is too large"
            )
    return {name: math.nan if v is None else float(v) for name, v in content.items()}
