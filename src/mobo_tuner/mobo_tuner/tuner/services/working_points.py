"""Working points: the front as a list to choose from, and the way to a point of a run."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from rclpy.task import Future

from mobo_msgs_py import msg
from mobo_msgs_py.action import EvaluateSetpoint, GoToWorkingPoint
from mobo_msgs_py.srv import ListWorkingPoints
from mobo_tuner.core import ProblemError
from mobo_tuner.core.focus import around, choose_on_front
from mobo_tuner.core.hypervolume import hypervolume
from mobo_tuner.ros import interfaces
from mobo_tuner.ros.action_server import Goal
from mobo_tuner.ros.conversions import named_values, unique_values, values_of
from mobo_tuner.tuner.context import TunerContext, describe
from mobo_tuner.tuner.gate import BoundsError, EvaluationRequest, Target, check_bounds
from mobo_tuner.tuner.machine_client import MachineLostError
from mobo_tuner.tuner.messages import constraint_messages, evaluated_point, front_message
from mobo_tuner.tuner.run.loop import RunLoop
from mobo_tuner.tuner.run.moves import approached, keep_move, keep_state
from mobo_tuner.tuner.run.run import Run, RunError
from mobo_tuner.tuner.run.start import read_earlier, reopen_run
from mobo_tuner.tuner.services.holding import Holding
from mobo_tuner.tuner.session import Session

MAX_HOLD = 100_000  # evaluations
DEFAULT_RADIUS = 0.1
_CODES = GoToWorkingPoint.Result
_NOTHING = "no run has begun here, so that there is no front; name an earlier run (--run ID)"


class WorkingPoints:
    """Serves `list_working_points` and `go_to_working_point`.

    Args:
        context: The tuner's node and what works in it.
        session: Session that knows the latest run, and is occupied while the machine moves.
        loop: Carries out the runs that hold a point.
    """

    def __init__(self, context: TunerContext, session: Session, loop: RunLoop) -> None:
        self._context = context
        self._session = session
        self._holding = Holding(context, loop)
        self._interrupt: Future | None = None  # of the move that is being made
        self._reopened: Run | None = None  # the earlier run that was read last
        interfaces.LIST_WORKING_POINTS.server(context.node, self._list)
        self._server = interfaces.GO_TO_WORKING_POINT.server(context.node, self._execute)

    def stop(self, reason: str) -> None:
        """End the move or the holding; the machine holds where it is."""
        if self._interrupt is not None and not self._interrupt.done():
            self._interrupt.set_result(reason)

    async def _list(
        self, request: ListWorkingPoints.Request, response: ListWorkingPoints.Response
    ) -> ListWorkingPoints.Response:
        try:
            run = await self._find(request.run_id)
        except (ValueError, OSError) as error:
            response.message = str(error)
            return response
        response.measured = run.front_message(self._context.now())
        if request.predict:
            try:
                front, volume = await self._context.worker.submit(_predict, run)
            except Exception as error:  # the client is told; the node goes on
                response.message = describe(error)
                return response
            if not front:
                response.message = "the models predict no point that is feasible and good enough"
                return response
            response.predicted = front_message(
                run.problem, front, (volume, math.nan), run.run_id, self._context.now()
            )
        response.success = True
        return response

    # ------------------------------------------------------------------ going there

    async def _execute(self, goal: Goal) -> GoToWorkingPoint.Result:
        result = GoToWorkingPoint.Result()
        try:
            choice = await self._choose(goal.request)
        except (ValueError, OSError) as error:
            result.error_code, result.error_msg = _CODES.INVALID_GOAL, str(error)
            return result
        result.run_id, result.point = choice.run.run_id, choice.place.point
        self._interrupt = self._context.future()
        goal.on_cancel(lambda: self.stop("a client canceled it"))
        with self._session.moving():
            try:
                await self._go_and_hold(choice, self._interrupt, goal, result)
            except RunError as error:
                result.error_code, result.error_msg = error.code, str(error)
            except Exception as error:  # the client is told; the node goes on
                result.error_code, result.error_msg = _CODES.INTERNAL, describe(error)
            finally:
                self._interrupt = None
        self._context.status.work(msg.TunerStatus.IDLE, result.error_msg)
        return result

    async def _find(self, run_id: str) -> Run:
        """Return the run whose front is meant, read from its folder if necessary.

        Reading an earlier run does not make it the latest: a query changes nothing.

        Raises:
            ValueError, OSError: If there is none, or it cannot be read, with the reason.
        """
        for known in (self._session.latest, self._reopened):
            if known is not None and run_id == known.run_id:
                return known
        if not run_id:
            if self._session.latest is None:
                raise ValueError(_NOTHING)
            return self._session.latest
        self._session.check_free()
        earlier = await read_earlier(self._context, self._session, run_id)
        folder = self._context.parameters.run_dir(run_id)
        self._reopened = reopen_run(earlier, self._context.future(), folder)
        return self._reopened

    async def _choose(self, request: GoToWorkingPoint.Goal) -> Choice:
        """Check a goal.

        Raises:
            ValueError, OSError: If it cannot be served, with the reason.
        """
        self._session.check_free()
        if request.hold_evaluations > MAX_HOLD:
            raise ValueError(
                f"hold_evaluations is {request.hold_evaluations}; at most {MAX_HOLD} are allowed"
            )
        radius = request.radius or DEFAULT_RADIUS
        if not 0.0 < radius <= 1.0:
            raise ValueError(f"radius is {radius:g}; 0 to 1 is allowed")
        run = await self._find(request.run_id)
        place = self._place(run, request)
        if request.hold_evaluations and place.index not in _on_front(run):
            raise ValueError(
                f"only a point of the front can be held, and {place.name} is not one "
                f"(hold_evaluations is {request.hold_evaluations})"
            )
        target = Target(place.setpoint, anyway=request.anyway)
        self._check(run, target, place, request.hold_evaluations)
        if request.hold_evaluations:
            around(run.problem, target.setpoint, radius, self._context.gate.bounds)
        return Choice(run, place, target, request.hold_evaluations, radius, request.measure)

    def _place(self, run: Run, request: GoToWorkingPoint.Goal) -> Place:
        """Return the place that a goal means.

        Raises:
            ValueError: If there is none.
        """
        units = run.problem.units
        if request.choice == GoToWorkingPoint.Goal.BY_WEIGHTS:
            weights = dict.fromkeys(run.problem.objective_names, 0.0)
            weights |= unique_values("the list of weights", request.weights)
            setpoint, sums = choose_on_front(run.problem, list(run.found.front), None, weights)
            index = next(p["index"] for p in run.found.front if p["setpoint"] == setpoint)
            return replace(self._evaluated(run, index), weights=sums)
        if request.choice == GoToWorkingPoint.Goal.BY_INDEX:
            if request.index >= run.index:
                known = (
                    f"0 to {run.index - 1} are allowed"
                    if run.index
                    else "it has none; name an earlier run (--run ID)"
                )
                raise ValueError(
                    f"index is {request.index}, of an evaluation of run '{run.run_id}'; {known}"
                )
            return self._evaluated(run, request.index)
        if request.choice != GoToWorkingPoint.Goal.BEFORE_RUN:
            allowed = "BY_INDEX, BY_WEIGHTS and BEFORE_RUN are allowed"
            raise ValueError(f"choice is {request.choice}; {allowed}")
        if run.state_before is None:
            raise ValueError(f"the state before run '{run.run_id}' is unknown")
        setpoint = self._context.gate.settled(run.state_before)
        point = msg.ParetoPoint(setpoint=named_values(setpoint, units))
        return Place("the state before the run", setpoint, point)

    def _evaluated(self, run: Run, index: int) -> Place:
        """Return the place of an evaluation, on the front or not."""
        record = run.records[index][1]
        if index in _on_front(run):
            points = run.front_message(self._context.now()).points
            point = next(point for point in points if point.index == index)
            _, sums = choose_on_front(run.problem, list(run.found.front), index, None)
        else:
            point, sums = evaluated_point(run.problem, record), ()
        return Place(f"point {index}", dict(record.setpoint), point, index, sums)

    def _check(self, run: Run, target: Target, place: Place, hold_evaluations: int) -> None:
        """Check that the machine may go to a place, and search around it if it is to be held there.

        Raises:
            BoundsError: If not.
        """
        try:
            self._context.gate.check(target)
            if hold_evaluations:
                check_bounds(self._context.gate.bounds, target.setpoint)
        except BoundsError as error:
            advice = "widen the bounds to hold it" if target.anyway else "'anyway' goes there"
            raise BoundsError(f"{place.name} is out of bounds: {error}; {advice}") from None
        if place.index is None or target.anyway:
            return
        record = run.records[place.index][1]
        if record.error_code == EvaluateSetpoint.Result.VIOLATION:
            raise BoundsError(
                f"{place.name} violated a critical limit: {record.error_msg}; 'anyway' goes there"
            )

    async def _go_and_hold(
        self, choice: Choice, interrupt: Future, goal: Goal, result: GoToWorkingPoint.Result
    ) -> None:
        await self._meet_machine(choice.run, interrupt)
        target, index = choice.target, choice.place.index
        if index is not None:
            target = approached(target, choice.run, index, self._context.gate)
        await self._move(choice, target, index, interrupt, goal, result)
        if choice.measure:
            await self._measure(choice, interrupt, goal, result)
        if not choice.hold_evaluations or index is None:
            return

        def count(evaluations: int) -> None:
            result.evaluations = evaluations
            goal.publish_feedback(phase="measuring", evaluations=evaluations)

        held, best = await self._holding.hold(
            choice.run,
            index,
            choice.place.weights,
            choice.radius,
            choice.hold_evaluations,
            interrupt,
            count,
        )
        target = Target(dict(held.records[best][1].setpoint))
        target = approached(target, held, best, self._context.gate)
        await self._move(choice, target, None, interrupt, goal, result)

    async def _meet_machine(self, run: Run, interrupt: Future) -> None:
        """Check that the machine is there and suits the run.

        Raises:
            RunError: If it is not or does not.
        """
        context = self._context
        context.status.work(msg.TunerStatus.WAITING, "")
        try:
            machine = await context.gate.describe(context.parameters.discovery_timeout, interrupt)
            if machine is not None:
                run.meet(machine)
        except (MachineLostError, ProblemError) as error:
            raise RunError(_CODES.MACHINE_UNAVAILABLE, str(error)) from None
        _check(interrupt)

    async def _move(
        self,
        choice: Choice,
        target: Target,
        evaluation: int | None,
        interrupt: Future,
        goal: Goal,
        result: GoToWorkingPoint.Result,
    ) -> None:
        """Go to a target, ramped and verified; keep what was asked and where it ended.

        Raises:
            RunError: If the machine did not arrive.
        """
        context, run = self._context, choice.run
        purpose = "restore" if choice.place.index is None else "go"
        purpose = "hold" if choice.hold_evaluations else purpose
        try:
            keep_move(context, run, target, purpose, "operator", evaluation)
        except OSError as error:
            raise RunError(_CODES.INVALID_GOAL, str(error)) from None
        if target.straight:
            self._remark(result, f"the machine went straight to the point: {target.straight}")
        try:
            await self._ramp(run, target, interrupt, goal, result)
        except RunError as error:
            keep_state(context, run, values_of(result.readbacks), str(error))
            raise
        keep_state(context, run, values_of(result.readbacks))

    async def _ramp(
        self,
        run: Run,
        target: Target,
        interrupt: Future,
        goal: Goal,
        result: GoToWorkingPoint.Result,
    ) -> None:
        """Go to a target, ramped and verified.

        Raises:
            RunError: If the machine did not arrive.
        """
        context = self._context
        context.status.work(msg.TunerStatus.MOVING, "")

        def on_feedback(feedback: Any) -> None:
            context.status.progress(feedback.phase, feedback.fraction)
            goal.publish_feedback(
                phase=feedback.phase,
                evaluations=result.evaluations,
                readbacks=list(feedback.readbacks),
            )

        units, result.readbacks = run.problem.units, []
        try:
            answer = await context.gate.move(target, units, on_feedback, interrupt)
        except BoundsError as error:
            raise RunError(_CODES.INVALID_GOAL, str(error)) from None
        except MachineLostError as error:
            raise RunError(_CODES.MACHINE_LOST, str(error)) from None
        result.readbacks = named_values(answer.readbacks, units)
        _check(interrupt)
        if answer.error_code == EvaluateSetpoint.Result.MACHINE_LOST:
            raise RunError(_CODES.MACHINE_LOST, answer.error_msg)
        if answer.error_code != EvaluateSetpoint.Result.NONE:
            raise RunError(_CODES.MACHINE_ERROR, answer.error_msg)

    async def _measure(
        self, choice: Choice, interrupt: Future, goal: Goal, result: GoToWorkingPoint.Result
    ) -> None:
        """Measure once where the machine is; a failure leaves the result without a measurement.

        Raises:
            RunError: If the goal was canceled.
        """
        context, units = self._context, choice.run.problem.units
        request = EvaluationRequest(
            run_id="",
            index=0,
            attempt=0,
            setpoint=choice.target.setpoint,
            shots=context.parameters.shots,
            critical=constraint_messages(context.gate.bounds, critical_only=True),
            anyway=choice.target.anyway,
        )

        def on_feedback(feedback: Any) -> None:
            context.status.progress(feedback.phase, feedback.fraction)
            goal.publish_feedback(phase=feedback.phase, readbacks=list(feedback.readbacks))

        try:
            answer = await context.gate.evaluate(request, units, on_feedback, interrupt)
        except MachineLostError as error:
            raise RunError(_CODES.MACHINE_LOST, str(error)) from None
        _check(interrupt)
        if answer.error_code != EvaluateSetpoint.Result.NONE:
            self._remark(result, f"{choice.place.name} was not measured: {answer.error_msg}")
            return
        means = {name: mean for name, (mean, _) in answer.diagnostics.items()}
        stddevs = {name: stddev for name, (_, stddev) in answer.diagnostics.items()}
        result.measured = named_values(means, units, stddevs)

    def _remark(self, result: GoToWorkingPoint.Result, text: str) -> None:
        """Say what did not happen as it should, in the log and in the result of a move that succeeds."""
        self._context.log.warning(text)
        result.error_msg = f"{result.error_msg}; {text}" if result.error_msg else text


@dataclass(frozen=True)
class Place:
    """Where the machine can be sent.

    Attributes:
        name: Name for people.
        setpoint: Set-point.
        point: The same as a message, with what is promised there.
        index: Index of its evaluation; None for the state before the run.
        weights: Weights of the minimised objectives, with which it is held; empty off the front.
    """

    name: str
    setpoint: dict[str, float]
    point: msg.ParetoPoint
    index: int | None = None
    weights: tuple[float, ...] = ()


class Choice(NamedTuple):
    """A goal that was checked."""

    run: Run
    place: Place
    target: Target
    hold_evaluations: int
    radius: float
    measure: bool


def _on_front(run: Run) -> set[int]:
    """Return the indices of the evaluations on the front of a run."""
    return {point["index"] for point in run.found.front}


def _check(interrupt: Future) -> None:
    """Raise RunError if the move was interrupted."""
    if interrupt.done():
        raise RunError(_CODES.CANCELED, f"it was stopped: {interrupt.result()}")


def _predict(run: Run) -> tuple[list[dict[str, Any]], float]:
    """Return the predicted front and its hypervolume; made for the worker thread."""
    front = run.optimizer.predicted_front()
    objectives = run.problem.objectives
    points = np.array([[p["objectives"][o.name] * o.sign for o in objectives] for p in front])
    return front, hypervolume(points, run.problem.reference_point) if front else 0.0
