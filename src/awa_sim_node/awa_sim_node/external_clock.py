"""The time on `/clock` that drives the simulated machine, and whether it stands still."""

from __future__ import annotations

import time
from collections.abc import Callable

PATIENCE = 3.0  # [s] of wall time


class ExternalClock:
    """A clock that others publish.

    Args:
        now: Function that returns its time [s]; 0 before anybody has published it.
        wall: Clock of wall time [s].
    """

    def __init__(
        self, now: Callable[[], float], wall: Callable[[], float] = time.monotonic
    ) -> None:
        self._now = now
        self._wall = wall
        self._latest = now()
        self._changed = wall()

    def __call__(self) -> float:
        """Return the time [s]."""
        latest = self._now()
        if latest != self._latest:
            self._latest, self._changed = latest, self._wall()
        return latest

    @property
    def trouble(self) -> str:
        """Why the machine stands still, if the time has not changed for `PATIENCE`; else empty."""
        latest = self()
        if self._wall() - self._changed < PATIENCE:
            return ""
        what = f"time on /clock stands at {latest:.9g} s" if latest else "nobody publishes /clock"
        return f"the machine stands still: use_sim_time is true, and {what}"
