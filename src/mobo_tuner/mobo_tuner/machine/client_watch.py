"""Watch of a run's client by its heartbeat, and of repeated evaluations."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Mapping, Sequence

MAX_RUNS = 100  # number of runs that are remembered


class ClientWatch:
    """Watches one client: that of the run whose evaluation requested it last.

    It has no clock of its own: all times are seconds of one steady clock.
    """

    def __init__(self) -> None:
        self.run_id = ""
        self.timeout = 0.0
        self.fallback: Sequence[Mapping[str, float]] = ()
        self._heard = 0.0

    @property
    def active(self) -> bool:
        """Whether a client is watched."""
        return bool(self.run_id)

    def begin(
        self, run_id: str, timeout: float, fallback: Sequence[Mapping[str, float]], now: float
    ) -> None:
        """Watch the client of a run, and no other, from now on.

        Args:
            run_id: Id of the run.
            timeout: Timeout of the heartbeat [s]; 0 = the client is not watched.
            fallback: Set-points to go to, one after the other, if the client is lost; empty = hold.
            now: Current time [s].
        """
        self.run_id = run_id if timeout > 0.0 else ""
        self.timeout, self.fallback, self._heard = timeout, fallback, now

    def hear(self, run_id: str, now: float) -> None:
        """Take a heartbeat; those of other runs are ignored."""
        if run_id == self.run_id:
            self._heard = now

    def end(self) -> None:
        """Stop watching."""
        self.run_id = ""

    def lost(self, now: float) -> bool:
        """Return whether the watched client has been silent for longer than its timeout."""
        return self.active and now - self._heard > self.timeout


class FinishedEvaluations:
    """The last evaluation that each run finished, so that late and duplicate goals are recognised."""

    def __init__(self) -> None:
        self._last: OrderedDict[str, tuple[int, int]] = OrderedDict()

    def refusal(self, run_id: str, index: int, attempt: int) -> str:
        """Return the reason to refuse an evaluation, in one sentence; empty if there is none."""
        last = self._last.get(run_id)  # None if the run has no id: such evaluations are by hand
        if last is None or (index, attempt) > last:
            return ""
        kind = "a duplicate" if (index, attempt) == last else "late"
        return (
            f"evaluation {index}, attempt {attempt} of run '{run_id}' is {kind}: the last one "
            f"finished is {last[0]}, attempt {last[1]}"
        )

    def add(self, run_id: str, index: int, attempt: int) -> None:
        """Remember a finished evaluation; one without a run may be repeated."""
        if not run_id:
            return
        self._last[run_id] = (index, attempt)
        self._last.move_to_end(run_id)
        while len(self._last) > MAX_RUNS:
            self._last.popitem(last=False)

    def forget(self, run_id: str) -> None:
        """Forget a run whose client is lost: its successor may have missed the last result."""
        self._last.pop(run_id, None)
