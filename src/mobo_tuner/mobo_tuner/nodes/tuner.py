"""The tuner: proposes set-points, has the machine evaluate them, learns, and reports the front."""

from __future__ import annotations

import time
from pathlib import Path

from rclpy.action import ActionServer, CancelResponse, GoalResponse
from rclpy.action.server import ServerGoalHandle
from rclpy.executors import Executor
from rclpy.node import Node
from rclpy.task import Future

from mobo_msgs_py import msg
from mobo_msgs_py.action import EvaluateSetpoint, Tune
from mobo_tuner.core import Optimizer, ProblemError
from mobo_tuner.journal import Journal
from mobo_tuner.ros.conversions import (
    front_message,
    problem_message,
    seconds,
)
from mobo_tuner.ros.machine_client import Answer, MachineClient, MachineLostError
from mobo_tuner.ros.parameters import TUNER, declare, declare_problem
from mobo_tuner.ros.process import STOP_TIMEOUT, exit_process, run_node
from mobo_tuner.ros.publishers import TunerPublishers
from mobo_tuner.ros.run import Run, Suggestion
from mobo_tuner.ros.waiting import first_of, until
from mobo_tuner.ros.worker import Worker
from mobo_tuner.run_id import check_run_id, new_run_id

STATUS_PERIOD = 1.0  # [s]
STOPPED = "the tuner was asked to stop"
CANCELED = "a client canceled it"
_RESULT = EvaluateSetpoint.Result
# What the machine did go for and could not measure: an evaluation that failed, to be learned from.
_FAILED_EVALUATION = (_RESULT.TIMEOUT, _RESULT.INVALID_MEASUREMENT, _RESULT.UNKNOWN)


class RunError(Exception):
    """A run cannot go on; `code` is one of Tune.Result's constants."""

    def __init__(self, code: int, message: str) -> None:
        super().__init__(message)
        self.code = code


