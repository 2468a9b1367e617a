"""The services by which operators steer the active run."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from std_srvs.srv import Trigger

from mobo_msgs_py.srv import QueueSetpoint
from mobo_tuner.core import ProblemError
from mobo_tuner.errors import UserError
from mobo_tuner.ros import interfaces
from mobo_tuner.ros.conversions import unique_values
from mobo_tuner.runs.records import QueuedRecord
from mobo_tuner.tuner.context import TunerContext
from mobo_tuner.tuner.gate import Gate, Target, check_bounds
from mobo_tuner.tuner.run.run import Run
from mobo_tuner.tuner.session import Session

MAX_QUEUED = 1000  # set-points


class SteeringServices:
    """Serves `pause`, `resume`, `step`, `skip`, `stop_after_this` and `queue_setpoint`.

    Args:
        context: The tuner's node and what works in it.
        session: Session with the active run.
    """

    def __init__(self, context: TunerContext, session: Session) -> None:
        self._context = context
        self._session = session
        for service, action in (
            (interfaces.PAUSE, _pause),
            (interfaces.RESUME, _resume),
            (interfaces.STEP, _step),
            (interfaces.SKIP, _skip),
            (interfaces.STOP_AFTER_THIS, _stop_after_this),
        ):
            service.server(context.node, self._trigger(service.name, action))
        interfaces.QUEUE_SETPOINT.server(context.node, self._queue)

    def _trigger(
        self, name: str, action: Callable[[Run], str]
    ) -> Callable[[Trigger.Request, Trigger.Response], Trigger.Response]:
        def serve(_: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
            run = self._session.run
            if run is None:
                response.message = f"'{name}' needs an active run; there is none"
                return response
            try:
                response.message = action(run)
            except ValueError as error:
                response.message = str(error)
                return response
            response.success = True
            run.steering.notify()
            self._context.log.info(f"run '{run.run_id}', {name}: {response.message}")
            return response

        return serve

    def _queue(
        self, request: QueueSetpoint.Request, response: QueueSetpoint.Response
    ) -> QueueSetpoint.Response:
        run = self._session.run
        if run is None:
            response.message = "'queue_setpoint' needs an active run; there is none"
            return response
        steering = run.steering
        try:
            if len(steering.queue) >= MAX_QUEUED:
                raise ProblemError(f"{MAX_QUEUED} set-points are queued; no more are allowed")
            setpoint = unique_values("the set-point", request.setpoint)
            check_queued(run, self._context.gate, setpoint)
            run.log.append(QueuedRecord(self._context.stamp(), setpoint))
        except (UserError, OSError) as error:
            response.message = str(error)
        else:
            steering.queue.append(setpoint)
            steering.notify()
            response.success = True
        response.waiting = len(steering.queue)
        return response


def check_queued(run: Run, gate: Gate, setpoint: Mapping[str, float]) -> None:
    """Check a set-point that an operator wants to have evaluated.

    Raises:
        UserError: If it does not name the run's variables, or is out of bounds.
    """
    run.problem.normalize(setpoint)
    if not run.changeable:  # it stays around a point
        check_bounds(run.problem, setpoint)
    gate.check(Target(setpoint))


def _pause(run: Run) -> str:
    run.steering.pause()
    return f"the run pauses before evaluation {run.index + (1 if run.evaluating else 0)}"


def _resume(run: Run) -> str:
    run.steering.resume()
    return "the run continues"


def _step(run: Run) -> str:
    run.steering.step()
    count = run.steering.steps
    return f"{count} more evaluation{'s' if count > 1 else ''}, then a pause"


def _skip(run: Run) -> str:
    if run.steering.falling_back:
        run.steering.request_skip()
        return "the machine stops where it is"
    if not run.evaluating:
        raise ValueError("'skip' needs an evaluation in flight; there is none")
    run.steering.request_skip()
    return f"evaluation {run.index} is skipped, which counts as failed"


def _stop_after_this(run: Run) -> str:
    run.steering.stopping = True
    return f"the run ends {'after' if run.evaluating else 'before'} evaluation {run.index}"
