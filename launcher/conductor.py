"""One tuning run's processes: what is started, what is watched, and in which order it ends."""

from __future__ import annotations

import contextlib
import subprocess
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from launcher.processes import Interrupted, Processes, describe_status

EXIT_LIMIT = 5.0  # [s] from a signal to the end of everything
_FAREWELL = 5.0  # [s] for the others to finish of themselves after a node has died
_STOP_PATIENCE = 4.0  # [s] for a node to end when asked to; one that hangs says where after 3.5 s
_HURRIED_PATIENCE = 1.3  # [s] the same after a signal, once for each of the three steps
_REPORT_TIMEOUT = 120.0  # [s]
_RESERVE = 0.4  # [s] of EXIT_LIMIT kept for this script's own end
_LOG_TAIL = 5  # lines shown of the log of a node that died
_SENTENCE_LIMIT = 500  # characters of another program's last words that are repeated


@dataclass(frozen=True)
class Program:
    """A program of a run.

    Attributes:
        name: of the program and its log file.
        module: Python module that is run.
        node: name of its ROS node.
        parameters: ROS parameters it is given over those of the configuration.
    """

    name: str
    module: str
    node: str
    parameters: tuple[str, ...] = ()

    def command(self, python: Path, config: Path, values: Mapping[str, object]) -> list[str]:
        """The command line; parameters without a value are left to the configuration.

        They are given to the node by name: without, they would yield to the file's section of that
        name.
        """
        given = [
            argument
            for name in self.parameters
            if (value := values.get(name)) is not None
            for argument in ("-p", f"{self.node}:{name}:={_as_yaml(value)}")
        ]
        ros = ["--ros-args", "--params-file", str(config), *given]
        return [str(python), "-P", "-m", self.module, *ros]


MACHINE = Program("machine", "awa_sim_node.node", "awa_sim", ("seed", "speed"))
TUNER = Program("tuner", "mobo_tuner.nodes.tuner", "tuner", ("seed", "runs_dir"))
RECORDER = Program("recorder", "mobo_tuner.nodes.recorder", "recorder", ("bag_path",))
CONSOLE = Program(
    "console", "mobo_tuner.nodes.console", "console", ("run_id", "evaluations", "resume_from")
)


@dataclass(frozen=True)
class Ending:
    """How a run ended.

    Attributes:
        state: as in `run.json`: 'finished', 'failed' or 'interrupted'.
        reason: one sentence that says why, unless it finished.
        exit_status: of the entry script.
        details: lines that help to find the cause.
    """

    state: str
    reason: str = ""
    exit_status: int = 0
    details: tuple[str, ...] = ()


@dataclass(frozen=True)
class Launch:
    """What is started for a run.

    Attributes:
        commands: command line of every program, by name.
        foreground: name of the one that talks to the user; the run lasts as long as it does.
        last: name of the one that is stopped after all others, since it records them.
        environment: environment variables of all.
        folder: of the run; logs go to its `log`.
    """

    commands: Mapping[str, Sequence[str]]
    foreground: str
    last: str
    environment: Mapping[str, str]
    folder: Path

    def log(self, name: str) -> Path:
        """Where what a program prints goes."""
        return self.folder / "log" / f"{name}.log"


