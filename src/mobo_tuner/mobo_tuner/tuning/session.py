"""Who has the tuner now, and whose evaluations it knows."""

from __future__ import annotations

from dataclasses import dataclass

from mobo_tuner.tuning.run import Run


@dataclass
class Session:
    """One run goes on, or one move to a working point, or nothing.

    Attributes:
        run: that goes on.
        latest: the run that began last, whose evaluations are known; it may have ended.
        starting: whether a run is about to begin, as one does that reads an earlier one first.
        moving: whether the machine is on its way to a working point, or held there.
    """

    run: Run | None = None
    latest: Run | None = None
    starting: bool = False
    moving: bool = False

    @property
    def occupied(self) -> str:
        """Why nothing else may begin, in a sentence; empty where it may."""
        if self.moving:
            return "the machine is going to a working point; one thing at a time is allowed"
        if self.run is not None:
            return f"run '{self.run.run_id}' is going on; one run at a time is allowed"
        if self.starting:
            return "a run is about to begin; one run at a time is allowed"
        return ""

    def current(self) -> Run | None:
        """The run that goes on."""
        return self.run
