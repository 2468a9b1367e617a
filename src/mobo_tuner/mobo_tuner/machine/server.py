"""What every machine's node serves: it describes itself, evaluates set-points and goes to them.

Nothing moves before all of a goal is checked, and a goal that cannot be served is aborted with a
reason. One thing is done at a time. What ends an evaluation early (a cancel, a critical limit, a
lost client, a stopped node) makes the machine hold at once, and go, ramped, to where the goal says.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from typing import Any

from rclpy.action import ActionServer, CancelResponse, GoalResponse
from rclpy.action.server import ServerGoalHandle
from rclpy.clock import Clock, ClockType
from rclpy.executors import Executor
from rclpy.node import Node

from mobo_msgs_py import msg
from mobo_msgs_py.action import ApplySetpoint, EvaluateSetpoint
from mobo_msgs_py.srv import DescribeMachine
from mobo_tuner.machine.backend import (
    RAMPING,
    Failure,
    MachineBackend,
    Measurement,
    Operation,
)
from mobo_tuner.machine.client_watch import ClientWatch, FinishedEvaluations
from mobo_tuner.machine.goal_checks import check_evaluation, check_setpoint
from mobo_tuner.ros.conversions import values_of
from mobo_tuner.ros.qos import STREAM
from mobo_tuner.ros.waiting import until

FEEDBACK_PERIOD = 0.2  # [s] of wall time
RESULT_TIMEOUT = 10  # [s] for which a result can be asked for
STOP_TIMEOUT = 1.0  # [s] for what goes on to end
_Result = EvaluateSetpoint.Result
_BUSY = Failure(_Result.BUSY, "another evaluation or move is going on; one at a time is allowed")


class MachineServer:
    """Serves `evaluate_setpoint`, `apply_setpoint` and `describe_machine`, and hears `heartbeat`.

    Args:
        node: whose names these are; not spun yet, or spun by `executor`.
        backend: the machine.
        executor: on which everything runs, the backend's coroutines included.
    """

    def __init__(self, node: Node, backend: MachineBackend, executor: Executor) -> None:
        self._node = node
        self._backend = backend
        self._executor = executor
        self._operation: Operation | None = None  # what the machine does now
        self._handle: ServerGoalHandle | None = None  # of the goal that it serves
        self._stopped: Failure | None = None
        self._watch = ClientWatch()
        self._finished = FinishedEvaluations()
        self._service = node.create_service(DescribeMachine, "describe_machine", self._describe)
        self._heartbeats = node.create_subscription(
            msg.Heartbeat, "heartbeat", self._hear_heartbeat, STREAM
        )
        self._servers = [
            ActionServer(
                node,
                action,
                name,
                execute_callback=execute,
                goal_callback=lambda _: GoalResponse.ACCEPT,  # refused with a reason by `execute`
                cancel_callback=self._cancel,
                result_timeout=RESULT_TIMEOUT,
            )
            for action, name, execute in (
                (EvaluateSetpoint, "evaluate_setpoint", self._evaluate),
                (ApplySetpoint, "apply_setpoint", self._apply),
            )
        ]
        # Of a steady clock: neither silence nor a client's life is a matter of simulated time.
        self._timer = node.create_timer(
            FEEDBACK_PERIOD, self._tick, clock=Clock(clock_type=ClockType.STEADY_TIME)
        )

    @property
    def busy(self) -> bool:
        """Whether the machine moves or measures."""
        return self._operation is not None

    def interrupt(self, failure: Failure) -> None:
        """End what goes on, if anything does, for this reason; the machine holds where it is."""
        if self._operation is not None:
            self._operation.stop(failure)

    async def stop(self) -> None:
        """End what goes on, so that its client hears of it, and refuse everything from now on."""
        self._stop()
        await until(self._node, lambda: not self.busy, timeout=STOP_TIMEOUT)

    def close(self) -> None:
        """Serve no more; the node stays."""
        self._stop()
        self._node.destroy_timer(self._timer)
        for server in self._servers:
            server.destroy()
        self._node.destroy_subscription(self._heartbeats)
        self._node.destroy_service(self._service)

    def _stop(self) -> None:
        self._stopped = Failure(_Result.MACHINE_LOST, "the machine's node was stopped")
        self._watch.end()
        self.interrupt(self._stopped)

    def _describe(
        self, _: DescribeMachine.Request, response: DescribeMachine.Response
    ) -> DescribeMachine.Response:
        response.name = self._backend.name
        response.variables = list(self._backend.variables)
        response.diagnostics = list(self._backend.diagnostics)
        return response

    def _cancel(self, goal_handle: ServerGoalHandle) -> CancelResponse:
        if self._handle is not None and self._handle.goal_id == goal_handle.goal_id:
            self.interrupt(Failure(_Result.CANCELED, "a client stopped the machine"))
        return CancelResponse.ACCEPT

    async def _evaluate(self, goal_handle: ServerGoalHandle) -> EvaluateSetpoint.Result:
        """Serve one goal of `evaluate_setpoint`."""
        started = time.perf_counter()
        goal = goal_handle.request
        result = _Result(run_id=goal.run_id, index=goal.index, attempt=goal.attempt)
        try:
            setpoint = check_evaluation(
                goal, self._backend.variables, self._backend.diagnostics, self._backend.max_shots
            )
        except ValueError as error:
            failure: Failure | None = Failure(_Result.INVALID_SETPOINT, str(error))
        else:
            failure = self._refusal() or self._old(goal)
            if failure is None:
                failure = await self._run_evaluation(goal_handle, setpoint, result)
        if result.stamp.sec == 0:  # nothing was measured
            result.stamp = self._now()
        result.machine_seconds = time.perf_counter() - started
        self._conclude(goal_handle, result, failure, f"evaluation {goal.index}")
        return result

    async def _run_evaluation(
        self,
        goal_handle: ServerGoalHandle,
        setpoint: Mapping[str, float],
        result: EvaluateSetpoint.Result,
    ) -> Failure | None:
        """Move, measure into `result`, and go to where the goal says if that ends badly."""
        goal = goal_handle.request
        fallback = values_of(goal.if_client_lost)
        self._watch.begin(goal.run_id, goal.client_timeout, fallback, time.monotonic())
        operation = self._begin(goal_handle, goal.critical)
        try:
            failure = await self._move(setpoint, operation)
            measured = Measurement()
            if failure is None:
                measured = await self._measure(goal.shots, operation)
                failure = operation.failure or measured.failure
            result.stamp = self._now()
            result.readbacks = list(measured.readbacks or self._backend.readbacks())
            result.diagnostics = list(measured.diagnostics)
            result.shots = measured.shots
            if failure is not None and failure.code == _Result.VIOLATION:
                failure = await self._fall_back(failure, values_of(goal.if_violated))
            elif failure is not None and failure.code == _Result.CLIENT_LOST:
                failure = await self._fall_back(failure, fallback)
        finally:
            self._end()
        # Whoever canceled it, or resumes the run of a lost client, may ask for it again.
        if failure is None or failure.code not in (_Result.CANCELED, _Result.CLIENT_LOST):
            self._finished.add(goal.run_id, goal.index, goal.attempt)
        return failure

    async def _apply(self, goal_handle: ServerGoalHandle) -> ApplySetpoint.Result:
        """Serve one goal of `apply_setpoint`; without a set-point it only says where the machine is."""
        result = ApplySetpoint.Result()
        failure = await self._run_move(goal_handle) if goal_handle.request.setpoint else None
        result.readbacks = list(self._backend.readbacks())
        result.stamp = self._now()
        self._conclude(goal_handle, result, failure, "a move")
        return result

    async def _run_move(self, goal_handle: ServerGoalHandle) -> Failure | None:
        """Move to a goal's set-point."""
        try:
            setpoint = check_setpoint(goal_handle.request.setpoint, self._backend.variables)
        except ValueError as error:
            return Failure(_Result.INVALID_SETPOINT, str(error))
        failure = self._refusal()
        if failure is not None:
            return failure
        operation = self._begin(goal_handle)
        try:
            return await self._move(setpoint, operation)
        finally:
            self._end()

    def _refusal(self) -> Failure | None:
        """Why the machine may not be moved now."""
        return self._stopped or (_BUSY if self.busy else None) or self._backend.refusal()

    def _old(self, goal: EvaluateSetpoint.Goal) -> Failure | None:
        message = self._finished.refusal(goal.run_id, goal.index, goal.attempt)
        return Failure(_Result.UNKNOWN, message) if message else None

    def _begin(self, goal_handle: ServerGoalHandle | None, critical: Any = ()) -> Operation:
        """Take the machine; nobody else may have it."""
        self._handle = goal_handle
        self._operation = Operation(
            self._executor, self._backend.hold, critical, on_phase=self._publish_feedback
        )
        if goal_handle is not None and goal_handle.is_cancel_requested:  # before it began
            self._cancel(goal_handle)
        return self._operation

    def _end(self) -> None:
        self._operation = self._handle = None

    async def _move(self, setpoint: Mapping[str, float], operation: Operation) -> Failure | None:
        if operation.failure is not None:
            return operation.failure
        operation.progress(RAMPING, 0.0)
        try:
            failure = await self._backend.move(setpoint, operation)
        except Exception as error:  # a fault of the backend must not leave the machine moving
            return self._fault(error)
        if failure is not None:
            self._backend.hold()
        return operation.failure or failure

    async def _measure(self, shots: int, operation: Operation) -> Measurement:
        try:
            return await self._backend.measure(shots, operation)
        except Exception as error:  # as above
            return Measurement(failure=self._fault(error))

    def _fault(self, error: Exception) -> Failure:
        self._backend.hold()
        return Failure(_Result.UNKNOWN, f"the machine's node failed: {error!r}")

    async def _fall_back(self, failure: Failure, setpoint: Mapping[str, float]) -> Failure:
        """Go to `setpoint` after `failure`; the machine holds where it is empty or out of reach."""
        if failure.code == _Result.CLIENT_LOST:
            self._finished.forget(self._watch.run_id)
            self._watch.end()
        if not setpoint:
            return Failure(failure.code, f"{failure.message}; the machine holds where it is")
        refused = self._stopped or self._backend.refusal()
        if refused is None:
            refused = await self._move(setpoint, self._begin(self._handle))
        outcome = "the machine went to the set-point given for that"
        if refused is not None:
            outcome = f"the machine could not go to the set-point given for that: {refused.message}"
        return Failure(failure.code, f"{failure.message}; {outcome}")

    def _tick(self) -> None:
        """Say how the machine is getting on, and see whether its client still lives."""
        self._publish_feedback()
        if not self._watch.lost(time.monotonic()):
            return
        failure = Failure(
            _Result.CLIENT_LOST,
            f"the heartbeat of run '{self._watch.run_id}' stopped for more than "
            f"{self._watch.timeout:g} s",
        )
        if self._operation is None:
            self._node.get_logger().warning(failure.message)
            self._begin(None)
            self._executor.create_task(self._abandoned, failure, self._watch.fallback)
        elif self._serves(self._watch.run_id):
            self._operation.stop(failure)

    def _serves(self, run_id: str) -> bool:
        """Whether an evaluation of this run goes on."""
        return getattr(getattr(self._handle, "request", None), "run_id", None) == run_id

    async def _abandoned(self, failure: Failure, fallback: Mapping[str, float]) -> None:
        """The client was lost between its evaluations."""
        try:
            failure = await self._fall_back(failure, fallback)
        finally:
            self._end()
        self._node.get_logger().warning(failure.message)

    def _hear_heartbeat(self, heartbeat: msg.Heartbeat) -> None:
        if heartbeat.run_id:
            self._watch.hear(heartbeat.run_id, time.monotonic())
        elif not self._serves(self._watch.run_id):  # nobody ends a run amid its evaluation
            self._watch.end()

    def _publish_feedback(self) -> None:
        if self._operation is None or self._handle is None or not self._operation.phase:
            return
        feedback_type = (
            ApplySetpoint.Feedback
            if isinstance(self._handle.request, ApplySetpoint.Goal)
            else EvaluateSetpoint.Feedback
        )
        self._handle.publish_feedback(
            feedback_type(
                phase=self._operation.phase,
                fraction=self._operation.fraction,
                readbacks=list(self._backend.readbacks()),
            )
        )

    def _conclude(
        self, goal_handle: ServerGoalHandle, result: Any, failure: Failure | None, what: str
    ) -> None:
        """Write the outcome into the result and the goal's state."""
        if failure is None:
            goal_handle.succeed()
            return
        result.error_code, result.error_msg = failure.code, failure.message
        if failure.code == _Result.CANCELED and goal_handle.is_cancel_requested:
            goal_handle.canceled()
            return
        self._node.get_logger().warning(f"{what}: {failure.message}")
        goal_handle.abort()

    def _now(self) -> Any:
        return self._node.get_clock().now().to_msg()