class Conductor:
    """Starts the programs of a run, watches over them and stops them in order."""

    def __init__(self, processes: Processes, launch: Launch) -> None:
        self._processes = processes
        self._launch = launch
        self._running: dict[str, subprocess.Popen[bytes]] = {}
        self._deadline = float("inf")  # of everything, once a signal came

    def run(self) -> Ending:
        """Run to the end, whatever it is; every program has ended when this returns.

        Raises:
            OSError: a program cannot be started.
        """
        try:
            self._start()
            ending = self._watch()
        except Interrupted as interruption:
            ending = self._hurry(interruption)
        foreground, last = self._launch.foreground, self._launch.last
        nodes = [name for name in self._running if name not in (foreground, last)]
        for names in ([foreground], nodes, [last]):
            try:
                self._stop(names)
            except Interrupted as interruption:  # comes once, so that the second try is left alone
                ending = self._hurry(interruption)
                self._stop(names)
        return self._judge() if ending.state == "finished" else ending

    def report(self, command: Sequence[str]) -> str:
        """Run the program that makes the report.

        Returns:
            One sentence if it failed, else nothing.

        Raises:
            Interrupted: a signal came.
        """
        timeout = min(_REPORT_TIMEOUT, self._deadline - time.monotonic() - _RESERVE)
        if timeout <= 0.0:
            return "there was no time left for the report"
        with self._launch.log("report").open("wb") as log:
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
        for name, command in self._launch.commands.items():
            in_foreground = name == self._launch.foreground
            with self._launch.log(name).open("wb") as log:
                self._running[name] = self._processes.start(
                    command,
                    environment=self._launch.environment,
                    cwd=self._launch.folder,
                    stdout=None if in_foreground else log,
                    stderr=log,
                )

    def _watch(self) -> Ending:
        """Wait until the foreground ends, or a node dies and the foreground has had its chance."""
        foreground = self._running[self._launch.foreground]
        self._processes.wait_until(
            lambda: foreground.poll() is not None or self._dead_node() is not None, float("inf")
        )
        dead = self._dead_node()
        if dead is not None:
            self._processes.wait(foreground, _FAREWELL)
            how = describe_status(self._running[dead].returncode)
            return self._failure(f"the {dead} node {how}", dead)
        if foreground.returncode != 0:
            words = self._last_words(self._launch.foreground, foreground.returncode)
            return Ending("failed", f"the run failed: {words}", 1)
        return Ending("finished")

    def _hurry(self, interruption: Interrupted) -> Ending:
        """From here on there is little time."""
        self._deadline = time.monotonic() + EXIT_LIMIT
        return interrupted(interruption)

    def _stop(self, names: Sequence[str]) -> None:
        hurried = self._deadline < float("inf")
        self._processes.stop(
            [self._running[name] for name in names if name in self._running],
            _HURRIED_PATIENCE if hurried else _STOP_PATIENCE,
        )

    def _judge(self) -> Ending:
        """The ending of a run that went well, unless a node did not end well."""
        for name, process in self._running.items():
            if process.returncode != 0:
                how = describe_status(process.returncode)
                return self._failure(f"the {name} node {how} when the run was over", name)
        return Ending("finished")

    def _failure(self, what: str, name: str) -> Ending:
        log = self._launch.log(name)
        tail = [f"    {line}" for line in _lines(log)[-_LOG_TAIL:]]
        details = (f"    the end of {log}:", *tail) if tail else ()
        return Ending("failed", f"the run failed: {what}", 1, details)

    def _dead_node(self) -> str | None:
        """The first node found dead, if any."""
        for name, process in self._running.items():
            if name != self._launch.foreground and process.poll() is not None:
                return name
        return None

    def _last_words(self, name: str, status: int) -> str:
        """The last line of a program's log, which by custom says why it failed."""
        lines = _lines(self._launch.log(name))
        return lines[-1][:_SENTENCE_LIMIT] if lines else f"the {name} {describe_status(status)}"


def interrupted(interruption: Interrupted) -> Ending:
    """The ending of a run that a signal cut short."""
    return Ending("interrupted", f"the run was {interruption}", interruption.exit_status)


def _lines(log: Path) -> list[str]:
    """The lines of a log that say anything; none if there is no log."""
    with contextlib.suppress(OSError):
        text = log.read_text(errors="replace")
        return [line for line in text.splitlines() if line.strip()]
    return []


def _as_yaml(value: object) -> str:
    """A parameter's value as `-p name:=` takes it; text is quoted lest it pass for a number."""
    if isinstance(value, str | Path):
        return "'" + str(value).replace("'", "''") + "'"
    return repr(value)
