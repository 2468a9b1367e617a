"""Working points: the front as a list to choose from, and the way to a chosen point."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from rclpy.action import ActionServer, CancelResponse, GoalResponse
from rclpy.action.server import ServerGoalHandle
from rclpy.task import Future

from mobo_msgs_py import msg
from mobo_msgs_py.action import EvaluateSetpoint, GoToWorkingPoint
from mobo_msgs_py.srv import ListWorkingPoints
from mobo_tuner.core import ProblemError
from mobo_tuner.core.focus import choose_on_front
from mobo_tuner.core.hypervolume import hypervolume
from mobo_tuner.ros.conversions import named_values, unique_values
from mobo_tuner.tuner.context import TunerParts, sentence
from mobo_tuner.tuner.machine_client import MachineLostError
from mobo_tuner.tuner.messages import front_message, problem_units
from mobo_tuner.tuner.run.keeper import RunKeeper
from mobo_tuner.tuner.run.run import Run, RunError
from mobo_tuner.tuner.run.start import reopen_run
from mobo_tuner.tuner.services.holding import Holding
from mobo_tuner.tuner.session import Session, read_run

MAX_HOLD = 100_000  # evaluations
DEFAULT_RADIUS = 0.1
_CODES = GoToWorkingPoint.Result
NOTHING = "nothing was measured yet: there is no front, unless run_id names an earlier run"


class WorkingPoints:
    """Serves `list_working_points` and `go_to_working_point`.

    Args:
        parts: of the tuner's node.
        session: tells whose front it is, and is taken while the machine moves.
        keeper: sees the runs through that hold a point.
    """

    def __init__(self, parts: TunerParts, session: Session, keeper: RunKeeper) -> None:
        self._parts = parts
        self._session = session
        self._holding = Holding(parts, keeper)
        self._interrupt: Future | None = None  # of the move that goes on
        self._goal_id = b""
        parts.node.create_service(ListWorkingPoints, "list_working_points", self._list)
        self._server = ActionServer(
            parts.node,
            GoToWorkingPoint,
            "go_to_working_point",
            execute_callback=self._execute,
            goal_callback=lambda _: GoalResponse.ACCEPT,  # refused with a reason in `_execute`
            cancel_callback=self._cancel,
            result_timeout=10,
        )

    def stop(self, reason: str) -> None:
        """End the move or the holding that goes on; the machine holds where it is."""
        if self._interrupt is not None and not self._interrupt.done():
            self._interrupt.set_result(reason)

    async def _list(
        self, request: ListWorkingPoints.Request, response: ListWorkingPoints.Response
    ) -> ListWorkingPoints.Response:
        try:
            run = await self._run(request.run_id)
        except (ValueError, OSError) as error:
            response.message = str(error)
            return response
        response.measured = run.front(self._parts.now())
        if request.predict:
            try:
                front, volume = await self._parts.worker.submit(_predict, run)
            except Exception as error:  # none of a run's concern
                response.message = sentence(error)
                return response
            if not front:
                response.message = "the models predict no point that is feasible and good enough"
                return response
            response.predicted = front_message(
                run.problem, front, volume, run.run_id, self._parts.now()
            )
        response.success = True
        return response

    # ------------------------------------------------------------------ going there

    def _cancel(self, goal_handle: ServerGoalHandle) -> CancelResponse:
        if bytes(goal_handle.goal_id.uuid) == self._goal_id:
            self.stop("a client canceled it")
        return CancelResponse.ACCEPT

    async def _execute(self, goal_handle: ServerGoalHandle) -> GoToWorkingPoint.Result:
        result = GoToWorkingPoint.Result(error_code=_CODES.NONE)
        try:
            choice = await self._choose(goal_handle.request)
        except (ValueError, OSError) as error:
            self._parts.log.warning(f"goal refused: {error}")
            result.error_code, result.error_msg = _CODES.INVALID_GOAL, str(error)
            goal_handle.abort()
            return result
        self._session.moving = True
        self._goal_id = bytes(goal_handle.goal_id.uuid)
        self._interrupt = Future(executor=self._parts.node.executor)
        if goal_handle.is_cancel_requested:
            self._cancel(goal_handle)
        result.point = choice.point
        try:
            await self._go_and_hold(choice, goal_handle, result)
        except RunError as error:
            result.error_code, result.error_msg = error.code, str(error)
        except Exception as error:
            result.error_code, result.error_msg = _CODES.INTERNAL, sentence(error)
        finally:
            self._session.moving = False
            self._interrupt = None
            self._parts.status.set(
                state=msg.TunerStatus.IDLE, phase="", fraction=0.0, message=result.error_msg
            )
        if result.error_code == _CODES.NONE:
            goal_handle.succeed()
            return result
        self._parts.log.warning(f"the way to a working point ends: {result.error_msg}")
        if goal_handle.is_cancel_requested:
            goal_handle.canceled()
        else:
            goal_handle.abort()
        return result

    async def _run(self, run_id: str) -> Run:
        """The run whose front is meant; an earlier one is read, and is the latest from then on.

        Raises:
            ValueError, OSError: there is none, or it cannot be read, with the reason.
        """
        latest = self._session.latest
        if latest is not None and run_id in ("", latest.run_id):
            return latest
        if not run_id:
            raise ValueError(NOTHING)
        if self._session.occupied:
            raise ValueError(self._session.occupied)
        earlier = await read_run(self._parts, self._session, run_id)
        interrupt = Future(executor=self._parts.node.executor)
        self._session.latest = run = reopen_run(earlier, interrupt)
        return run

    async def _choose(self, goal: GoToWorkingPoint.Goal) -> Choice:
        """Check a goal.

        Raises:
            ValueError, OSError: it cannot be served, with the reason.
        """
        if self._session.occupied:
            raise ValueError(self._session.occupied)
        if goal.hold_evaluations > MAX_HOLD:
            raise ValueError(
                f"hold_evaluations is {goal.hold_evaluations}; at most {MAX_HOLD} are allowed"
            )
        radius = goal.radius or DEFAULT_RADIUS
        if not 0.0 < radius <= 1.0:
            raise ValueError(f"radius is {radius:g}; 0 to 1 is allowed")
        run = await self._run(goal.run_id)
        index, weights = None, None
        if goal.choice == GoToWorkingPoint.Goal.BY_INDEX:
            index = goal.index
        elif goal.choice == GoToWorkingPoint.Goal.BY_WEIGHTS:
            weights = dict.fromkeys(run.problem.objective_names, 0.0)
            weights |= unique_values("the list of weights", goal.weights)
        else:
            raise ValueError(f"choice is {goal.choice}; BY_INDEX and BY_WEIGHTS are allowed")
        front = run.optimizer.pareto_front()
        setpoint, sums = choose_on_front(run.problem, front, index, weights)
        message = run.front(self._parts.now())
        chosen = next(
            point
            for point, known in zip(message.points, front, strict=True)
            if known["setpoint"] == setpoint
        )
        return Choice(run, chosen, setpoint, sums, goal.hold_evaluations, radius)

    async def _go_and_hold(
        self,
        choice: Choice,
        goal_handle: ServerGoalHandle,
        result: GoToWorkingPoint.Result,
    ) -> None:
        await self._meet_machine(choice.run)
        await self._move(choice.run, choice.setpoint, goal_handle, result)
        if not choice.hold_evaluations:
            return
        assert self._interrupt is not None

        def tell(evaluations: int) -> None:
            result.evaluations = evaluations
            goal_handle.publish_feedback(
                GoToWorkingPoint.Feedback(phase="measuring", evaluations=evaluations)
            )

        best = await self._holding.hold(
            choice.run,
            choice.point.index,
            choice.weights,
            choice.radius,
            choice.hold_evaluations,
            self._interrupt,
            tell,
        )
        await self._move(choice.run, best, goal_handle, result)

    async def _meet_machine(self, run: Run) -> None:
        parts = self._parts
        assert self._interrupt is not None
        parts.status.set(state=msg.TunerStatus.WAITING, message="")
        try:
            machine = await parts.machine.describe(
                parts.parameters["discovery_timeout"], self._interrupt
            )
            if machine is not None:
                run.meet(machine)
        except (MachineLostError, ProblemError) as error:
            raise RunError(_CODES.MACHINE_UNAVAILABLE, str(error)) from None
        self._check_interrupt()

    async def _move(
        self,
        run: Run,
        setpoint: Mapping[str, float],
        goal_handle: ServerGoalHandle,
        result: GoToWorkingPoint.Result,
    ) -> None:
        """Go to a set-point, ramped and verified.

        Raises:
            RunError: the machine did not get there.
        """
        parts = self._parts
        assert self._interrupt is not None
        parts.status.set(state=msg.TunerStatus.MOVING, phase="", fraction=0.0)

        def on_feedback(feedback: Any) -> None:
            parts.status.set(publish=False, phase=feedback.phase, fraction=feedback.fraction)
            goal_handle.publish_feedback(
                GoToWorkingPoint.Feedback(
                    phase=feedback.phase,
                    evaluations=result.evaluations,
                    readbacks=list(feedback.readbacks),
                )
            )

        units = problem_units(run.problem)
        try:
            answer = await parts.machine.apply(
                named_values(setpoint, units), on_feedback, self._interrupt
            )
        except MachineLostError as error:
            raise RunError(_CODES.MACHINE_LOST, str(error)) from None
        result.readbacks = named_values(answer.readbacks, units)
        self._check_interrupt()
        if answer.error_code == EvaluateSetpoint.Result.MACHINE_LOST:
            raise RunError(_CODES.MACHINE_LOST, answer.error_msg)
        if answer.error_code != EvaluateSetpoint.Result.NONE:
            raise RunError(_CODES.MACHINE_ERROR, answer.error_msg)

    def _check_interrupt(self) -> None:
        assert self._interrupt is not None
        if self._interrupt.done():
            raise RunError(_CODES.CANCELED, f"it was stopped: {self._interrupt.result()}")


class Choice(NamedTuple):
    """A goal that was understood."""

    run: Run
    point: msg.ParetoPoint
    setpoint: dict[str, float]
    weights: tuple[float, ...]
    hold_evaluations: int
    radius: float


def _predict(run: Run) -> tuple[list[dict[str, Any]], float]:
    """The predicted front and its hypervolume; made for the worker thread."""
    front = run.optimizer.predicted_front()
    objectives = run.problem.objectives
    points = np.array([[p["objectives"][o.name] * o.sign for o in objectives] for p in front])
    return front, hypervolume(points, run.problem.reference_point) if front else 0.0
