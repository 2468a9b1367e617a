"""Steering of a run that goes on: what was asked for, and the services that ask for it.

Everything takes effect at the boundary between two evaluations, but for `skip`, which also ends the
evaluation in flight.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, NamedTuple

from rclpy.task import Future
from std_srvs.srv import Trigger

from mobo_msgs_py.srv import QueueSetpoint
from mobo_tuner.core import Problem, ProblemError
from mobo_tuner.ros.conversions import seconds, unique_values

if TYPE_CHECKING:
    from mobo_tuner.tuning.parts import TunerParts
    from mobo_tuner.tuning.run import Run

MAX_QUEUED = 1000  # set-points of operators


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


class SteeringServices:
    """Serves `pause`, `resume`, `step`, `skip`, `stop_after_this` and `queue_setpoint`.

    Args:
        parts: of the tuner's node.
        current: gives the run that goes on, if any.
    """

    def __init__(self, parts: TunerParts, current: Callable[[], Run | None]) -> None:
        self._parts = parts
        self._current = current
        for name, action in (
            ("pause", _pause),
            ("resume", _resume),
            ("step", _step),
            ("skip", _skip),
            ("stop_after_this", _stop_after_this),
        ):
            parts.node.create_service(Trigger, name, self._trigger(name, action))
        parts.node.create_service(QueueSetpoint, "queue_setpoint", self._queue)

    def _trigger(
        self, name: str, action: Callable[[Run], str]
    ) -> Callable[[Trigger.Request, Trigger.Response], Trigger.Response]:
        def serve(_: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
            run = self._current()
            if run is None:
                response.message = f"'{name}' concerns a run that goes on, and there is none"
                return response
            response.success = True
            response.message = action(run)
            run.steering.notify()
            self._parts.log.info(f"run '{run.run_id}', asked to {name}: {response.message}")
            return response

        return serve

    def _queue(
        self, request: QueueSetpoint.Request, response: QueueSetpoint.Response
    ) -> QueueSetpoint.Response:
        run = self._current()
        if run is None:
            response.message = "a set-point is queued for a run that goes on, and there is none"
            return response
        steering = run.steering
        problem = steering.change.problem if steering.change else run.problem
        try:
            if len(steering.queue) >= MAX_QUEUED:
                raise ProblemError(f"{MAX_QUEUED} set-points wait already; no more are allowed")
            setpoint = unique_values("the set-point", request.setpoint)
            check_bounds(problem, setpoint)
            stamp = seconds(self._parts.now())
            run.journal.append({"type": "queued", "stamp": stamp, "setpoint": setpoint})
        except (ProblemError, OSError) as error:
            response.message = str(error)
        else:
            steering.queue.append(setpoint)
            steering.notify()
            response.success = True
        response.waiting = len(steering.queue)
        return response


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


def _pause(run: Run) -> str:
    run.steering.paused = True
    run.steering.steps = 0
    return f"the run pauses before evaluation {run.index + (1 if run.evaluating else 0)}"


def _resume(run: Run) -> str:
    run.steering.paused = False
    run.steering.steps = 0
    return "the run goes on"


def _step(run: Run) -> str:
    run.steering.paused = True
    run.steering.steps += 1
    return f"one more evaluation, then a pause; {run.steering.steps} to be made before it"


def _skip(run: Run) -> str:
    run.steering.ask_to_skip()
    return f"evaluation {run.index} is skipped, which counts as failed"


def _stop_after_this(run: Run) -> str:
    run.steering.stopping = True
    return f"the run ends {'after' if run.evaluating else 'before'} evaluation {run.index}"
