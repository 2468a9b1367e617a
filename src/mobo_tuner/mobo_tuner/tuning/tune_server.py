"""The `tune` action: one goal is one run, from its start to its result."""

from __future__ import annotations

from collections.abc import Callable

from rclpy.action import ActionServer, CancelResponse, GoalResponse
from rclpy.action.server import ServerGoalHandle
from rclpy.task import Future

from mobo_msgs_py import msg
from mobo_msgs_py.action import Tune
from mobo_tuner.core import Problem
from mobo_tuner.ros.conversions import seconds
from mobo_tuner.tuning.ends import Ends
from mobo_tuner.tuning.parts import TunerParts
from mobo_tuner.tuning.run import Run, RunError
from mobo_tuner.tuning.run_loop import RunLoop
from mobo_tuner.tuning.run_start import read_earlier, start_run

CANCELED = "a client canceled it"


class TuneServer:
    """Serves `tune`, one run at a time.

    Args:
        parts: of the tuner's node.
        problem: gives what a run that begins tunes.

    Attributes:
        run: the one that goes on; None while there is none.
    """

    def __init__(self, parts: TunerParts, problem: Callable[[], Problem]) -> None:
        self.run: Run | None = None
        self._starting = False
        self._parts = parts
        self._problem = problem
        self._ends = Ends(parts)
        self._loop = RunLoop(parts, self._ends)
        self._server = ActionServer(
            parts.node,
            Tune,
            "tune",
            execute_callback=self._execute,
            goal_callback=lambda _: GoalResponse.ACCEPT,  # refused with a reason in `_execute`
            cancel_callback=self._cancel,
            result_timeout=10,
        )

    def _cancel(self, goal_handle: ServerGoalHandle) -> CancelResponse:
        if self.run is not None and self.run.goal_id == bytes(goal_handle.goal_id.uuid):
            self.run.stop(CANCELED)
            self._parts.status.set(state=msg.TunerStatus.CANCELING)
        return CancelResponse.ACCEPT

    async def _execute(self, goal_handle: ServerGoalHandle) -> Tune.Result:
        """One run, from its goal to its result, which carries the front whatever happens."""
        result = Tune.Result(error_code=Tune.Result.NONE)
        try:
            run = await self._start(goal_handle)
        except (ValueError, OSError) as error:
            self._parts.log.warning(f"goal refused: {error}")
            result.run_id = goal_handle.request.run_id
            result.stop_reason = "error"
            result.error_code = Tune.Result.INVALID_GOAL
            result.error_msg = str(error)
            goal_handle.abort()
            return result
        self.run = run
        if goal_handle.is_cancel_requested:  # canceled before it began
            run.stop(CANCELED)

        def tell(message: msg.Evaluation) -> None:
            goal_handle.publish_feedback(
                Tune.Feedback(evaluation=message, evaluations=run.index, budget=run.budget)
            )

        self._parts.heartbeat.begin(run.run_id)
        try:
            await self._loop.carry_out(run, tell)
            result.stop_reason = _stop_reason(run)
            if run.interrupted:
                result.error_code = Tune.Result.CANCELED
                result.error_msg = f"the run was stopped: {run.interrupt.result()}"
        except Exception as error:
            if isinstance(error, RunError):
                result.error_code, result.error_msg = error.code, str(error)
            else:
                result.error_code = Tune.Result.INTERNAL
                result.error_msg = f"{type(error).__name__}: {error}"
            result.stop_reason = "error"
            self._parts.log.error(f"run '{run.run_id}' ends: {result.error_msg}")
        try:
            await self._leave_machine(run, result)
            self._end(run, result)
        finally:
            self._parts.heartbeat.end()
            self.run = None
            self._parts.status.set(state=msg.TunerStatus.IDLE, phase="", fraction=0.0)
        if result.error_code == Tune.Result.NONE:
            goal_handle.succeed()
        elif goal_handle.is_cancel_requested:
            goal_handle.canceled()
        else:
            goal_handle.abort()
        return result

    async def _start(self, goal_handle: ServerGoalHandle) -> Run:
        """The run of a goal.

        Raises:
            ValueError, OSError: it cannot be served, with the reason.
        """
        goal: Tune.Goal = goal_handle.request
        if self.run is not None or self._starting:
            name = f"run '{self.run.run_id}' is" if self.run is not None else "another run is"
            raise ValueError(f"{name} going on; one run at a time is allowed")
        self._starting = True
        try:
            earlier = None
            if goal.resume_from:
                runs_dir = self._parts.parameters["runs_dir"]
                earlier = await self._parts.worker.submit(read_earlier, runs_dir, goal.resume_from)
            return start_run(
                goal,
                self._problem(),
                self._parts.parameters,
                goal_id=bytes(goal_handle.goal_id.uuid),
                interrupt=Future(executor=self._parts.node.executor),
                stamp=seconds(self._parts.now()),
                earlier=earlier,
            )
        finally:
            self._starting = False

    async def _leave_machine(self, run: Run, result: Tune.Result) -> None:
        """After a cancel, a stop or an error, leave the machine where `on_abort` says."""
        if result.error_code in (Tune.Result.NONE, Tune.Result.MACHINE_LOST):
            return
        done = await self._ends.act(run)
        if done:
            result.error_msg += f"; {done}"
            self._parts.log.info(f"run '{run.run_id}': {done}")

    def _end(self, run: Run, result: Tune.Result) -> None:
        """Fill in the result and close the journal."""
        result.run_id = run.run_id
        result.evaluations = run.index
        result.pareto_front = run.front(self._parts.now())
        end = {
            "type": "end",
            "stamp": seconds(self._parts.now()),
            "stop_reason": result.stop_reason,
            "error_code": result.error_code,
            "error_msg": result.error_msg,
        }
        try:
            run.journal.append(end)
        except OSError as error:
            self._parts.log.error(f"the end of the run is not in its journal: {error}")
        run.journal.close()
        self._parts.status.set(message=result.error_msg, stop_reason=result.stop_reason)
        self._parts.log.info(
            f"run '{run.run_id}': {run.index} evaluations, hypervolume "
            f"{run.optimizer.hypervolume:.6g}, stopped by {result.stop_reason}"
        )


def _stop_reason(run: Run) -> str:
    if run.interrupted:
        return "canceled"
    if run.steering.stopping:
        return "stopped"
    return "budget" if run.index >= run.budget else "hypervolume_goal"
