"""The processes of one run: their start, supervision and the order of their end."""

from __future__ import annotations

import contextlib
import signal
import subprocess
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from launcher.processes import Interrupted, Processes, describe_status
from launcher.run_folder import JOURNAL_FILE

EXIT_LIMIT = 5.0  # [s] from a signal to the end of everything
_FAREWELL = 5.0  # [s] for the others to end after a node has died
_STOP_PATIENCE = 4.0  # [s] for a node to end on request; a hanging one prints its stack after 3.5 s
_HURRIED_PATIENCE = 1.3  # [s] the same after a signal, once for each of the three steps
_REPORT_TIMEOUT = 120.0  # [s]
_RESERVE = 0.4  # [s] of EXIT_LIMIT kept for this script's own end
_UNHANDLED_SIGINT = (-signal.SIGINT, 128 + signal.SIGINT)  # statuses after a request to stop
_CANCELED = 130  # status of the foreground after a canceled run
_LOG_TAIL = 5  # lines shown of the log of a node that died
_MAX_RESTARTS = 3  # of programs on which the run does not depend
_SENTENCE_LIMIT = 500  # characters of another program's last words that are repeated


@dataclass(frozen=True)
class Conclusion:
    """The conclusion of a run.

    Attributes:
        state: State of the run in `run.json`: 'finished', 'failed', 'canceled' or 'interrupted'.
        reason: Reason in one sentence; what went wrong on the way if the run finished, else empty.
        exit_status: Exit status of the entry script.
        details: Lines that help to find the cause.
    """

    state: str
    reason: str = ""
    exit_status: int = 0
    details: tuple[str, ...] = ()


@dataclass(frozen=True)
class Command:
    """A program to start.

    Attributes:
        words: Command line.
        folder: Working folder of its process.
        stdin: File descriptor of its standard input.
        environment: Further environment variables, of this program alone.
    """

    words: Sequence[str]
    folder: Path
    stdin: int = subprocess.DEVNULL
    environment: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class Launch:
    """The programs of a run.

    Attributes:
        commands: Command of each program, by the program's name.
        foreground: Name of the program with the user interface; the run ends when it ends.
        last: Name of the program that is stopped after all others, since it records them.
        environment: Environment variables of all programs.
        folder: Folder of the run; logs go to its `log`.
        goes_back: Whether the machine is moved after a cancel.
        onlookers: Names of the programs on which the run does not depend, whatever happens to them.
    """

    commands: Mapping[str, Command]
    foreground: str
    last: str
    environment: Mapping[str, str]
    folder: Path
    goes_back: bool = False
    onlookers: Sequence[str] = ()

    @property
    def has_begun(self) -> bool:
        """Whether the run has begun: it has a journal."""
        return (self.folder / JOURNAL_FILE).is_file()

    def log(self, name: str) -> Path:
        """Return the file that gets what a program prints."""
        return self.folder / "log" / f"{name}.log"


