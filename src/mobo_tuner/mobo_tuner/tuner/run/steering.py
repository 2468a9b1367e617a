"""What operators asked of a run that goes on, and what of it is not done yet.

Everything takes effect at the boundary between two evaluations, but for `skip`, which also ends the
evaluation in flight.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

from rclpy.task import Future

from mobo_tuner.core import Problem, ProblemError


class Change(NamedTuple):
    """What a run goes on with from the next evaluation on."""

    problem: Problem
    budget: int


@dataclass
class Steering:
    """What was asked of one run and not yet done.

    Attributes:
        paused: whether it waits at the next boundary.
        steps: evaluations that it may make although it is paused.
        stopping: whether it ends at the next boundary.
        change: that takes effect at the next boundary.
        queue: set-points of operators, evaluated before the next suggestion.
    """

    paused: bool = False
    steps: int = 0
    stopping: bool = False
    change: Change | None = None
    queue: deque[dict[str, float]] = field(default_factory=deque)
    _news: Future = field(default_factory=Future)
    _skip: Future = field(default_factory=Future)

    @property
    def news(self) -> Future:
        """Done when something is asked for, from this moment on."""
        if self._news.done():
            self._news = Future()
        return self._news

    @property
    def skip(self) -> Future:
        """Done when the evaluation that goes on or comes next shall be skipped."""
        return self._skip

    @property
    def waits(self) -> bool:
        """Whether the run may not make its next evaluation now."""
        return self.paused and not self.steps

    def notify(self) -> None:
        """Something was asked for."""
        if not self._news.done():
            self._news.set_result(None)

    def ask_to_skip(self) -> None:
        """Skip what goes on or comes next."""
        if not self._skip.done():
            self._skip.set_result(None)

    def take_step(self) -> None:
        """An evaluation begins."""
        self.steps = max(0, self.steps - 1)

    def forget_skip(self) -> None:
        """The evaluation is over; a request to skip it does not concern the next one."""
        self._skip = Future()


def check_bounds(problem: Problem, setpoint: Mapping[str, float]) -> None:
    """Check a set-point that someone gives for a run.

    Raises:
        ProblemError: it is not one of the problem's, or is outside its bounds.
    """
    problem.normalize(setpoint)
    for v in problem.variables:
        if not v.minimum <= setpoint[v.name] <= v.maximum:
            raise ProblemError(
                f"set-point {v.name} is {setpoint[v.name]:g}; {v.minimum:g} to {v.maximum:g} "
                f"{v.unit}".rstrip()
                + " is allowed"
            )
