"""Who uses the tuner now, and whose evaluations it knows."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from mobo_tuner.tuner.run.run import Run


class Session:
    """At any time one run is active, or one move to a working point, or nothing."""

    def __init__(self) -> None:
        self._run: Run | None = None
        self._latest: Run | None = None
        self._reason = ""

    @property
    def run(self) -> Run | None:
        """Run that is active."""
        return self._run

    @property
    def latest(self) -> Run | None:
        """Run that began last, whose evaluations are known; it may have ended."""
        return self._latest

    @property
    def occupied(self) -> str:
        """Reason why nothing else may begin, one sentence; empty if something may."""
        if self._reason:
            return self._reason
        if self._run is not None:
            return f"run '{self._run.run_id}' is active; one run at a time is allowed"
        return ""

    def check_free(self) -> None:
        """Check that something may begin.

        Raises:
            ValueError: If the tuner is occupied, with the reason.
        """
        if self.occupied:
            raise ValueError(self.occupied)

    def know(self, run: Run) -> None:
        """Make a run the latest; it need not be active."""
        self._latest = run

    @contextmanager
    def running(self, run: Run) -> Iterator[None]:
        """Let a run be active."""
        self._run = run
        try:
            yield
        finally:
            self._run = None

    @contextmanager
    def moving(self) -> Iterator[None]:
        """Let the machine move to a working point, or be held there."""
        with self._busy("the machine is moving to a working point; one thing at a time is allowed"):
            yield

    @contextmanager
    def reading(self) -> Iterator[None]:
        """Let an earlier run or a model of the machine be read."""
        with self._busy("an earlier run or a model is being read; one thing at a time is allowed"):
            yield

    @contextmanager
    def locating(self) -> Iterator[None]:
        """Let the machine be asked where it is."""
        with self._busy("the machine is asked where it is; one thing at a time is allowed"):
            yield

    @contextmanager
    def _busy(self, reason: str) -> Iterator[None]:
        before, self._reason = self._reason, reason
        try:
            yield
        finally:
            self._reason = before