class Supervisor:
    """Starts the programs of a run, supervises them and stops them in order."""

    def __init__(self, processes: Processes, launch: Launch) -> None:
        self._processes = processes
        self._launch = launch
        self._running: dict[str, subprocess.Popen[bytes]] = {}
        self._deadline = float("inf")  # for the end of all programs after a signal
        self._loss = ""  # how the recorder was lost during the run
        self._restarts = 0  # of programs on which the run does not depend

    def run(self) -> Conclusion:
        """Carry out the run; every program has ended when this returns.

        Raises:
            OSError: If a program cannot be started.
        """
        try:
            self._start()
            conclusion = self._watch()
        except Interrupted as interruption:
            conclusion = self._interrupt(interruption)
        foreground, last = self._launch.foreground, self._launch.last
        nodes = [name for name in self._running if name not in (foreground, last)]
        for names in ([foreground], nodes, [last]):
            try:
                self._stop(names)
            except Interrupted as interruption:  # raised once, so the second try is not interrupted
                conclusion = self._hurry(interruption)
                self._stop(names)
        if conclusion.state != "finished":
            return conclusion
        conclusion = self._judge()
        return conclusion if conclusion.reason else Conclusion("finished", self._loss)

    def report(self, command: Sequence[str]) -> str:
        """Run the program that creates the report.

        Returns:
            One sentence if it failed, else nothing.

        Raises:
            Interrupted: If a signal arrived.
        """
        timeout = min(_REPORT_TIMEOUT, self._deadline - time.monotonic() - _RESERVE)
        if timeout <= 0.0:
            return "there was no time left for the report"
        try:
            log = self._launch.log("report").open("wb")
        except OSError as error:
            return f"the report cannot be written: {error.strerror}"
        with log:
            process = self._processes.start(
                command,
                environment=self._launch.environment,
                cwd=self._launch.folder,
                stderr=log,
            )
            status = self._processes.wait(process, timeout)
        if status is None:
            self._processes.stop([process], patience=0.0)
            return "the report was not finished in time"
        return "" if status == 0 else f"the report failed: {self._last_words('report', status)}"

    def _start(self) -> None:
        for name in self._launch.commands:
            self._start_program(name, "wb")

    def _revive(self) -> None:
        """Start a dead program on which the run does not depend again, but not for ever."""
        for name in self._launch.onlookers:
            process = self._running.get(name)
            if process is None or process.poll() is None or self._restarts >= _MAX_RESTARTS:
                continue
            self._restarts += 1
            self._start_program(name, "ab")

    def _start_program(self, name: str, mode: str) -> None:
        command = self._launch.commands[name]
        in_foreground = name == self._launch.foreground
        with self._launch.log(name).open(mode) as log:
            self._running[name] = self._processes.start(
                command.words,
                environment={**self._launch.environment, **command.environment},
                cwd=command.folder,
                stdin=command.stdin,
                stdout=None if in_foreground else log,
                stderr=log,
            )

    def _watch(self) -> Conclusion:
        """Wait until the foreground ends, or a node dies and the foreground has had time to end.

        The run continues without the recorder: it has its journal, and the tuner tells of the loss.
        """
        foreground = self._running[self._launch.foreground]

        def over() -> bool:
            self._revive()
            return foreground.poll() is not None or self._dead_node() is not None

        self._processes.wait_until(over, float("inf"))
        dead = self._dead_node()
        if dead is not None:
            self._processes.wait(foreground, _FAREWELL)
            how = describe_status(self._running[dead].returncode)
            return self._failure(f"the {dead} node {how}", dead)
        if foreground.returncode == _CANCELED:
            return Conclusion("canceled", "the run was canceled by another client", _CANCELED)
        if foreground.returncode != 0:
            words = self._last_words(self._launch.foreground, foreground.returncode)
            return Conclusion("failed", f"the run failed: {words}", 1)
        return Conclusion("finished")

    def _interrupt(self, interruption: Interrupted) -> Conclusion:
        """Handle the first signal: the machine may move to its fallback, until a second signal."""
        foreground = self._running.get(self._launch.foreground)
        if self._launch.goes_back and foreground:
            try:
                self._processes.interrupt(foreground)
                self._processes.heed_next_signal()
                self._processes.wait(foreground, float("inf"))
            except Interrupted as another:
                self._processes.interrupt(foreground, again=True)
                interruption = another
        return self._hurry(interruption)

    def _hurry(self, interruption: Interrupted) -> Conclusion:
        """Stop all programs within `EXIT_LIMIT`."""
        self._deadline = time.monotonic() + EXIT_LIMIT
        return interrupted(interruption)

    def _stop(self, names: Sequence[str]) -> None:
        hurried = self._deadline < float("inf")
        self._processes.stop(
            [self._running[name] for name in names if name in self._running],
            _HURRIED_PATIENCE if hurried else _STOP_PATIENCE,
        )

    def _judge(self) -> Conclusion:
        """Return the conclusion of a successful run, unless a node failed at its end.

        The run does not depend on its recorder, at its end neither.
        """
        for name, process in self._running.items():
            if name in self._launch.onlookers:
                continue
            unhandled = name != self._launch.last and process.returncode in _UNHANDLED_SIGINT
            if process.returncode == 0 or unhandled:
                continue
            what = f"the {name} node {describe_status(process.returncode)} when the run was over"
            if name != self._launch.last:
                return self._failure(what, name)
            self._loss = self._loss or f"{what}: its bag may lack the end"
        return Conclusion("finished")

    def _failure(self, what: str, name: str) -> Conclusion:
        log = self._launch.log(name)
        tail = [f"    {line}" for line in _lines(log)[-_LOG_TAIL:]]
        details = (f"    the end of {log}:", *tail) if tail else ()
        return Conclusion("failed", f"the run failed: {what}", 1, details)

    def _dead_node(self) -> str | None:
        """Return the first dead node without which the run cannot continue, if there is one."""
        independent = (self._launch.foreground, *self._launch.onlookers)
        for name, process in self._running.items():
            if name in independent or process.poll() is None:
                continue
            if name != self._launch.last or not self._launch.has_begun:
                return name
            if not self._loss:
                how = describe_status(process.returncode)
                self._loss = f"the {name} node {how} during the run: its bag ends there"
        return None

    def _last_words(self, name: str, status: int) -> str:
        """Return the last line of a program's log, which describes its failure."""
        lines = _lines(self._launch.log(name))
        return lines[-1][:_SENTENCE_LIMIT] if lines else f"the {name} {describe_status(status)}"


def interrupted(interruption: Interrupted) -> Conclusion:
    """Return the conclusion of a run that was interrupted by a signal."""
    return Conclusion("interrupted", f"the run was {interruption}", interruption.exit_status)


def _lines(log: Path) -> list[str]:
    """Return the lines of a log that are not empty; none if there is no log."""
    with contextlib.suppress(OSError):
        text = log.read_text(errors="replace")
        return [line for line in text.splitlines() if line.strip()]
    return []
