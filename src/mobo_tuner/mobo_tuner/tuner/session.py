"""Who has the tuner now, and whose evaluations it knows."""

from __future__ import annotations

from dataclasses import dataclass

from mobo_tuner.tuner.context import TunerParts
from mobo_tuner.tuner.run.run import Run
from mobo_tuner.tuner.run.start import Earlier, read_earlier


@dataclass
class Session:
    """One run goes on, or one move to a working point, or nothing.

    Attributes:
        run: that goes on.
        latest: the run that began last, whose evaluations are known; it may have ended.
        reading: whether an earlier run is being read.
        moving: whether the machine is on its way to a working point, or held there.
    """

    run: Run | None = None
    latest: Run | None = None
    reading: bool = False
    moving: bool = False

    @property
    def occupied(self) -> str:
        """Why nothing else may begin, in a sentence; empty where it may."""
        if self.moving:
            return "the machine is going to a working point; one thing at a time is allowed"
        if self.run is not None:
            return f"run '{self.run.run_id}' is going on; one run at a time is allowed"
        if self.reading:
            return "an earlier run is being read; one thing at a time is allowed"
        return ""

    def current(self) -> Run | None:
        """The run that goes on."""
        return self.run


async def read_run(parts: TunerParts, session: Session, run_id: str) -> Earlier:
    """Read an earlier run from its folder, while nothing else may begin.

    Raises:
        ValueError, OSError: it cannot be read, with the reason.
    """
    session.reading = True
    try:
        earlier: Earlier = await parts.worker.submit(
            read_earlier, parts.parameters["runs_dir"], run_id
        )
    finally:
        session.reading = False
    return earlier
