"""The services by which operators steer the active run."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from std_srvs.srv import Trigger

from mobo_msgs_py.srv import ForgetEvaluation, QueueSetpoint
from mobo_tuner.core import ProblemError
from mobo_tuner.errors import MessageError, UserError
from mobo_tuner.ros import interfaces
from mobo_tuner.ros.conversions import unique_values
from mobo_tuner.ros.waiting import first_of
from mobo_tuner.runs.records import ForgetRecord, QueuedRecord
from mobo_tuner.tuner.context import TunerContext
from mobo_tuner.tuner.gate import Gate, Target, check_bounds, check_grids
from mobo_tuner.tuner.run.run import Run
from mobo_tuner.tuner.session import Session

MAX_QUEUED = 1000  # set-points
SKIP_TIMEOUT = 3.0  # [s] for an evaluation to end once it is to be skipped


class SteeringServices:
    """Serves `pause`, `resume`, `step`, `skip`, `stop_after_this`, `queue_setpoint`, `forget`, `unforget`.

    Args:
        context: The tuner's node and what works in it.
        session: Session with the active run.
    """

    def __init__(self, context: TunerContext, session: Session) -> None:
        self._context = context
        self._session = session
        for service, verb, action in (
            (interfaces.PAUSE, "pause", _pause),
            (interfaces.RESUME, "continue", _continue),
            (interfaces.STEP, "step", _step),
            (interfaces.STOP_AFTER_THIS, "stop", _stop_after_this),
        ):
            service.server(context.node, self._trigger(verb, action))
        interfaces.SKIP.server(context.node, self._skip, waits=True)
        interfaces.QUEUE_SETPOINT.server(context.node, self._queue)
        for service, withdrawn in ((interfaces.FORGET, True), (interfaces.UNFORGET, False)):
            service.server(context.node, self._withdrawal(service.name, withdrawn))

    def _trigger(
        self, verb: str, action: Callable[[Run], str]
    ) -> Callable[[Trigger.Request, Trigger.Response], Trigger.Response]:
        """Return the function of a service, whose answers name the operator's verb."""

        def serve(_: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
            try:
                run = self._active(verb)
                response.message = action(run)
            except RequestError as error:
                response.message = str(error)
                return response
            response.success = True
            run.steering.notify()
            self._context.log.info(f"run '{run.run_id}', {verb}: {response.message}")
            return response

        return serve

    def _active(self, verb: str) -> Run:
        """Return the run that a request is for.

        Raises:
            RequestError: If there is none, or it is over.
        """
        run = self._session.run
        if run is None:
            raise RequestError(f"'{verb}' needs an active run; there is none")
        if run.steering.over:
            moves = ", and the machine moves: 'skip' stops it" * run.steering.falling_back
            raise RequestError(f"'{verb}' comes too late: the run is over{moves}")
        return run

    async def _skip(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        """Serve `skip`; the answer says what became of the evaluation, which may just have ended."""
        run = self._session.run
        if run is not None and run.steering.falling_back:
            run.steering.request_skip()
            response.success, response.message = True, "the machine stops where it is"
        elif run is None:
            response.message = "'skip' needs an active run; there is none"
        elif not run.evaluating:
            response.message = "'skip' needs an evaluation in flight; there is none"
        else:
            index, skipped = run.index, run.steering.skipped
            run.steering.request_skip()
            await first_of(self._context.node, skipped, timeout=SKIP_TIMEOUT)
            response.success = not skipped.done() or bool(skipped.result())
            response.message = (
                f"evaluation {index} is skipped, which counts as failed"
                if response.success
                else f"'skip' comes too late: evaluation {index} had ended"
            )
        if run is not None:
            self._context.log.info(f"run '{run.run_id}', skip: {response.message}")
        return response

    def _withdrawal(
        self, name: str, withdrawn: bool
    ) -> Callable[[ForgetEvaluation.Request, ForgetEvaluation.Response], ForgetEvaluation.Response]:
        def serve(
            request: ForgetEvaluation.Request, response: ForgetEvaluation.Response
        ) -> ForgetEvaluation.Response:
            try:
                run = self._active(name)
                stamp, index = self._context.stamp(), run.index
                record = ForgetRecord(stamp, index, request.index, request.diagnostic, withdrawn)
                check_withdrawal(run, record)
            except UserError as error:
                response.message = str(error)
                return response
            run.steering.withdrawals.append(record)
            run.steering.notify()
            response.success = True
            what = f"{record.diagnostic} of " if record.diagnostic else ""
            counts = "counts as never measured" if withdrawn else "counts again"
            response.message = f"{what}evaluation {record.evaluation} {counts}"
            self._context.log.info(f"run '{run.run_id}', {name}: {response.message}")
            return response

        return serve

    def _queue(
        self, request: QueueSetpoint.Request, response: QueueSetpoint.Response
    ) -> QueueSetpoint.Response:
        try:
            run = self._active("queue")
        except RequestError as error:
            response.message = str(error)
            return response
        steering = run.steering
        try:
            check_continues(run)
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


class RequestError(UserError):
    """A request of an operator that the run cannot serve as it is now."""


def check_continues(run: Run) -> None:
    """Check that another evaluation begins, before which a request takes effect.

    Raises:
        RequestError: If the budget is spent with the one in flight.
    """
    change = run.steering.change
    budget = run.budget if change is None else change.budget
    if run.upcoming >= budget:
        raise RequestError(
            f"evaluation {budget - 1} is the last one, after which the run ends; "
            f"evaluations={budget + 1} or more extends it"
        )


def check_queued(run: Run, gate: Gate, setpoint: Mapping[str, float]) -> None:
    """Check a set-point that an operator wants to have evaluated.

    Raises:
        UserError: If it does not name the run's variables, or is out of bounds or off a grid.
    """
    run.problem.normalize(setpoint)
    check_grids(run.problem, setpoint)
    if not run.changeable:  # it stays around a point
        check_bounds(run.problem, setpoint)
    gate.check(Target(setpoint))


def check_withdrawal(run: Run, record: ForgetRecord) -> None:
    """Check that there is something to withdraw, or a withdrawal to end.

    Raises:
        MessageError: If there is not.
    """
    if record.evaluation >= len(run.records):
        known = f"0 to {len(run.records) - 1} are allowed" if run.records else "there is none yet"
        raise MessageError(f"evaluation {record.evaluation} is unknown: {known}")
    name = record.diagnostic or None
    measured = run.records[record.evaluation][1].diagnostics
    if name is not None and name not in measured:
        raise MessageError(
            f"evaluation {record.evaluation} has no diagnostic '{name[:80]}'; "
            f"it has {', '.join(measured) or 'none'}"
        )
    withdrawn = {name for index, name in run.found.withdrawn if index == record.evaluation}
    for earlier in run.steering.withdrawals:
        if earlier.evaluation != record.evaluation:
            continue
        if earlier.withdrawn:
            withdrawn.add(earlier.diagnostic or None)
        elif earlier.diagnostic:
            withdrawn.discard(earlier.diagnostic)
        else:
            withdrawn.clear()
    what = (
        f"{name} of evaluation {record.evaluation}" if name else f"evaluation {record.evaluation}"
    )
    if record.withdrawn and name in withdrawn:
        raise MessageError(f"{what} is withdrawn already")
    if not record.withdrawn and not (name in withdrawn or (name is None and withdrawn)):
        raise MessageError(f"{what} was not withdrawn")


def _pause(run: Run) -> str:
    check_continues(run)
    run.steering.pause("an operator asked for it")
    return f"the run pauses before evaluation {run.upcoming}"


def _continue(run: Run) -> str:
    run.steering.resume()
    return "the run continues"


def _step(run: Run) -> str:
    if not run.obstructed:  # otherwise the evaluation in flight is tried once more
        check_continues(run)
    run.steering.step("an operator makes single evaluations")
    count = run.steering.steps
    return f"{count} more evaluation{'s' if count > 1 else ''}, then a pause"


def _stop_after_this(run: Run) -> str:
    run.steering.request_stop()
    measuring = run.evaluating and not run.obstructed
    return f"the run ends {'after' if measuring else 'before'} evaluation {run.index}"
