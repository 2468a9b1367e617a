"""The tuner from a plain Python program: one object, whose calls block until the tuner has answered."""

from __future__ import annotations

import atexit
import time
from collections.abc import Callable, Mapping
from difflib import get_close_matches
from functools import partial
from queue import SimpleQueue
from types import TracebackType
from typing import Any

from action_msgs.srv import CancelGoal
from rcl_interfaces.srv import GetParameters, ListParameters, SetParametersAtomically
from rclpy.executors import Executor
from rclpy.node import Node
from rclpy.parameter import Parameter, parameter_value_to_python
from std_srvs.srv import Trigger

from mobo_msgs_py.action import GoToWorkingPoint, Tune
from mobo_msgs_py.srv import Ask, ForgetEvaluation, ListWorkingPoints, QueueSetpoint, Tell
from mobo_tuner.client.connection import ACTIONS, Connection, Inbox
from mobo_tuner.client.follower import (
    Follower,
    OnEvaluation,
    OnFront,
    OnProblem,
    OnStatus,
)
from mobo_tuner.client.values import (
    Arrival,
    ErrorCode,
    Evaluation,
    Movement,
    RunResult,
    Status,
    Suggestion,
    TunerError,
    WorkingPoints,
    count,
    evaluation_of,
    front_of,
    named,
    number,
    parameter_value,
    point_of,
    status_of,
    units_of,
)
from mobo_tuner.ros.conversions import values_of
from mobo_tuner.runs.records import SOURCES
from mobo_tuner.runs.run_id import new_run_id

TIMEOUT = 10.0  # [s] for the tuner to appear, and to answer what is quick
LONG_TIMEOUT = 300.0  # [s] for answers that take a suggestion or a predicted front
CATCH_UP = 1.0  # [s] for evaluations that come after the result of their run

# Both actions number their errors in the same way.
_CODES = {
    Tune.Result.INVALID_GOAL: ErrorCode.INVALID_GOAL,
    Tune.Result.MACHINE_UNAVAILABLE: ErrorCode.MACHINE_UNAVAILABLE,
    Tune.Result.MACHINE_LOST: ErrorCode.MACHINE_LOST,
    Tune.Result.MACHINE_ERROR: ErrorCode.MACHINE_ERROR,
    Tune.Result.CANCELED: ErrorCode.CANCELED,
}

OnMovement = Callable[[Movement], object]


