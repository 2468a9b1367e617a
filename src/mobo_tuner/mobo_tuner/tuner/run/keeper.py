"""A run from its first step to its end: its heartbeat, how it ended, and where the machine is left."""

from __future__ import annotations

from typing import NamedTuple

from mobo_msgs_py import msg
from mobo_msgs_py.action import Tune
from mobo_tuner.ros.conversions import seconds
from mobo_tuner.tuner.context import TunerParts
from mobo_tuner.tuner.run.fallbacks import Ends
from mobo_tuner.tuner.run.loop import RunLoop, Teller
from mobo_tuner.tuner.run.run import Run, RunError
from mobo_tuner.tuner.session import Session

CODES = Tune.Result


class Ending(NamedTuple):
    """How a run ended; the fields are those of `Tune.Result`."""

    stop_reason: str
    error_code: int = CODES.NONE
    error_msg: str = ""


class RunKeeper:
    """Sees runs through, one at a time.

    Args:
        parts: of the tuner's node.
        session: which the run has until its end.
    """

    def __init__(self, parts: TunerParts, session: Session) -> None:
        self._parts = parts
        self._session = session
        self._ends = Ends(parts)
        self._loop = RunLoop(parts, self._ends)

    async def see_through(self, run: Run, tell: Teller) -> Ending:
        """Carry out a run that has begun; whatever happens, its journal is closed at the end."""
        self._session.run = run
        self._parts.heartbeat.begin(run.run_id)
        try:
            ending = await self._carry_out(run, tell)
            if ending.error_code not in (CODES.NONE, CODES.MACHINE_LOST):
                done = await self._ends.act(run)
                if done:
                    self._parts.log.info(f"run '{run.run_id}': {done}")
                    ending = ending._replace(error_msg=f"{ending.error_msg}; {done}")
            end_journal(self._parts, run, ending)
            self._parts.status.set(
                publish=False, message=ending.error_msg, stop_reason=ending.stop_reason
            )
        finally:
            self._parts.heartbeat.end()
            self._session.run = None
            self._parts.status.set(state=msg.TunerStatus.IDLE, phase="", fraction=0.0)
        self._parts.log.info(
            f"run '{run.run_id}': {run.index} evaluations, hypervolume "
            f"{run.optimizer.hypervolume:.6g}, stopped by {ending.stop_reason}"
        )
        return ending

    async def _carry_out(self, run: Run, tell: Teller) -> Ending:
        try:
            await self._loop.carry_out(run, tell)
        except Exception as error:
            code, text = CODES.INTERNAL, f"{type(error).__name__}: {error}"
            if isinstance(error, RunError):
                code, text = error.code, str(error)
            self._parts.log.error(f"run '{run.run_id}' ends: {text}")
            return Ending("error", code, text)
        if run.interrupted:
            why = f"the run was stopped: {run.interrupt.result()}"
            return Ending("canceled", CODES.CANCELED, why)
        if run.steering.stopping:
            return Ending("stopped")
        return Ending("budget" if run.index >= run.budget else "hypervolume_goal")


def end_journal(parts: TunerParts, run: Run, ending: Ending) -> None:
    """Write the end of a run into its journal and close it."""
    try:
        run.journal.append(
            {"type": "end", "stamp": seconds(parts.now()), **ending._asdict()},
        )
    except OSError as error:
        parts.log.error(f"the end of the run is not in its journal: {error}")
    run.journal.close()
