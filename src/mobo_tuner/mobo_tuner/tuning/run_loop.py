"""What one run does: propose, have the machine evaluate, learn, tell the world; again and again."""

from __future__ import annotations

import time
from collections.abc import Callable

from rclpy.task import Future

from mobo_msgs_py import msg
from mobo_msgs_py.action import EvaluateSetpoint, Tune
from mobo_tuner.core import ProblemError
from mobo_tuner.ros.conversions import problem_message
from mobo_tuner.ros.machine_client import Answer, MachineLostError
from mobo_tuner.ros.waiting import first_of
from mobo_tuner.tuning.parts import TunerParts
from mobo_tuner.tuning.run import Run, RunError, Suggestion

_RESULT = EvaluateSetpoint.Result
# What the machine did go for and could not measure: an evaluation that failed, to be learned from.
_FAILED_EVALUATION = (_RESULT.TIMEOUT, _RESULT.INVALID_MEASUREMENT, _RESULT.UNKNOWN)

Teller = Callable[[msg.Evaluation], None]


class RunLoop:
    """Carries out runs, one at a time.

    Args:
        parts: of the tuner's node.
    """

    def __init__(self, parts: TunerParts) -> None:
        self._parts = parts

    async def carry_out(self, run: Run, tell: Teller) -> None:
        """Go on with a run until it is done or interrupted.

        Args:
            run: that has begun.
            tell: is told of every evaluation, after the topics.

        Raises:
            RunError: it cannot go on.
        """
        self._announce(run)
        await self._meet_machine(run)
        run.step_started = time.perf_counter()
        suggestion = self._parts.worker.submit(run.suggest)
        while not run.interrupted:
            message = await self._step(run, suggestion)
            if message is None:
                return
            finished = run.goal_met or run.index >= run.budget
            if not finished:  # computed while the world is told of this evaluation
                suggestion = self._parts.worker.submit(run.suggest)
            self._report(run, message)
            tell(message)
            self._judge(run, message)
            if finished:
                return

    def _announce(self, run: Run) -> None:
        parts = self._parts
        parts.publishers.problem(problem_message(run.problem, run.run_id, parts.now()))
        parts.publishers.front(run.front(parts.now()))
        parts.status.set(
            state=msg.TunerStatus.WAITING,
            run_id=run.run_id,
            budget=run.budget,
            evaluations=run.index,
            failed=run.failed,
            feasible=run.feasible,
            hypervolume=run.optimizer.hypervolume,
            message="",
        )

    async def _meet_machine(self, run: Run) -> None:
        try:
            machine = await self._parts.machine.describe(
                run.interrupt, self._parts.parameters["discovery_timeout"]
            )
        except MachineLostError as error:
            raise RunError(Tune.Result.MACHINE_UNAVAILABLE, str(error)) from None
        if machine is None:
            return
        try:
            run.problem.check_machine(
                {v.name: (v.min, v.max) for v in machine.variables},
                {d.name: d.unit for d in machine.diagnostics},
                {v.name: v.unit for v in machine.variables},
            )
        except ProblemError as error:
            raise RunError(Tune.Result.MACHINE_UNAVAILABLE, str(error)) from None
        self._parts.log.info(f"run '{run.run_id}' tunes '{machine.name}'")

    async def _step(self, run: Run, suggestion: Future) -> msg.Evaluation | None:
        """One evaluation; None when it was interrupted, which leaves no trace in the data."""
        parts = self._parts
        parts.status.set(state=msg.TunerStatus.SUGGESTING, phase="", fraction=0.0)
        patience = parts.parameters["suggestion_timeout"]
        done = await first_of(parts.node, suggestion, run.interrupt, timeout=patience)
        if run.interrupted:
            return None
        if done is None:
            raise RunError(Tune.Result.INTERNAL, f"no suggestion came within {patience:g} s")
        suggested: Suggestion = suggestion.result()

        parts.status.set(state=msg.TunerStatus.EVALUATING)
        answer = await self._evaluate(run, suggested.setpoint)
        if answer.error_code == _RESULT.CANCELED:
            if not run.interrupted:
                raise RunError(
                    Tune.Result.MACHINE_ERROR, f"the machine stopped: {answer.error_msg}"
                )
            return None
        message: msg.Evaluation = await parts.worker.submit(run.learn, suggested, answer)
        return message

    async def _evaluate(self, run: Run, setpoint: dict[str, float]) -> Answer:
        def on_feedback(feedback: EvaluateSetpoint.Feedback) -> None:
            self._parts.status.set(publish=False, phase=feedback.phase, fraction=feedback.fraction)

        try:
            answer = await self._parts.machine.evaluate(
                run.problem,
                run.run_id,
                run.index,
                setpoint,
                self._parts.parameters["shots"],
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

    def _report(self, run: Run, message: msg.Evaluation) -> None:
        """Tell the world of an evaluation."""
        parts = self._parts
        parts.publishers.evaluation(message)
        if message.non_dominated:
            parts.publishers.front(run.front(parts.now()))
        parts.status.set(
            evaluations=run.index,
            failed=run.failed,
            feasible=run.feasible,
            hypervolume=message.hypervolume,
        )

    def _judge(self, run: Run, message: msg.Evaluation) -> None:
        """End a run whose evaluations keep failing.

        Raises:
            RunError: too many failed in a row.
        """
        if message.valid:
            return
        self._parts.log.warning(
            f"evaluation {message.index} failed: {message.error_msg or 'not fully measured'}"
        )
        limit = self._parts.parameters["max_consecutive_failures"]
        if run.consecutive_failures >= limit:
            raise RunError(
                Tune.Result.MACHINE_ERROR,
                f"{limit} evaluations failed in a row: {message.error_msg}",
            )
