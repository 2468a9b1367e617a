"""Whether a run is recorded: what the recorder says, whether the journal can be written, free space."""

from __future__ import annotations

import contextlib
import math
import shutil
import time
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

from rclpy.task import Future

from mobo_msgs_py.msg import RecorderStatus, TunerStatus
from mobo_tuner.ros import interfaces
from mobo_tuner.ros.waiting import STEADY_CLOCK, first_of, unmatched_topics, until
from mobo_tuner.tuner.context import TunerContext
from mobo_tuner.tuner.run.run import Run
from mobo_tuner.tuner.session import Session

PERIOD = 1.0  # [s] between two looks
SILENCE = 5.0  # [s] without a status after which a recorder counts as lost
SCARCE_SPACE = 1e9  # [byte] left on the disk below which operators are warned
JOURNAL_PATIENCE = 300.0  # [s] for which a run waits until its journal can be written
MATCH_TIMEOUT = 2.0  # [s] for subscribers to be connected before a run begins
RETRY_PERIOD = 2.0  # [s] between two attempts to write the journal
PAUSE = "pause"
_HINTS = "recording"  # who gives these hints


class Heard(NamedTuple):
    """The last status of one recorder, and when it came on a steady clock [s]."""

    status: RecorderStatus
    time: float


@dataclass(frozen=True)
class Recorders:
    """What all recorders of a tuner do together.

    Attributes:
        text: What they do, in one sentence; empty if none was found.
        lost: Whether no recorder records any more.
    """

    text: str = ""
    lost: bool = False


def judge_recorders(heard: dict[str, Heard], now: float) -> Recorders:
    """Judge recorders by their last statuses.

    Args:
        heard: Last status of each, by the path of its bag.
        now: Time on the same clock [s].
    """
    if not heard:
        return Recorders()
    alive = [h.status for h in heard.values() if h.status.recording and now - h.time <= SILENCE]
    if alive:
        return Recorders(f"the recorder writes {', '.join(s.path for s in alive)}")
    last = max(heard.values(), key=lambda h: h.time)
    silent = f"it has been silent for {SILENCE:g} s"
    reason = silent if last.status.recording else last.status.message
    return Recorders(f"the recorder of {last.status.path} is lost: {reason}", lost=True)


class Recording:
    """Tells operators whether the active run is recorded, and acts if it is not.

    A run whose recorder is lost continues or pauses, as `on_recorder_lost` says; a run without any
    recorder is not told of. A run whose journal cannot be written waits, or pauses.

    Args:
        context: The tuner's node and what works in it.
        session: Session with the active run.
    """

    def __init__(self, context: TunerContext, session: Session) -> None:
        self._context = context
        self._session = session
        self._heard: dict[str, Heard] = {}
        self._recorders = Recorders()
        self._space: Future | None = None  # probe of the disk, which may hang
        self._free = math.nan  # [byte]
        interfaces.RECORDER_STATUS.subscription(context.node, self._hear)
        self._timer = context.node.create_timer(PERIOD, self._look, clock=STEADY_CLOCK)

    @property
    def trouble(self) -> str:
        """Reason why no recorder records any more; empty if one does, or none was found."""
        return self._recorders.text if self._recorders.lost else ""

    def begin(self) -> None:
        """Note that a run begins; a recorder that was lost before does not concern it."""
        if self._recorders.lost:
            self._heard.clear()
        self._judge()

    async def await_subscribers(self, *interrupts: Future) -> None:
        """Wait a moment until all that subscribe to the tuner would receive what a run publishes.

        On a busy computer a recorder may have taken up topics that its subscriptions do not reach yet.
        """
        node = self._context.node
        own = {publisher.topic for publisher in node.publishers}

        def ready() -> bool:
            alive = [
                heard.status
                for heard in self._heard.values()
                if heard.status.recording and time.monotonic() - heard.time <= SILENCE
            ]
            taken_up = all(own <= {*status.topics} for status in alive)
            return taken_up and not unmatched_topics(node)

        await until(node, ready, *interrupts, timeout=MATCH_TIMEOUT)

    async def await_journal(self, run: Run) -> None:
        """Wait until the journal has what is known of a run, or the run must end.

        With `on_recorder_lost: pause`, the next attempt is made when an operator continues the run.
        """
        context = self._context
        deadline = time.monotonic() + JOURNAL_PATIENCE
        said = False
        while run.log.trouble and not run.interrupted and not run.steering.stopping:
            trouble = run.log.trouble
            if not said:
                context.log.error(f"run '{run.run_id}': {trouble}")
                context.status.fail(trouble)
                said = True
            if context.parameters.on_recorder_lost == PAUSE:
                await self._await_operator(run, trouble)
            else:
                left = deadline - time.monotonic()
                if left <= 0.0:
                    return
                context.status.work(
                    TunerStatus.WAITING,
                    f"{trouble}; waiting until it can, {left:.0f} s are left",
                )
                await first_of(context.node, run.interrupt, run.steering.stop, timeout=RETRY_PERIOD)
            await context.worker.submit(run.log.retry)
        if said and not run.log.trouble:
            context.status.work(TunerStatus.SUGGESTING, "")
            context.log.info(f"run '{run.run_id}': the journal is written again")

    async def _await_operator(self, run: Run, reason: str) -> None:
        steering = run.steering
        steering.pause(reason)
        while steering.waits and not (run.interrupted or steering.stopping):
            self._context.status.work(
                TunerStatus.PAUSED, f"paused before evaluation {run.index}: {reason}"
            )
            await first_of(
                self._context.node, run.interrupt, steering.news, timeout=JOURNAL_PATIENCE
            )

    # ------------------------------------------------------------------ what is seen

    def _hear(self, status: RecorderStatus) -> None:
        self._heard[status.path] = Heard(status, time.monotonic())
        self._judge()

    def _look(self) -> None:
        self._probe()
        self._judge()

    def _judge(self) -> None:
        """Say what is new of the recorders and the disk."""
        before = self._recorders
        self._recorders = now = judge_recorders(self._heard, time.monotonic())
        hints = []
        if now.lost:
            hints.append(
                f"{now.text}: start another one with a new bag_path; the journal does not need it"
            )
        if self._free < SCARCE_SPACE:
            hints.append(
                f"less than {SCARCE_SPACE / 1e9:g} GB is left on the disk of the runs: free some space"
            )
        status, run = self._context.status, self._session.run
        status.set(publish=False, recorder=now.text, free_space=self._free)
        status.hint(_HINTS, hints)
        if now != before:
            status.set()
        if run is not None and now.lost and not before.lost:
            self._context.log.error(f"run '{run.run_id}': {now.text}")
            if self._context.parameters.on_recorder_lost == PAUSE:
                run.steering.pause(now.text)
                run.steering.notify()
        elif before.lost and now.text and not now.lost:
            self._context.log.info(now.text)

    def _probe(self) -> None:
        """Measure the free space in the worker thread, because a network disk may hang."""
        folder = self._context.parameters.run_dir("")
        if folder is None or (self._space is not None and not self._space.done()):
            return
        if self._space is not None:
            self._free = self._space.result()
        self._space = self._context.worker.submit(free_space, folder)


def free_space(folder: Path) -> float:
    """Return the free space on a folder's disk [byte]; NaN if it is unknown."""
    for place in (folder, *folder.absolute().parents):
        with contextlib.suppress(OSError):
            return float(shutil.disk_usage(place).free)
    return math.nan
