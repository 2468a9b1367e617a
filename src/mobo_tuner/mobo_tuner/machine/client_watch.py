"""Whether the client of a run still lives, by its heartbeat, and which of its evaluations are old."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Mapping

MAX_RUNS = 100  # that are remembered


class ClientWatch:
    """Watches one client: that of the run whose evaluation asked for it last.

    It knows no clock: times are seconds of any one steady clock.
    """

    def __init__(self) -> None:
        self.run_id = ""
        self.timeout = 0.0
        self.fallback: Mapping[str, float] = {}
        self._heard = 0.0

    @property
    def active(self) -> bool:
        """Whether a client is watched."""
        return bool(self.run_id)

    def begin(self, run_id: str, timeout: float, fallback: Mapping[str, float], now: float) -> None:
        """A goal of `run_id` came: watch its client from now on, and no other.

        Args:
            run_id: of the goal.
            timeout: of the heartbeat [s]; 0 = this client is not watched.
            fallback: where the machine goes when the client is lost; empty = it holds.
            now: [s].
        """
        self.run_id = run_id if timeout > 0.0 else ""
        self.timeout, self.fallback, self._heard = timeout, fallback, now

    def hear(self, run_id: str, now: float) -> None:
        """A heartbeat came; it counts where it is of the run that is watched."""
        if run_id == self.run_id:
            self._heard = now

    def end(self) -> None:
        """Watch nobody."""
        self.run_id = ""

    def lost(self, now: float) -> bool:
        """Whether the client that is watched has been silent for longer than its timeout."""
        return self.active and now - self._heard > self.timeout


class FinishedEvaluations:
    """The last evaluation that each run finished, so that late and duplicate goals are recognised."""

    def __init__(self) -> None:
        self._last: OrderedDict[str, tuple[int, int]] = OrderedDict()

    def refusal(self, run_id: str, index: int, attempt: int) -> str:
        """Why this evaluation must not be made, in one sentence; empty where it may."""
        last = self._last.get(run_id)  # None if the run has no id: such evaluations are by hand
        if last is None or (index, attempt) > last:
            return ""
        kind = "a duplicate" if (index, attempt) == last else "late"
        return (
            f"evaluation {index}, attempt {attempt} of run '{run_id}' is {kind}: the last one "
            f"finished is {last[0]}, attempt {last[1]}"
        )

    def add(self, run_id: str, index: int, attempt: int) -> None:
        """This evaluation is finished; one without a run may be repeated at will."""
        if not run_id:
            return
        self._last[run_id] = (index, attempt)
        self._last.move_to_end(run_id)
        while len(self._last) > MAX_RUNS:
            self._last.popitem(last=False)

    def forget(self, run_id: str) -> None:
        """The run's client is lost: whoever resumes the run may have missed the last answer."""
        self._last.pop(run_id, None)