class Tuner:
    """Serves the `tune` action: one goal is one run, and one run goes on at a time."""

    def __init__(self, executor: Executor) -> None:
        """Declare the parameters and offer the action; nothing moves.

        Raises:
            ProblemError: the parameters do not make up a problem.
        """
        self.exit_code: int | None = None
        self.node = Node("tuner", automatically_declare_parameters_from_overrides=True)
        try:
            self._parameters = declare(self.node, TUNER)
            self.problem = declare_problem(self.node)
        except ProblemError:
            self.node.destroy_node()
            raise
        self._log = self.node.get_logger()
        self._worker = Worker(executor, "optimizer")
        self._run: Run | None = None
        self._publishers = TunerPublishers(self.node, self.problem)
        self._status = msg.TunerStatus()
        self._machine = MachineClient(
            self.node,
            silence_timeout=self._parameters["machine_timeout"],
            evaluation_timeout=self._parameters["evaluation_timeout"],
        )
        self._server = ActionServer(
            self.node,
            Tune,
            "tune",
            execute_callback=self._execute,
            goal_callback=lambda _: GoalResponse.ACCEPT,  # refused with a reason in `_execute`
            cancel_callback=self._cancel,
            result_timeout=10,
        )
        self._timer = self.node.create_timer(STATUS_PERIOD, self._publish_status)
        self._publish_status()

    async def stop(self) -> None:
        """End the run that goes on, with what it has."""
        run = self._run
        if run is not None:
            self._interrupt(run, STOPPED)
            await until(self.node, lambda: self._run is not run, timeout=STOP_TIMEOUT)

    def close(self) -> None:
        """Release the worker and the node."""
        self._worker.shutdown()
        self.node.destroy_node()

    # ------------------------------------------------------------------ the action

    def _cancel(self, goal_handle: ServerGoalHandle) -> CancelResponse:
        if self._run is not None and self._run.goal_id == bytes(goal_handle.goal_id.uuid):
            self._interrupt(self._run, CANCELED)
            self._set_status(state=msg.TunerStatus.CANCELING)
        return CancelResponse.ACCEPT

    async def _execute(self, goal_handle: ServerGoalHandle) -> Tune.Result:
        """One run, from its goal to its result, which carries the front whatever happens."""
        result = Tune.Result(error_code=Tune.Result.NONE)
        try:
            run = self._begin(goal_handle.request, bytes(goal_handle.goal_id.uuid))
        except (RunError, ValueError, OSError) as error:
            self._log.warning(f"goal refused: {error}")
            result.run_id = goal_handle.request.run_id
            result.stop_reason = "error"
            result.error_code = Tune.Result.INVALID_GOAL
            result.error_msg = str(error)
            goal_handle.abort()
            return result
        self._run = run
        if goal_handle.is_cancel_requested:  # canceled before it began
            self._interrupt(run, CANCELED)
        try:
            await self._tune(run, goal_handle)
            result.stop_reason = self._stop_reason(run)
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
            self._log.error(f"run '{run.run_id}' ends: {result.error_msg}")
        try:
            self._end(run, result)
        finally:
            self._run = None
            self._set_status(state=msg.TunerStatus.IDLE, phase="", fraction=0.0)
        if result.error_code == Tune.Result.NONE:
            goal_handle.succeed()
        elif goal_handle.is_cancel_requested:
            goal_handle.canceled()
        else:
            goal_handle.abort()
        return result

    def _begin(self, goal: Tune.Goal, goal_id: bytes) -> Run:
        """Check the goal and prepare its run.

        Raises:
            RunError, ValueError, OSError: the goal cannot be served, with the reason.
        """
        if self._run is not None:
            raise RunError(
                Tune.Result.INVALID_GOAL,
                f"run '{self._run.run_id}' is going on; one run at a time is allowed",
            )
        run_id = check_run_id(goal.run_id) if goal.run_id else new_run_id("run")
        seed, initial = self._parameters["seed"], self._parameters["initial_evaluations"]
        optimizer = Optimizer(
            self.problem,
            preset=self._parameters["preset"],
            seed=seed,
            **({"initial_evaluations": initial} if initial else {}),
        )
        run = Run(
            run_id=run_id,
            budget=goal.evaluations or self._parameters["evaluations"],
            hypervolume_goal=goal.hypervolume_goal if goal.hypervolume_goal > 0.0 else 0.0,
            optimizer=optimizer,
            goal_id=goal_id,
            interrupt=Future(executor=self.node.executor),
        )
        if self._parameters["runs_dir"]:
            start = {
                "type": "start",
                "run_id": run_id,
                "stamp": seconds(self.node.get_clock().now().to_msg()),
                "problem": self.problem.to_dict(),
                "settings": {"budget": run.budget, **self._parameters},
            }
            run.journal = Journal.create(Path(self._parameters["runs_dir"]) / run_id, start)
        return run

    def _stop_reason(self, run: Run) -> str:
        if run.interrupted:
            return "canceled"
        return "budget" if run.index >= run.budget else "hypervolume_goal"

    def _end(self, run: Run, result: Tune.Result) -> None:
        """Fill in the result and close the journal."""
        result.run_id = run.run_id
        result.evaluations = run.index
        result.pareto_front = self._front(run)
        if run.journal is not None:
            end = {
                "type": "end",
                "stamp": seconds(self.node.get_clock().now().to_msg()),
                "stop_reason": result.stop_reason,
                "error_code": result.error_code,
                "error_msg": result.error_msg,
            }
            try:
                run.journal.append(end)
            except OSError as error:
                self._log.error(f"the end of the run is not in its journal: {error}")
            run.journal.close()
        self._set_status(message=result.error_msg)
        self._log.info(
            f"run '{run.run_id}': {run.index} evaluations, hypervolume "
            f"{run.optimizer.hypervolume:.6g}, stopped by {result.stop_reason}"
        )

    # ------------------------------------------------------------------ the loop

    async def _tune(self, run: Run, goal_handle: ServerGoalHandle) -> None:
        """Propose, evaluate, learn, until the run is done or interrupted.

        Raises:
            RunError: it cannot go on.
        """
        self._publishers.problem(self._problem_message(run))
        self._publishers.front(self._front(run))
        self._set_status(
            state=msg.TunerStatus.WAITING,
            run_id=run.run_id,
            budget=run.budget,
            evaluations=0,
            failed=0,
            feasible=0,
            hypervolume=0.0,
            message="",
        )
        await self._meet_machine(run)
        run.step_started = time.perf_counter()
        suggestion = self._worker.submit(run.suggest)
        while not run.interrupted:
            message = await self._step(run, suggestion)
            if message is None:
                return
            goal_met = 0.0 < run.hypervolume_goal <= message.hypervolume
            finished = goal_met or run.index >= run.budget
            if not finished:  # computed while the world is told of this evaluation
                suggestion = self._worker.submit(run.suggest)
            self._report(run, message, goal_handle)
            self._judge(run, message)
            if finished:
                return

    async def _meet_machine(self, run: Run) -> None:
        try:
            machine = await self._machine.describe(
                run.interrupt, self._parameters["discovery_timeout"]
            )
        except MachineLostError as error:
            raise RunError(Tune.Result.MACHINE_UNAVAILABLE, str(error)) from None
        if machine is None:
            return
        try:
            self.problem.check_machine(
                {v.name: (v.min, v.max) for v in machine.variables},
                {d.name: d.unit for d in machine.diagnostics},
                {v.name: v.unit for v in machine.variables},
            )
        except ProblemError as error:
            raise RunError(Tune.Result.MACHINE_UNAVAILABLE, str(error)) from None
        self._log.info(f"run '{run.run_id}' tunes '{machine.name}'")

    async def _step(self, run: Run, suggestion: Future) -> msg.Evaluation | None:
        """One evaluation; None when it was interrupted, which leaves no trace in the data."""
        self._set_status(state=msg.TunerStatus.SUGGESTING, phase="", fraction=0.0)
        patience = self._parameters["suggestion_timeout"]
        done = await first_of(self.node, suggestion, run.interrupt, timeout=patience)
        if run.interrupted:
            return None
        if done is None:
            raise RunError(Tune.Result.INTERNAL, f"no suggestion came within {patience:g} s")
        suggested: Suggestion = suggestion.result()

        self._set_status(state=msg.TunerStatus.EVALUATING)
        answer = await self._evaluate(run, suggested.setpoint)
        if answer.error_code == _RESULT.CANCELED:
            if not run.interrupted:
                raise RunError(
                    Tune.Result.MACHINE_ERROR, f"the machine stopped: {answer.error_msg}"
                )
            return None
        message: msg.Evaluation = await self._worker.submit(run.learn, suggested, answer)
        run.index += 1
        return message

    async def _evaluate(self, run: Run, setpoint: dict[str, float]) -> Answer:
        def on_feedback(feedback: EvaluateSetpoint.Feedback) -> None:
            self._set_status(phase=feedback.phase, fraction=feedback.fraction, publish=False)

        try:
            answer = await self._machine.evaluate(
                self.problem,
                run.run_id,
                run.index,
                setpoint,
                self._parameters["shots"],
                run.interrupt,
                on_feedback,
            )
        except MachineLostError as error:
            raise RunError(Tune.Result.MACHINE_LOST, str(error)) from None
        if answer.error_code == _RESULT.MACHINE_LOST:
            raise RunError(Tune.Result.MACHINE_LOST, answer.error_msg)
        expected = (_RESULT.NONE, _RESULT.CANCELED, *_FAILED_EVALUATION)
        if answer.error_code not in expected:
            raise RunError(
                Tune.Result.MACHINE_ERROR,
                f"the machine refused evaluation {run.index}: {answer.error_msg}",
            )
        return answer

    def _report(self, run: Run, message: msg.Evaluation, goal_handle: ServerGoalHandle) -> None:
        """Tell the world of an evaluation: topics, feedback, status."""
        self._publishers.evaluation(message)
        if message.non_dominated:
            self._publishers.front(self._front(run))
        goal_handle.publish_feedback(
            Tune.Feedback(evaluation=message, evaluations=run.index, budget=run.budget)
        )
        self._set_status(
            evaluations=run.index,
            failed=self._status.failed + (not message.valid),
            feasible=self._status.feasible + message.feasible,
            hypervolume=message.hypervolume,
        )

    def _judge(self, run: Run, message: msg.Evaluation) -> None:
        """End a run whose evaluations keep failing.

        Raises:
            RunError: too many failed in a row.
        """
        if message.valid:
            run.consecutive_failures = 0
            return
        run.consecutive_failures += 1
        self._log.warning(
            f"evaluation {message.index} failed: {message.error_msg or 'not fully measured'}"
        )
        limit = self._parameters["max_consecutive_failures"]
        if run.consecutive_failures >= limit:
            raise RunError(
                Tune.Result.MACHINE_ERROR,
                f"{limit} evaluations failed in a row: {message.error_msg}",
            )

    # ------------------------------------------------------------------ small things

    @staticmethod
    def _interrupt(run: Run, reason: str) -> None:
        if not run.interrupt.done():
            run.interrupt.set_result(reason)

    def _problem_message(self, run: Run) -> msg.Problem:
        return problem_message(self.problem, run.run_id, self.node.get_clock().now().to_msg())

    def _front(self, run: Run) -> msg.ParetoFront:
        return front_message(
            self.problem,
            run.optimizer.pareto_front(),
            run.optimizer.hypervolume,
            run.run_id,
            self.node.get_clock().now().to_msg(),
        )

    def _set_status(self, publish: bool = True, **fields: object) -> None:
        for name, value in fields.items():
            setattr(self._status, name, value)
        if publish:
            self._publish_status()

    def _publish_status(self) -> None:
        self._status.stamp = self.node.get_clock().now().to_msg()
        self._publishers.status(self._status)


def main() -> None:
    """Run the tuner node."""
    exit_process(run_node(Tuner))


if __name__ == "__main__":
    main()
