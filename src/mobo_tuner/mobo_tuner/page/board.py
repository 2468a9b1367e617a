"""What is known of a tuner, its run and its machine, gathered from the public topics."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

from mobo_tuner.client import Evaluation, Front, Point, Status
from mobo_tuner.client.values import evaluation_of, front_of, problem_of, status_of
from mobo_tuner.core.problem import Problem
from mobo_tuner.displays.evaluations import Flags
from mobo_tuner.displays.progress import RunProgress
from mobo_tuner.ros.conversions import values_of

SILENCE_TIMEOUT = 3.0  # [s] without a status, which is published at 1 Hz, until it counts as old
HEALTH_TIMEOUT = 5.0  # [s] without a message about a part, until it counts as old
SCARCE_SPACE = 1.0  # [GB] left on a disk below which it is a warning, as the tuner says
PATIENCE = 0.4  # [s] of a suggestion in which the page leaves the computer to it
KEPT_RUNS = 2  # runs whose evaluations are kept

Level = Literal["ok", "warning", "error", "stale"]
LEVELS: tuple[Level, ...] = ("ok", "warning", "error", "stale")
"""Levels by the constants of `diagnostic_msgs/DiagnosticStatus`."""


@dataclass
class Motion:
    """The machine's last motion, variables by name.

    Attributes:
        start: Readbacks when it began, as far as known.
        target: Set-point to which the machine is sent.
        readbacks: Readbacks of now, as far as known.
    """

    start: Mapping[str, float] = field(default_factory=dict)
    target: Mapping[str, float] = field(default_factory=dict)
    readbacks: Mapping[str, float] = field(default_factory=dict)

    def fraction(self, name: str) -> float:
        """Return the completed fraction of a variable's way [0..1]; NaN if it is unknown."""
        start, end = self.start.get(name, math.nan), self.target.get(name, math.nan)
        here = self.readbacks.get(name, math.nan)
        if start == end:
            return 1.0
        return min(max((here - start) / (end - start), 0.0), 1.0) + 0.0  # never "-0%"


@dataclass(frozen=True)
class Part:
    """Health of a part of a node, as on `/diagnostics`.

    Attributes:
        name: Name of the node and of the part.
        level: How serious it is.
        message: One sentence.
        values: Further values, by name.
    """

    name: str
    level: Level
    message: str
    values: Mapping[str, str]

    @property
    def disk(self) -> tuple[Level, str] | None:
        """How serious the free space of its disk is, whatever else it says, and a text; None if it tells none."""
        free = self.values.get("free disk space [GB]")
        if free is None:
            return None
        if free in ("", "nan"):
            return self.level if self.level == "stale" else "ok", "not in use yet"
        try:
            level: Level = "warning" if float(free) < SCARCE_SPACE else "ok"
        except ValueError:
            level = "error"
        return "stale" if self.level == "stale" else level, f"{free} GB free"


class RunBoard:
    """What is known of one run.

    Attributes:
        run_id: Id of the run.
        progress: Counts, best values and times.
        evaluations: Evaluations in the order of their arrival.
        problem: Problem of now; None until it is known.
        front: Pareto front of now; None until it is known.
        gained_at: Number of evaluations when the hypervolume last grew.
        changes: Numbers of evaluations when the problem was changed, as far as that was seen.
    """

    def __init__(self, run_id: str) -> None:
        self.run_id = run_id
        self.progress = RunProgress()
        self.evaluations = self.progress.made
        self.problem: Problem | None = None
        self.front: Front | None = None
        self.gained_at = 0
        self.changes: list[int] = []
        self._best_hypervolume = 0.0

    def set_problem(self, problem: Problem) -> None:
        """Take over the problem of now, by which all evaluations so far are judged again."""
        if self.problem not in (None, problem):
            self.changes.append(len(self.evaluations))
            self._best_hypervolume = 0.0  # of another front
        self.problem = problem
        self.progress.set_problem(problem)

    def add(self, evaluation: Evaluation) -> bool:
        """Take over an evaluation; return whether it is new."""
        if self.evaluations.position(evaluation.index) is not None:
            return False
        self.progress.add(evaluation)
        if evaluation.hypervolume > self._best_hypervolume:
            self._best_hypervolume = evaluation.hypervolume
            self.gained_at = len(self.evaluations)
        return True

    def is_on_front(self, index: int | None) -> bool:
        """Return whether an evaluation is on the front."""
        return self.front is not None and any(p.index == index for p in self.front.points)

    def point(self, index: int | None) -> Point | None:
        """Return a point of the front or another feasible evaluation; None if there is none of the index."""
        for point in self.front.points if self.front is not None else ():
            if point.index == index:
                return point
        position = self.evaluations.position(index)
        if position is None:
            return None
        if not self.is_feasible[position]:
            return None
        evaluation = self.evaluations[position]
        stddevs = {name: evaluation.stddev(name) for name in evaluation.objectives}
        return Point(index, evaluation.setpoint, evaluation.objectives, stddevs)

    @property
    def is_feasible(self) -> Flags:
        """Which evaluations are feasible, by the problem as it is now, shape (n,)."""
        return self.progress.is_feasible

    @property
    def without_gain(self) -> int:
        """Number of evaluations since the hypervolume last grew."""
        return len(self.evaluations) - self.gained_at


