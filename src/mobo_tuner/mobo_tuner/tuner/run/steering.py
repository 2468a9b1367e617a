"""Pending requests of operators to the active run.

All take effect between two evaluations; only `skip` ends the evaluation in flight.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field
from typing import NamedTuple

from rclpy.task import Future

from mobo_tuner.core import Problem
from mobo_tuner.runs.records import ForgetRecord, StopReason


class Change(NamedTuple):
    """Problem and budget of a run from the next evaluation on."""

    problem: Problem
    budget: int


@dataclass
class Steering:
    """What operators asked of one run and what is not done yet.

    Attributes:
        paused: Whether the run waits before the next evaluation.
        reasons: Reasons of the pause, each in a few words.
        steps: Number of evaluations that it may make although it is paused.
        stop: Done when the run must end before the next evaluation; its result is a `StopReason`.
        change: Change that takes effect before the next evaluation.
        withdrawals: Evaluations and diagnostics to forget, or to learn again, before the next suggestion.
        queue: Set-points of operators, evaluated before the next suggestion.
        falling_back: Whether the run is over and the machine is moved; a request to skip stops it.
        over: Whether no further evaluation begins, so that requests come too late.
    """

    paused: bool = False
    reasons: list[str] = field(default_factory=list)
    steps: int = 0
    stop: Future = field(default_factory=Future)
    change: Change | None = None
    withdrawals: deque[ForgetRecord] = field(default_factory=deque)
    queue: deque[dict[str, float]] = field(default_factory=deque)
    falling_back: bool = False
    over: bool = False
    _news: Future = field(default_factory=Future)
    _skip: Future = field(default_factory=Future)
    _skipped: Future = field(default_factory=Future)

    @property
    def reason(self) -> str:
        """Reasons of the pause as one text."""
        return "; ".join(self.reasons)

    @property
    def news(self) -> Future:
        """Future that is done at the next request."""
        if self._news.done():
            self._news = Future()
        return self._news

    @property
    def skip(self) -> Future:
        """Future that is done when the evaluation in flight must be skipped."""
        return self._skip

    @property
    def skipped(self) -> Future:
        """Future that is done with the evaluation in flight; its result is whether that was skipped."""
        return self._skipped

    @property
    def changes(self) -> bool:
        """Whether something was requested that a suggestion depends on."""
        return self.change is not None or bool(self.withdrawals)

    @property
    def waits(self) -> bool:
        """Whether the run may not make its next evaluation now."""
        return self.paused and not self.steps

    def notify(self) -> None:
        """Wake up a run that waits: something was requested."""
        if not self._news.done():
            self._news.set_result(None)

    @property
    def stopping(self) -> bool:
        """Whether the run must end before the next evaluation."""
        return self.stop.done()

    def pause(self, reason: str) -> None:
        """Wait before the next evaluation, for a reason that is shown beside those of a pause that lasts."""
        self.paused, self.steps = True, 0
        if reason not in self.reasons:
            self.reasons.append(reason)

    def resume(self) -> None:
        """Do not wait any more."""
        self.paused, self.steps = False, 0
        self.reasons.clear()

    def step(self, reason: str) -> None:
        """Make one more evaluation, then wait, for a reason that is shown."""
        self.paused, self.reasons = True, [reason]
        self.steps += 1

    def request_stop(self, reason: StopReason = StopReason.STOPPED) -> None:
        """End before the next evaluation; the first reason counts."""
        if not self.stop.done():
            self.stop.set_result(reason)

    def request_skip(self) -> None:
        """Skip the evaluation in flight."""
        if not self._skip.done():
            self._skip.set_result(None)

    def take_step(self) -> None:
        """Note that an evaluation begins."""
        self.steps = max(0, self.steps - 1)

    def forget_skip(self, skipped: bool = False) -> None:
        """Note that an evaluation is over; a request to skip it does not apply to the next one.

        Args:
            skipped: Whether it was skipped.
        """
        self._skipped.set_result(skipped)
        self._skip, self._skipped = Future(), Future()

    def end(self) -> None:
        """Note that the run is over: what is requested from now on comes too late."""
        self.over = True
        self.forget_skip()

    def undone(self, stopped: bool) -> str:
        """Return what was requested and did not happen before the end, in a few words; empty if nothing.

        Args:
            stopped: Whether the run was stopped by somebody, who does not expect a pause any more.
        """
        parts = []
        if self.queue:
            parts.append(f"{len(self.queue)} queued set-point{'s' * (len(self.queue) > 1)}")
        if self.paused and not stopped:
            steps = f"{self.steps} single evaluation{'s' * (self.steps > 1)}, then "
            parts.append(f"{steps * (self.steps > 0)}a pause, as {self.reason}")
        return " and ".join(parts)

    def begin_fallback(self) -> None:
        """Note that the machine is moved after the run; earlier requests to skip do not stop it."""
        self.falling_back = True
        self.forget_skip()