class TunerClient:
    """A client of one tuner.

    Calls block until the tuner has answered, and raise `TunerError` with its own sentence where it
    refuses. They may come from any thread but the executor's. Callbacks run on the thread that waits
    for them, so that they may call the client; an error in one cancels the active goal.

    Several clients can be used at a time, also of several tuners, in one program or in many. As a
    context manager a client cancels, at its end, the run or the move that it asked for.

    Example:
        With a tuner and a machine in the ROS domain of the environment:

        >>> from mobo_tuner.client import TunerClient
        >>> indices = []
        >>> with TunerClient() as client:
        ...     client.set({"variables.x1.max": 1.5})
        ...     result = client.tune(evaluations=8, on_evaluation=lambda e: indices.append(e.index))
        ...     best = min(result.front.points, key=lambda point: point.objectives["f1"])
        ...     arrival = client.go(best.index)
        >>> result.stop_reason, indices, arrival.point.index == best.index
        ('budget', [0, 1, 2, 3, 4, 5, 6, 7], True)

    Args:
        namespace: Namespace of the tuner, relative to that of the node.
        domain_id: ROS domain of the tuner; None for that of the environment. Not used with `node`.
        node: Node to use; None for one of its own, on an executor and thread of its own.
        executor: Executor that spins `node`; None for the one to which it was added.
        timeout: Time for the tuner to appear, and to answer what is quick [s].
    """

    def __init__(
        self,
        namespace: str = "",
        *,
        domain_id: int | None = None,
        node: Node | None = None,
        executor: Executor | None = None,
        timeout: float = TIMEOUT,
    ) -> None:
        self._connection = Connection(
            namespace, domain_id=domain_id, node=node, executor=executor, timeout=timeout
        )
        atexit.register(self.close)

    # ------------------------------------------------------------------ begin and end

    def __enter__(self) -> TunerClient:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    def connect(self, timeout: float | None = None) -> None:
        """Wait until the tuner exists; every other call does so too.

        Args:
            timeout: Longest wait [s]; None for that of the client.

        Raises:
            TunerError: If no tuner is found.
        """
        self._connection.connect(timeout)

    def close(self) -> None:
        """Cancel the active goals of this client, and release everything."""
        atexit.unregister(self.close)
        self._connection.close()

    # ------------------------------------------------------------------ a run

    def tune(
        self,
        *,
        evaluations: int = 0,
        hypervolume_goal: float = 0.0,
        run_id: str = "",
        resume_from: str = "",
        on_evaluation: OnEvaluation | None = None,
        on_status: OnStatus | None = None,
        on_front: OnFront | None = None,
        on_problem: OnProblem | None = None,
    ) -> RunResult:
        """Tune the machine, and wait until the run has ended.

        A run that is canceled or fails also has a result, which contains the error. Ctrl-C and an error
        in a callback cancel the run and are raised after its end.

        Args:
            evaluations: Budget; 0 = that of the resumed run, or else the tuner's parameter.
            hypervolume_goal: Hypervolume at which the run ends; 0 = the tuner's parameter.
            run_id: Id of the run; empty = the time.
            resume_from: Id of the run to resume; empty = none.
            on_evaluation: Function that receives every evaluation once, also those of the resumed run.
            on_status: Function that receives the tuner's status after each change and at 1 Hz.
            on_front: Function that receives the Pareto front after each change.
            on_problem: Function that receives the problem at the start and after each change.

        Raises:
            TunerError: If there is no tuner, it refuses the run, or it falls silent.
        """
        goal = Tune.Goal(
            run_id=run_id or new_run_id("run"),
            evaluations=count(evaluations, "evaluations"),
            hypervolume_goal=number(hypervolume_goal, "hypervolume_goal"),
            resume_from=resume_from,
        )
        follower = Follower(goal.run_id, on_evaluation, on_status, on_front, on_problem)
        with self._connection.listening(follower):
            result = self._connection.pursue(
                "tune",
                goal,
                follower.inbox,
                lambda feedback: follower.take("evaluation", feedback.evaluation),
            )
            self._catch_up(follower, result.evaluations)
        error = _error(result)
        if error is not None and error.code == ErrorCode.INVALID_GOAL:
            raise error
        return RunResult(
            run_id=goal.run_id,
            front=front_of(result.pareto_front),
            evaluations=result.evaluations,
            stop_reason=result.stop_reason,
            error=error,
        )

    def start(self, *, evaluations: int = 0, run_id: str = "", resume_from: str = "") -> str:
        """Start a run that belongs to nobody: it goes on when this client is closed.

        Args:
            evaluations: Budget; 0 = that of the resumed run, or else the tuner's parameter.
            run_id: Id of the run; empty = the time.
            resume_from: Id of the run to resume; empty = none.

        Returns:
            The id of the run.

        Raises:
            TunerError: If there is no tuner, or it refuses the run.
        """
        goal = Tune.Goal(
            run_id=run_id or new_run_id("run"),
            evaluations=count(evaluations, "evaluations"),
            resume_from=resume_from,
        )
        result = self._connection.begin(
            "tune", goal, lambda: self._connection.status.run_id == goal.run_id
        )
        error = None if result is None else _error(result)
        if error is not None:
            raise error
        return goal.run_id

    def watch(
        self,
        *,
        on_evaluation: OnEvaluation | None = None,
        on_status: OnStatus | None = None,
        on_front: OnFront | None = None,
        on_problem: OnProblem | None = None,
    ) -> Status:
        """Follow the active run of any client; return its last status.

        Args:
            on_evaluation: Function that receives every evaluation once, also the earlier ones.
            on_status: Function that receives the tuner's status after each change and at 1 Hz.
            on_front: Function that receives the Pareto front after each change.
            on_problem: Function that receives the problem now and after each change.

        Raises:
            TunerError: If no run is active, or the tuner falls silent.
        """
        status = self.status()
        if not _is_running(status):
            raise TunerError(ErrorCode.REFUSED, "no run is active")
        follower = Follower(status.run_id, on_evaluation, on_status, on_front, on_problem)
        with self._connection.listening(follower):
            while _is_running(latest := self.status()) and latest.run_id == status.run_id:
                status = latest
                self._connection.serve(follower.inbox)
            if latest.run_id == status.run_id:
                status = latest
            self._catch_up(follower, status.evaluations)
        return status

    def cancel(self) -> None:
        """Cancel the run or move of this client, whose call returns after its end.

        It does not wait, and can be called from any thread.
        """
        self._connection.cancel()

    def cancel_any(self) -> bool:
        """Cancel the active run or move of any client.

        Returns:
            Whether there was one.

        Raises:
            TunerError: If the tuner does not answer.
        """
        # A request without an id and a time concerns all goals of the action.
        answers = [
            self._call(f"{action}/_action/cancel_goal", CancelGoal.Request()) for action in ACTIONS
        ]
        return any(answer.goals_canceling for answer in answers)

    # ------------------------------------------------------------------ steering

    def status(self) -> Status:
        """Return the status of the tuner.

        Raises:
            TunerError: If there is no tuner.
        """
        self._connection.connect()
        return status_of(self._connection.status)

    def pause(self) -> str:
        """Pause the run before its next evaluation; return the tuner's sentence.

        Raises:
            TunerError: If no run is active, or there is no tuner; this also applies to the next four.
        """
        return self._trigger("pause")

    def resume(self) -> str:
        """Continue a paused run; return the tuner's sentence."""
        return self._trigger("resume")

    def step(self) -> str:
        """Do one more evaluation, then pause; return the tuner's sentence."""
        return self._trigger("step")

    def skip(self) -> str:
        """End the current evaluation, which counts as failed; return the tuner's sentence."""
        return self._trigger("skip")

    def stop(self) -> str:
        """End the run after the current evaluation; return the tuner's sentence."""
        return self._trigger("stop_after_this")

    def queue(self, setpoint: Mapping[str, float]) -> int:
        """Add a set-point, which the run evaluates next.

        Args:
            setpoint: Every variable once, in its unit.

        Returns:
            The number of set-points in the queue.

        Raises:
            TunerError: If the tuner refuses it.
        """
        request = QueueSetpoint.Request(setpoint=named(setpoint, "the set-point"))
        return int(_agreed(self._call("queue_setpoint", request)).waiting)

    def forget(self, index: int, diagnostic: str = "") -> str:
        """Have an evaluation of the run count as never measured; return the tuner's sentence.

        Args:
            index: Index of the evaluation.
            diagnostic: Only diagnostic of it to withdraw; empty for all of it.

        Raises:
            TunerError: If no run is active, or it has no such evaluation or diagnostic.
        """
        return self._withdraw("forget", index, diagnostic)

    def unforget(self, index: int, diagnostic: str = "") -> str:
        """Have an evaluation that was withdrawn count again; arguments and errors as for `forget`."""
        return self._withdraw("unforget", index, diagnostic)

    def set(self, values: Mapping[str, Any] | None = None, /, **parameters: Any) -> None:
        """Set parameters of the tuner: all of them, or none.

        The active run applies them before its next evaluation; otherwise later runs apply them.

        Args:
            values: Values by full name, such as `{"variables.K1.max": 480.0}`.
            parameters: Values of parameters without a dot in their name, such as `evaluations=80`.

        Raises:
            TunerError: If the tuner refuses one of them; nothing is changed.
        """
        wanted = {**(values or {}), **parameters}
        request = SetParametersAtomically.Request(
            parameters=[
                Parameter(name, value=parameter_value(name, value)).to_parameter_msg()
                for name, value in wanted.items()
            ]
        )
        result = self._call("tuner/set_parameters_atomically", request).result
        if result.successful:
            return
        for name in wanted:
            self.get(name)  # a name that is unknown has a sentence of its own
        if "read-only parameter" in result.reason:  # the sentence is that of rclpy
            name = result.reason.rstrip(".").rpartition(" ")[2]
            raise TunerError(
                ErrorCode.REFUSED,
                f"{name} is read when the tuner starts: set it in the parameter file before",
            )
        raise TunerError(ErrorCode.REFUSED, result.reason)

    def get(self, name: str) -> Any:
        """Return the value of a parameter of the tuner; None if it is not set.

        Raises:
            TunerError: If the tuner has no such parameter.
        """
        values = self._call("tuner/get_parameters", GetParameters.Request(names=[name])).values
        if not values:
            known = self._call("tuner/list_parameters", ListParameters.Request()).result.names
            near = [one for one in known if one.endswith(f".{name}")]
            near = near or get_close_matches(name, known, n=1)
            meant = f"; did you mean '{near[0]}'?" if near else ""
            raise TunerError(ErrorCode.REFUSED, f"the tuner has no parameter '{name}'{meant}")
        value = parameter_value_to_python(values[0])
        return list(value) if hasattr(value, "tolist") else value

    # ------------------------------------------------------------------ working points

    def working_points(
        self, run_id: str = "", *, predict: bool = False, timeout: float = LONG_TIMEOUT
    ) -> WorkingPoints:
        """Return the Pareto front of a run.

        Args:
            run_id: Id of the run; empty = the last run.
            predict: Whether to predict the front too, which takes seconds.
            timeout: Longest wait [s].

        Raises:
            TunerError: If there is no such run, or it cannot be read.
        """
        request = ListWorkingPoints.Request(run_id=run_id, predict=predict)
        answer = _agreed(self._call("list_working_points", request, timeout))
        predicted = front_of(answer.predicted, predicted=True) if predict else None
        return WorkingPoints(front_of(answer.measured), predicted)

    def go(
        self,
        index: int | None = None,
        *,
        weights: Mapping[str, float] | None = None,
        before: bool = False,
        run_id: str = "",
        hold: int = 0,
        radius: float = 0.0,
        anyway: bool = False,
        measure: bool = False,
        on_feedback: OnMovement | None = None,
    ) -> Arrival:
        """Go to a point of a run, and wait until the machine has arrived.

        Ctrl-C and an error in the callback stop the machine where it is.

        Args:
            index: Index of an evaluation, on the front or not; None if one of the next two is given.
            weights: Weights of the objectives [1/unit]; the point of the front with the least sum is chosen.
            before: Whether to go where the machine was before the run.
            run_id: Id of the run; empty = the last run.
            hold: Number of evaluations to spend on holding a point of the front against drift.
            radius: Radius of that search as a fraction of each variable's range [1]; 0 = the default.
            anyway: Whether the point may be outside the bounds of now, or have violated a critical limit.
            measure: Whether to measure once there, to compare with what the point promises.
            on_feedback: Function that receives the progress.

        Raises:
            TunerError: If there is no such point, or the machine does not reach it.
        """
        if (index is not None) + (weights is not None) + before != 1:
            raise TunerError(
                ErrorCode.INVALID_VALUE, "give either the index of a point, or weights, or before"
            )
        # The run is always named: the last run may change between two calls.
        goal = GoToWorkingPoint.Goal(
            run_id=run_id or self.working_points().measured.run_id,
            hold_evaluations=count(hold, "hold"),
            radius=number(radius, "radius"),
            anyway=anyway,
            measure=measure,
        )
        if before:
            goal.choice = GoToWorkingPoint.Goal.BEFORE_RUN
        elif weights is None:
            goal.choice, goal.index = GoToWorkingPoint.Goal.BY_INDEX, count(index, "index")
        else:
            goal.choice = GoToWorkingPoint.Goal.BY_WEIGHTS
            goal.weights = named(weights, "the weight of")
        inbox: Inbox = SimpleQueue()

        def tell(feedback: Any) -> None:
            if on_feedback is not None:
                readbacks = values_of(feedback.readbacks)
                movement = Movement(feedback.phase, feedback.evaluations, readbacks)
                inbox.put(partial(on_feedback, movement))

        result = self._connection.pursue("go_to_working_point", goal, inbox, tell)
        error = _error(result)
        if error is not None:
            raise error
        return Arrival(
            run_id=result.run_id,
            point=point_of(result.point, evaluated=not before),
            readbacks=values_of(result.readbacks),
            units=units_of((*result.readbacks, *result.measured, *result.point.objectives)),
            evaluations=result.evaluations,
            measured=values_of(result.measured),
            remark=result.error_msg,
        )

    def hold(
        self,
        evaluations: int,
        index: int | None = None,
        *,
        weights: Mapping[str, float] | None = None,
        run_id: str = "",
        radius: float = 0.0,
        on_feedback: OnMovement | None = None,
    ) -> Arrival:
        """Go to a point of a Pareto front and hold it there against drift; see `go`."""
        return self.go(
            index,
            weights=weights,
            run_id=run_id,
            hold=evaluations,
            radius=radius,
            on_feedback=on_feedback,
        )

    # ------------------------------------------------------------------ a loop of one's own

    def ask(self, *, timeout: float = LONG_TIMEOUT) -> Suggestion:
        """Return the next set-point to measure; repeated calls return the same one.

        Raises:
            TunerError: If a run is active, or the tuner does not answer in time.
        """
        answer = _agreed(self._call("ask", Ask.Request(), timeout))
        return Suggestion(
            run_id=answer.run_id,
            index=answer.index,
            setpoint=values_of(answer.setpoint),
            source=SOURCES[answer.source],
        )

    def tell(
        self,
        where: Suggestion | Mapping[str, float],
        diagnostics: Mapping[str, float | tuple[float, float]],
        readbacks: Mapping[str, float] | None = None,
        *,
        timeout: float = LONG_TIMEOUT,
    ) -> Evaluation:
        """Add a measurement.

        Args:
            where: Suggestion that was followed, or another set-point.
            diagnostics: Means by name, or pairs (mean, standard deviation); NaN or missing = not
                measured.
            readbacks: Measured values of the variables, as far as known.
            timeout: Longest wait [s].

        Returns:
            The evaluation as it is recorded.

        Raises:
            TunerError: If the tuner refuses it; then nothing is added.
        """
        request = Tell.Request(
            diagnostics=named(diagnostics, "the diagnostic"),
            readbacks=named(readbacks or {}, "the readback"),
        )
        if isinstance(where, Suggestion):
            request.run_id, request.index = where.run_id, where.index
            where = where.setpoint
        request.setpoint = named(where, "the set-point")
        return evaluation_of(_agreed(self._call("tell", request, timeout)).evaluation)

    # ------------------------------------------------------------------ inside

    def _call(self, name: str, request: Any, timeout: float | None = None) -> Any:
        return self._connection.call(name, request, timeout)

    def _withdraw(self, name: str, index: int, diagnostic: str) -> str:
        request = ForgetEvaluation.Request(index=count(index, "index"), diagnostic=diagnostic)
        return str(_agreed(self._call(name, request)).message)

    def _trigger(self, name: str) -> str:
        return str(_agreed(self._call(name, Trigger.Request())).message)

    def _catch_up(self, follower: Follower, evaluations: int) -> None:
        """Pass on late evaluations and all remaining messages."""
        deadline = time.monotonic() + CATCH_UP
        while follower.lacks(evaluations) and time.monotonic() < deadline:
            self._connection.serve(follower.inbox)
        while not follower.inbox.empty():
            self._connection.serve(follower.inbox)


def _is_running(status: Status) -> bool:
    """Return whether a run is active."""
    return status.state not in ("idle", "moving", "unknown") and not status.stop_reason


def _agreed(answer: Any) -> Any:
    """Return the response of a successful service call.

    Raises:
        TunerError: If it was not successful.
    """
    if not answer.success:
        raise TunerError(ErrorCode.REFUSED, answer.message)
    return answer


def _error(result: Any) -> TunerError | None:
    """Return the error in the result of an action."""
    if result.error_code == Tune.Result.NONE:
        return None
    return TunerError(_CODES.get(result.error_code, ErrorCode.INTERNAL), result.error_msg)