class Board:
    """Everything that the page shows.

    Attributes:
        status: Status of the tuner.
        motion: Last motion of the machine.
        version: Number of changes of what the plots show.
    """

    def __init__(self) -> None:
        self.status = Status("unknown")
        self.motion = Motion()
        self.version = 0
        self._heard: float | None = None  # time of the last status, by `time.monotonic` [s]
        self._suggesting: float | None = None  # since when the tuner is, likewise
        self._runs: dict[str, RunBoard] = {}
        self._latest = ""  # id of the run that was heard of last
        self._parts: dict[str, tuple[float, Part]] = {}
        self._recorder: tuple[float, Any] | None = None

    # ------------------------------------------------------------------ messages

    def take(self, topic: str, message: Any, heard: float) -> None:
        """Take over a message.

        Args:
            topic: Name of the topic, as in `ros/interfaces.py`.
            message: Message of its type.
            heard: Time of its arrival, by `time.monotonic` [s].
        """
        match topic:
            case "status":
                self._take_status(status_of(message), heard)
            case "problem":
                run = self._run_of(message.run_id)
                run.set_problem(problem_of(message))
                self.version += 1
            case "evaluation":
                self.version += self._run_of(message.run_id).add(evaluation_of(message))
            case "pareto_front":
                run = self._run_of(message.run_id)
                run.front = front_of(message)
                run.progress.set_front(run.front)
                self.version += 1
            case "machine_setpoint":
                self.motion = Motion(
                    start=dict(self.motion.readbacks),
                    target=values_of(message.values),
                    readbacks=self.motion.readbacks,
                )
            case "machine_readbacks":
                self.motion.readbacks = values_of(message.values)
            case "recorder_status":
                self._recorder = (heard, message)
            case "/diagnostics":
                for status in message.status:
                    self._parts[status.name] = (heard, _part_of(status))

    def _take_status(self, status: Status, heard: float) -> None:
        self.status, self._heard = status, heard
        if status.state != "suggesting":
            self._suggesting = None
        elif self._suggesting is None:
            self._suggesting = heard
        if status.run_id:
            self._run_of(status.run_id).progress.set_status(status)
            if status.run_id != self._latest:
                self._latest = status.run_id
                self.version += 1

    def _run_of(self, run_id: str) -> RunBoard:
        if run_id not in self._runs:
            self._runs[run_id] = RunBoard(run_id)
            for old in list(self._runs)[:-KEPT_RUNS]:
                del self._runs[old]
        if not self._latest:
            self._latest = run_id
        return self._runs[run_id]

    # ------------------------------------------------------------------ what is shown

    @property
    def run(self) -> RunBoard | None:
        """The active run, or the last one."""
        return self._runs.get(self._latest)

    @property
    def age(self) -> float:
        """Time since the tuner was heard [s]; infinite if it never was."""
        return math.inf if self._heard is None else time.monotonic() - self._heard

    @property
    def is_stale(self) -> bool:
        """Whether the tuner has been silent for too long."""
        return self.age > SILENCE_TIMEOUT

    @property
    def begins_suggestion(self) -> bool:
        """Whether the tuner has just begun to compute a suggestion, which mostly ends before anybody looks."""
        since = self._suggesting
        return since is not None and time.monotonic() - since < PATIENCE

    @property
    def is_running(self) -> bool:
        """Whether a run is active."""
        status = self.status
        return status.state not in ("idle", "moving", "unknown") and not status.stop_reason

    @property
    def here(self) -> Mapping[str, float]:
        """Where the machine is, as far as known."""
        if self.motion.readbacks:
            return self.motion.readbacks
        run = self.run
        if run is None or not run.evaluations:
            return {}
        last = run.evaluations[-1]
        return {**last.setpoint, **{n: v for n, v in last.readbacks.items() if math.isfinite(v)}}

    def parts(self) -> list[Part]:
        """Return the health of all parts, the recorder's included, by name."""
        now = time.monotonic()
        parts = [
            part if now - heard <= HEALTH_TIMEOUT else _silent(part, now - heard)
            for heard, part in self._parts.values()
        ]
        if self._recorder is not None and not any("recorder" in part.name for part in parts):
            heard, status = self._recorder
            message = "" if status.recording else status.message
            part = Part("recorder", "ok" if status.recording else "error", message, {})
            parts.append(part if now - heard <= HEALTH_TIMEOUT else _silent(part, now - heard))
        return sorted(parts, key=lambda part: part.name)


def _part_of(status: Any) -> Part:
    level = int.from_bytes(status.level, "little")
    return Part(
        name=status.name,
        level=LEVELS[level] if level < len(LEVELS) else "error",
        message=status.message,
        values={item.key: item.value for item in status.values},
    )


def _silent(part: Part, seconds: float) -> Part:
    return Part(part.name, "stale", f"silent for {seconds:.0f} s", part.values)
