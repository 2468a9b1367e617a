"""What must hold in a shift: bounds, answers, one truth in every view, files that can be read."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from mobo_msgs_py import msg
from mobo_msgs_py.action import ApplySetpoint, EvaluateSetpoint, Tune
from mobo_tuner.ros.conversions import values_of
from mobo_tuner.runs.history import History
from mobo_tuner.runs.journal import FILE_NAME, read_journal
from mobo_tuner.runs.replay import restore
from mobo_tuner.tuner.recording import SILENCE

NAMES = ("x1", "x2")
LOSS_TIMEOUT = SILENCE + 5.0  # [s] after which no view says that a dead recorder records


class BrokenPromiseError(AssertionError):
    """Something that must hold did not."""


def require(condition: object, text: str) -> None:
    """Check something that must hold.

    Raises:
        BrokenPromiseError: If it does not.
    """
    if not condition:
        raise BrokenPromiseError(text)


class Watch:
    """The machine's client, with a check of everything that is sent.

    Args:
        client: Client of the machine.
        check: Function that is given each set-point before it is sent.
    """

    def __init__(self, client: Any, check: Callable[[Mapping[str, float]], None]) -> None:
        self._client = client
        self._check = check

    def __getattr__(self, name: str) -> Any:
        return getattr(self._client, name)

    async def evaluate(self, goal: EvaluateSetpoint.Goal, *others: Any) -> Any:
        """Have a set-point evaluated."""
        vias = (goal.if_client_lost_via, goal.if_violated_via)
        for named in (goal.setpoint, goal.if_client_lost, goal.if_violated, *vias):
            self._check(values_of(named))
        return await self._client.evaluate(goal, *others)

    async def apply(self, goal: ApplySetpoint.Goal, *others: Any, **more: Any) -> Any:
        """Have the machine go to a set-point."""
        self._check(values_of(goal.via))
        self._check(values_of(goal.setpoint))
        return await self._client.apply(goal, *others, **more)

    async def send_off(self, goal: ApplySetpoint.Goal, timeout: float) -> Any:
        """Have the machine go to a set-point by itself."""
        self._check(values_of(goal.via))
        self._check(values_of(goal.setpoint))
        return await self._client.send_off(goal, timeout)


class ShiftModel:
    """What is known of a shift, and what follows from it for every motion, status, result and file.

    Args:
        runs_dir: Folder of the runs.

    Attributes:
        bounds: Bounds of the variables as they were set last.
        asked_bounds: Bounds that were asked for and not answered yet.
        crossing: Where an operator sends the machine anyway.
        status: Last status of the tuner.
        running: Whether a run is active.
        dead_recorders: Bags whose recorder was killed or cannot write, with the time of that.
        ended: Ids of the runs that have ended.
        lacking: Ids of those whose journal lacks an evaluation, which the bag may have.
        latest: Id of the run that began last.
    """

    def __init__(self, runs_dir: Path) -> None:
        self._runs_dir = runs_dir
        self._broken: list[str] = []
        self.bounds = dict.fromkeys(NAMES, (-2.0, 2.0))
        self.asked_bounds: dict[str, tuple[float, float]] | None = None
        self.crossing: dict[str, float] | None = None
        self.status = msg.TunerStatus()
        self.running = False
        self.dead_recorders: dict[str, float] = {}
        self.ended: list[str] = []
        self.lacking: set[str] = set()
        self.latest = ""

    def check(self) -> None:
        """Check what was seen so far.

        Raises:
            BrokenPromiseError: If something did not hold.
        """
        require(not self._broken, "; ".join(self._broken[:2]))

    def check_motion(self, at: Mapping[str, float]) -> None:
        """Take note of a set-point that the tuner sends; empty for none."""
        if not at or at == self.crossing:
            return
        for bounds in (self.bounds, self.asked_bounds):
            if bounds is not None and all(
                bounds[n][0] - 1e-12 <= at[n] <= bounds[n][1] + 1e-12 for n in NAMES
            ):
                return
        self._broken.append(f"the machine is sent to {at}, outside {self.bounds}")

    def hear(self, status: msg.TunerStatus) -> None:
        """Take note of a status."""
        self.status = status
        if status.state == msg.TunerStatus.PAUSED and not status.message:
            self._broken.append("a pause has no reason")
        if status.state == msg.TunerStatus.WAITING and self.running and not status.message:
            self._broken.append("a wait has no reason")
        for bag, since in self.dead_recorders.items():
            claimed = not self.tells_of_loss(bag)
            if claimed and time.monotonic() - since > LOSS_TIMEOUT:
                self._broken.append(f"the recorder of {bag} is dead, and said to record")

    def tells_of_loss(self, bag: str) -> bool:
        """Return whether the last status does not say that a recorder writes a bag."""
        return not (
            self.status.recorder.startswith("the recorder writes") and bag in self.status.recorder
        )

    def conclude(self, result: Tune.Result) -> bool:
        """Check the result and the files of a run that has ended; return whether it was refused."""
        self.running = False
        self.crossing = None
        if not result.run_id or not (self._runs_dir / result.run_id / FILE_NAME).is_file():
            require(result.error_msg, "a refusal has no reason")
            return True
        self.ended.append(result.run_id)
        self.latest = result.run_id
        lacking = "it lacks evaluation" in result.error_msg  # its disk was full to the end
        if lacking:
            self.lacking.add(result.run_id)
        require(
            lacking or result.error_code != Tune.Result.INTERNAL, f"internal: {result.error_msg}"
        )
        history = self.read(result.run_id)
        kept = len(history.evaluations)
        require(
            kept + lacking == result.evaluations,
            f"{kept} of {result.evaluations} evaluations of {result.run_id} are in its journal",
        )
        if not lacking:
            self._check_front(history, result.pareto_front)
        return False

    def read(self, run_id: str) -> History:
        """Read the journal of a run."""
        history = History.from_records(read_journal(self._runs_dir / run_id))
        require(history.run_id == run_id, f"the journal of {run_id} names {history.run_id}")
        return history

    def _check_front(self, history: History, front: msg.ParetoFront) -> None:
        optimizer, run_id = restore(history, None), history.run_id
        kept = {point["index"] for point in optimizer.pareto_front()}
        told = {point.index for point in front.points}
        require(kept == told, f"the front of {run_id} is {kept} in its journal, {told} told")
        require(
            math.isclose(optimizer.hypervolume, front.hypervolume, rel_tol=1e-6, abs_tol=1e-9),
            f"the hypervolume of {run_id} is {optimizer.hypervolume}, {front.hypervolume} told",
        )

    def check_idle(self, result: Tune.Result) -> None:
        """Check that the status of an idle tuner agrees with the result of the run that has ended."""
        status = self.status
        if "-ask-" in status.run_id:  # a client's own loop has begun meanwhile
            return
        require(status.run_id == result.run_id, "the status has another run than the result")
        require(status.stop_reason == result.stop_reason, "another stop reason")
        require(status.evaluations == result.evaluations, "another number of evaluations")
        require(status.front_size == len(result.pareto_front.points), "another front")
