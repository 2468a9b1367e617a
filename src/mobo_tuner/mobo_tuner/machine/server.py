"""Server of every machine: it describes the machine, evaluates set-points and moves to them.

Nothing moves before a goal has been checked completely, and a goal that cannot be served is aborted
with a reason. The machine does one thing at a time. Whatever ends an evaluation early (a cancel, a
critical limit, a lost client, a stopped node) makes the machine hold at once; after a violation or a
lost client it then ramps to the set-point that the goal gives for that case.
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from typing import Any

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
from mobo_tuner.machine.goal_checks import check_evaluation, check_move
from mobo_tuner.machine.limits import SumLimits
from mobo_tuner.ros import interfaces
from mobo_tuner.ros.action_server import Goal
from mobo_tuner.ros.conversions import values_of
from mobo_tuner.ros.waiting import STEADY_CLOCK, until

FEEDBACK_PERIOD = 0.2  # [s] of wall time
STOP_TIMEOUT = 1.0  # [s] for a running operation to end
_Result = EvaluateSetpoint.Result
_BUSY = Failure(_Result.BUSY, "another evaluation or move is running; one at a time is allowed")


class MachineServer:
    """Serves `evaluate_setpoint`, `apply_setpoint` and `describe_machine`; listens to `heartbeat`.

    Args:
        node: Node that owns these names; `executor` spins it, or will.
        backend: Machine to serve.
        executor: Executor that runs everything, the backend's coroutines included.

    Attributes:
        evaluations: Number of evaluations that were begun and have ended, canceled ones not counted.
        failures: Number of those that failed.
        last_failed: Whether the last of them failed.
        last_failure: Latest failure of them; None if there was none.
    """

    def __init__(self, node: Node, backend: MachineBackend, executor: Executor) -> None:
        self._node = node
        self._backend = backend
        self._executor = executor
        self._operation: Operation | None = None  # what the machine is doing
        self._goal: Goal | None = None  # that the operation serves
        self._stopped: Failure | None = None
        self._limits = SumLimits((), ())  # of the goal that moved the machine last
        self._watch = ClientWatch()
        self._finished = FinishedEvaluations()
        self.evaluations = self.failures = 0
        self.last_failed = False
        self.last_failure: Failure | None = None
        self._service = interfaces.DESCRIBE_MACHINE.server(node, self._describe)
        self._heartbeats = interfaces.HEARTBEAT.subscription(node, self._hear_heartbeat)
        self._servers = [
            interfaces.EVALUATE_SETPOINT.server(node, self._evaluate),
            interfaces.APPLY_SETPOINT.server(node, self._apply),
        ]
        # On a steady clock, because clients live in wall time, not in simulated time.
        self._timer = node.create_timer(FEEDBACK_PERIOD, self._tick, clock=STEADY_CLOCK)

    @property
    def names(self) -> str:
        """Full names of what is served, for people."""
        actions = ("evaluate_setpoint", "apply_setpoint")
        return ", ".join([*map(self._node.resolve_topic_name, actions), self.describe_name])

    @property
    def describe_name(self) -> str:
        """Full name of the service that describes the machine."""
        return str(self._service.service_name)

    @property
    def evaluations_name(self) -> str:
        """Full name of the topic on which every server of `evaluate_setpoint` tells what becomes of its goals."""
        return self._node.resolve_topic_name("evaluate_setpoint/_action/status")

    @property
    def heartbeat_name(self) -> str:
        """Full name of the topic on which tuners say that they are alive."""
        return str(self._heartbeats.topic_name)

    @property
    def phase(self) -> str:
        """What the machine does now; empty if nothing."""
        return self._operation.phase if self._operation is not None else ""

    @property
    def busy(self) -> bool:
        """Whether the machine moves or measures."""
        return self._operation is not None

    def interrupt(self, failure: Failure) -> None:
        """End the running operation, if there is one, for this reason; the machine holds where it is."""
        if self._operation is not None:
            self._operation.stop(failure)

    async def stop(self) -> None:
        """End the running operation, so that its client gets a result, and refuse all further goals."""
        self._stop()
        await until(self._node, lambda: not self.busy, timeout=STOP_TIMEOUT)

    def close(self) -> None:
        """Stop serving; the node stays."""
        self._stop()
        self._node.destroy_timer(self._timer)
        for server in self._servers:
            server.close()
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

    async def _evaluate(self, goal: Goal) -> EvaluateSetpoint.Result:
        """Serve one goal of `evaluate_setpoint`."""
        started = time.perf_counter()
        request = goal.request
        result = _Result(run_id=request.run_id, index=request.index, attempt=request.attempt)
        try:
            setpoint = check_evaluation(
                request, self._backend.variables, self._backend.diagnostics, self._backend.max_shots
            )
            limits = SumLimits(request.limits, self._backend.variables)
            limits.check(setpoint)
        except ValueError as error:
            failure: Failure | None = Failure(_Result.INVALID_SETPOINT, str(error))
        else:
            failure = self._refusal() or self._outdated(request)
            if failure is None:
                failure = await self._run_evaluation(goal, setpoint, limits, result)
        if result.stamp.sec == 0:  # nothing was measured
            result.stamp = self._now()
        result.machine_seconds = time.perf_counter() - started
        return _with_outcome(result, failure)

    async def _run_evaluation(
        self,
        goal: Goal,
        setpoint: Mapping[str, float],
        limits: SumLimits,
        result: EvaluateSetpoint.Result,
    ) -> Failure | None:
        """Move and measure into `result`; after a violation or a lost client, go to a fallback."""
        request = goal.request
        fallback = _way(request.if_client_lost_via, request.if_client_lost)
        self._limits = limits
        self._watch.begin(request.run_id, request.client_timeout, fallback, time.monotonic())
        operation = self._begin(goal, request.critical)
        try:
            failure = await self._move([setpoint], operation)
            measured = Measurement()
            if failure is None:
                measured = await self._measure(request.shots, operation)
                failure = operation.failure or measured.failure
            result.stamp = self._now()
            result.readbacks = list(measured.readbacks or self._backend.readbacks())
            result.diagnostics = list(measured.diagnostics)
            result.shots = measured.shots
            if failure is not None and failure.code == _Result.VIOLATION:
                way = _way(request.if_violated_via, request.if_violated)
                failure = await self._fall_back(failure, way)
            elif failure is not None and failure.code == _Result.CLIENT_LOST:
                failure = await self._fall_back(failure, fallback)
        finally:
            self._end()
        self._count(failure)
        # A client that canceled, or resumes the run of a lost client, may ask for it again.
        if failure is None or failure.code not in (_Result.CANCELED, _Result.CLIENT_LOST):
            self._finished.add(request.run_id, request.index, request.attempt)
        return failure

    def _count(self, failure: Failure | None) -> None:
        """Count an evaluation that has ended."""
        if failure is not None and failure.code == _Result.CANCELED:
            return
        self.evaluations += 1
        self.last_failed = failure is not None
        if failure is not None:
            self.failures += 1
            self.last_failure = failure

    async def _apply(self, goal: Goal) -> ApplySetpoint.Result:
        """Serve one goal of `apply_setpoint`; without a set-point it only reads where the machine is."""
        failure = await self._run_move(goal) if goal.request.setpoint else None
        result = ApplySetpoint.Result(readbacks=list(self._backend.readbacks()), stamp=self._now())
        return _with_outcome(result, failure)

    async def _run_move(self, goal: Goal) -> Failure | None:
        """Move to a goal's set-point."""
        try:
            setpoints = check_move(goal.request, self._backend.variables)
            limits = SumLimits(goal.request.limits, self._backend.variables)
            for setpoint in setpoints:
                limits.check(setpoint)
        except ValueError as error:
            return Failure(_Result.INVALID_SETPOINT, str(error))
        failure = self._refusal()
        if failure is not None:
            return failure
        self._limits = limits
        operation = self._begin(goal)
        try:
            return await self._move(setpoints, operation)
        finally:
            self._end()

    def _refusal(self) -> Failure | None:
        """Return why the machine must not be moved now, or None."""
        if self._stopped or self.busy:
            return self._stopped or _BUSY
        return self._inactive() or self._backend.refusal()

    def _inactive(self) -> Failure | None:
        reason = self._backend.inactive
        return Failure(_Result.NOT_ACTIVE, f"{reason}; nothing may move") if reason else None

    def _outdated(self, request: EvaluateSetpoint.Goal) -> Failure | None:
        message = self._finished.refusal(request.run_id, request.index, request.attempt)
        return Failure(_Result.UNKNOWN, message) if message else None

    def _begin(self, goal: Goal | None, critical: Sequence[msg.Constraint] = ()) -> Operation:
        """Take the machine for an operation; `_end` releases it."""
        self._goal = goal
        self._operation = operation = Operation(
            self._executor, self._backend.hold, critical, on_phase=self._publish_feedback
        )
        if goal is not None:
            canceled = Failure(_Result.CANCELED, "a client stopped the machine")
            goal.on_cancel(lambda: operation.stop(canceled))
        return operation

    def _end(self) -> None:
        self._operation = self._goal = None

    async def _move(
        self, setpoints: Sequence[Mapping[str, float]], operation: Operation
    ) -> Failure | None:
        """Go to one set-point after the other."""
        for setpoint in setpoints:
            failure = await self._move_on(setpoint, operation)
            if failure is not None:
                return failure
        return None

    async def _move_on(self, setpoint: Mapping[str, float], operation: Operation) -> Failure | None:
        if operation.failure is not None:
            return operation.failure
        try:
            way = self._way(setpoint)
        except ValueError as error:
            return Failure(_Result.INVALID_SETPOINT, str(error))
        failure = None
        for point in way:
            operation.progress(RAMPING, 0.0)
            try:
                failure = await self._backend.move(point, operation)
            except Exception as error:  # a faulty backend must not leave the machine moving
                return self._fault(error)
            if failure is not None or operation.failure is not None:
                break
        if failure is not None:
            self._backend.hold()
        return operation.failure or failure

    def _way(self, setpoint: Mapping[str, float]) -> Sequence[Mapping[str, float]]:
        """Return the set-points that lead to a set-point within the limits of the goal that moved last.

        Raises:
            ValueError: If there is no such way.
        """
        if not self._limits:
            return [setpoint]
        return self._limits.way(values_of(self._backend.readbacks()), setpoint)

    async def _measure(self, shots: int, operation: Operation) -> Measurement:
        try:
            return await self._backend.measure(shots, operation)
        except Exception as error:  # as above
            return Measurement(failure=self._fault(error))

    def _fault(self, error: Exception) -> Failure:
        self._backend.hold()
        return Failure(_Result.UNKNOWN, f"the machine's node failed: {error!r}")

    async def _fall_back(self, failure: Failure, way: Sequence[Mapping[str, float]]) -> Failure:
        """Go a way after `failure`; the machine holds if it is empty or cannot be gone."""
        if failure.code == _Result.CLIENT_LOST:
            self._finished.forget(self._watch.run_id)
            self._watch.end()
        if not way:
            return Failure(failure.code, f"{failure.message}; the machine holds where it is")
        refused = self._stopped or self._inactive() or self._backend.refusal()
        if refused is None:
            refused = await self._move(way, self._begin(self._goal))
        outcome = "the machine went to the set-point given for that"
        if refused is not None:
            outcome = f"the machine could not go to the set-point given for that: {refused.message}"
        return Failure(failure.code, f"{failure.message}; {outcome}")

    def _tick(self) -> None:
        """Publish feedback, and check whether the client that is watched is still alive."""
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
        """Return whether an evaluation of this run is running."""
        request = None if self._goal is None else self._goal.request
        return isinstance(request, EvaluateSetpoint.Goal) and request.run_id == run_id

    async def _abandoned(self, failure: Failure, fallback: Sequence[Mapping[str, float]]) -> None:
        """Go to the fallback of a client that was lost between two evaluations."""
        try:
            failure = await self._fall_back(failure, fallback)
        finally:
            self._end()
        self._node.get_logger().warning(failure.message)

    def _hear_heartbeat(self, heartbeat: msg.Heartbeat) -> None:
        if heartbeat.run_id:
            self._watch.hear(heartbeat.run_id, time.monotonic())
        elif not self._serves(self._watch.run_id):  # a run does not end during an evaluation
            self._watch.end()

    def _publish_feedback(self) -> None:
        if self._operation is None or self._goal is None or not self._operation.phase:
            return
        self._goal.publish_feedback(
            phase=self._operation.phase,
            fraction=self._operation.fraction,
            readbacks=list(self._backend.readbacks()),
        )

    def _now(self) -> Any:
        return self._node.get_clock().now().to_msg()


def _way(
    via: Sequence[msg.NamedValue], setpoint: Sequence[msg.NamedValue]
) -> list[dict[str, float]]:
    """Return the set-points that lead to one; none if it is empty."""
    return [values_of(point) for point in (via, setpoint) if point] if setpoint else []


def _with_outcome(result: Any, failure: Failure | None) -> Any:
    """Return a result, with the failure's code and message written into it if there is one."""
    if failure is not None:
        result.error_code, result.error_msg = failure.code, failure.message
    return result
