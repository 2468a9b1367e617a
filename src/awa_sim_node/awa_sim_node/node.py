"""The simulated machine as a ROS node: it describes itself, and it evaluates set-points."""

from __future__ import annotations

import time

from rclpy.action import ActionServer, CancelResponse, GoalResponse
from rclpy.action.server import ServerGoalHandle
from rclpy.executors import Executor
from rclpy.node import Node
from rclpy.task import Future

from awa_sim_node.machine import SimulatedMachine
from awa_sim_node.machine.diagnostics import Reading
from awa_sim_node.machine.evaluation import Evaluation, Phase
from awa_sim_node.parameters import AWA_SIM
from mobo_msgs_py import msg
from mobo_msgs_py.action import EvaluateSetpoint
from mobo_msgs_py.srv import DescribeMachine
from mobo_tuner.ros.conversions import named_values, values_of
from mobo_tuner.ros.parameters import declare
from mobo_tuner.ros.process import exit_process, run_node
from mobo_tuner.ros.waiting import first_of

FEEDBACK_PERIOD = 0.2  # [s] of wall time
_PHASE_WORDS = {Phase.RAMP: "ramping", Phase.SETTLE: "settling", Phase.MEASURE: "measuring"}
_Result = EvaluateSetpoint.Result


class AwaSim:
    """Serves `evaluate_setpoint` and `describe_machine` for one simulated machine.

    Wall time drives simulated time, `speed` times as fast, and only while something is to be done.
    """

    def __init__(self, executor: Executor) -> None:
        """Declare the parameters and switch the machine on; nothing moves.

        Raises:
            ValueError: a parameter is not allowed.
        """
        self.exit_code: int | None = None
        self.node = Node("awa_sim")
        try:
            parameters = declare(self.node, AWA_SIM)
        except ValueError:
            self.node.destroy_node()
            raise
        self._executor = executor
        self._speed = float(parameters["speed"])
        self._machine = SimulatedMachine(
            str(parameters["model"]), str(parameters["mode"]), int(parameters["seed"])
        )
        self._units = {v.name: v.unit for v in self._machine.description.variables}
        self._interrupt: Future | None = None  # of the running evaluation; its result says why
        self._stopping = False
        self._service = self.node.create_service(
            DescribeMachine, "describe_machine", self._describe
        )
        self._server = ActionServer(
            self.node,
            EvaluateSetpoint,
            "evaluate_setpoint",
            execute_callback=self._execute,
            goal_callback=lambda _: GoalResponse.ACCEPT,  # refused with a reason in `_execute`
            cancel_callback=self._cancel,
            result_timeout=10,
        )
        self._goal_id = b""
        self.node.get_logger().info(
            f"{self._machine.description.title}: ready, {self._speed:g} times as fast as real"
        )

    async def stop(self) -> None:
        """Stop whatever moves, where it is."""
        self._stopping = True
        self._interrupt_evaluation(_Result.MACHINE_LOST, "the machine's node was stopped")

    def close(self) -> None:
        """Release the node."""
        self.node.destroy_node()

    def _describe(
        self, _: DescribeMachine.Request, response: DescribeMachine.Response
    ) -> DescribeMachine.Response:
        description = self._machine.description
        response.name = description.title
        response.variables = [
            msg.Variable(name=v.name, unit=v.unit, min=v.minimum, max=v.maximum)
            for v in description.variables
        ]
        response.diagnostics = [
            msg.Observable(name=d.name, unit=d.unit) for d in description.diagnostics
        ]
        return response

    def _cancel(self, goal_handle: ServerGoalHandle) -> CancelResponse:
        if bytes(goal_handle.goal_id.uuid) == self._goal_id:
            self._interrupt_evaluation(_Result.CANCELED, "a client stopped the evaluation")
        return CancelResponse.ACCEPT

    def _interrupt_evaluation(self, code: int, reason: str) -> None:
        if self._interrupt is not None and not self._interrupt.done():
            # At once, not when the coroutine wakes up: the machine holds where it is now.
            self._machine.stop()
            self._interrupt.set_result((code, reason))

    async def _execute(self, goal_handle: ServerGoalHandle) -> EvaluateSetpoint.Result:
        """Evaluate one set-point; a goal that cannot be served moves nothing and says why."""
        started = time.perf_counter()
        goal = goal_handle.request
        result = _Result(run_id=goal.run_id, index=goal.index, error_code=_Result.NONE)
        evaluation = self._start(goal, result)
        if evaluation is not None:
            self._goal_id = bytes(goal_handle.goal_id.uuid)
            self._interrupt = Future(executor=self._executor)
            if goal_handle.is_cancel_requested:  # canceled before it began
                self._cancel(goal_handle)
            try:
                await self._drive(evaluation, goal_handle)
                self._fill(result, evaluation)
            finally:
                self._interrupt = None
        result.stamp = self.node.get_clock().now().to_msg()
        result.machine_seconds = time.perf_counter() - started
        if result.error_code == _Result.NONE:
            goal_handle.succeed()
        elif goal_handle.is_cancel_requested:
            goal_handle.canceled()
        else:
            self.node.get_logger().warning(f"evaluation {goal.index}: {result.error_msg}")
            goal_handle.abort()
        return result

    def _start(
        self, goal: EvaluateSetpoint.Goal, result: EvaluateSetpoint.Result
    ) -> Evaluation | None:
        """Start the evaluation, or write into `result` why not."""
        setpoint = values_of(goal.setpoint)
        if self._interrupt is not None or self._stopping:
            result.error_code = _Result.BUSY
            result.error_msg = "another evaluation is running; one at a time is allowed"
        elif len(setpoint) != len(goal.setpoint):
            result.error_code = _Result.INVALID_SETPOINT
            result.error_msg = "set-point names a variable twice"
        else:
            try:
                return self._machine.start_evaluation(setpoint, goal.shots or None)
            except ValueError as error:
                result.error_code = _Result.INVALID_SETPOINT
                result.error_msg = str(error)
        return None

    async def _drive(self, evaluation: Evaluation, goal_handle: ServerGoalHandle) -> None:
        """Let simulated time pass until the evaluation is finished or interrupted."""
        assert self._interrupt is not None
        last = time.monotonic()
        next_feedback = last
        while not evaluation.phase.finished:
            if last >= next_feedback:
                next_feedback = last + FEEDBACK_PERIOD
                goal_handle.publish_feedback(
                    EvaluateSetpoint.Feedback(
                        phase=_PHASE_WORDS[evaluation.phase],
                        fraction=evaluation.fraction,
                        readbacks=named_values(self._machine.readbacks(), self._units),
                    )
                )
            remaining = (evaluation.duration - evaluation.elapsed) / self._speed
            pause = min(max(remaining, 0.0), FEEDBACK_PERIOD)
            if await first_of(self.node, self._interrupt, timeout=pause) is not None:
                return
            now = time.monotonic()
            self._machine.step((now - last) * self._speed)
            last = now

    def _fill(self, result: EvaluateSetpoint.Result, evaluation: Evaluation) -> None:
        assert self._interrupt is not None
        if self._interrupt.done():
            result.error_code, result.error_msg = self._interrupt.result()
        if evaluation.result is not None:
            result.readbacks = _messages(evaluation.result.readbacks)
            result.diagnostics = _messages(evaluation.result.diagnostics)


def _messages(readings: tuple[Reading, ...]) -> list[msg.NamedValue]:
    return [
        msg.NamedValue(name=r.name, value=r.value, stddev=r.stddev, unit=r.unit) for r in readings
    ]


def main() -> None:
    """Run the simulated machine's node."""
    exit_process(run_node(AwaSim))


if __name__ == "__main__":
    main()
