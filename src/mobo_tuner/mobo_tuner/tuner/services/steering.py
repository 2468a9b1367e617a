"""The services by which operators steer a run that goes on."""

from __future__ import annotations

from collections.abc import Callable

from std_srvs.srv import Trigger

from mobo_msgs_py.srv import QueueSetpoint
from mobo_tuner.core import ProblemError
from mobo_tuner.errors import UserError
from mobo_tuner.ros.conversions import seconds, unique_values
from mobo_tuner.tuner.context import TunerParts
from mobo_tuner.tuner.run.run import Run
from mobo_tuner.tuner.run.steering import check_bounds

MAX_QUEUED = 1000  # set-points of operators


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
        except (UserError, OSError) as error:
            response.message = str(error)
        else:
            steering.queue.append(setpoint)
            steering.notify()
            response.success = True
        response.waiting = len(steering.queue)
        return response


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
