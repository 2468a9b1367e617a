"""What one run does: propose, have the machine evaluate, learn, tell the world; again and again."""

from __future__ import annotations

import time
from collections.abc import Callable

from rclpy.task import Future

from mobo_msgs_py import msg
from mobo_msgs_py.action import EvaluateSetpoint, Tune
from mobo_tuner.core import ProblemError
from mobo_tuner.ros.conversions import seconds
from mobo_tuner.ros.waiting import first_of
from mobo_tuner.tuner.context import TunerParts
from mobo_tuner.tuner.machine_client import MachineLostError
from mobo_tuner.tuner.run.attempts import Attempts
from mobo_tuner.tuner.run.fallbacks import Ends
from mobo_tuner.tuner.run.republish import repeat
from mobo_tuner.tuner.run.run import Outcome, Run, RunError, Suggestion
from mobo_tuner.tuner.run.steering import check_bounds

PAUSE_PERIOD = 3600.0  # [s] after which a paused run looks round, with nothing to see

Teller = Callable[[msg.Evaluation], None]


class RunLoop:
    """Carries out runs, one at a time.

    Args:
        parts: of the tuner's node.
        ends: where the machine goes when something happens.
    """

    def __init__(self, parts: TunerParts, ends: Ends) -> None:
        self._parts = parts
        self._ends = ends
        self._attempts = Attempts(parts, ends)

    async def carry_out(self, run: Run, tell: Teller) -> None:
        """Go on with a run until it is done, interrupted or asked to end.

        Args:
            run: that has begun.
            tell: is told of every evaluation, after the topics.

        Raises:
            RunError: it cannot go on.
        """
        self._announce(run)
        await repeat(run.earlier, self._parts)
        await self._meet_machine(run)
        run.step_started = time.perf_counter()
        suggestion = self._parts.worker.submit(run.suggest)
        while not run.finished:
            suggested = await self._next(run, suggestion)
            if suggested is None:
                return
            outcome = await self._evaluate(run, suggested)
            if outcome is None:
                return
            problem = run.problem
            message = await self._parts.worker.submit(run.learn, suggested, outcome)
            if run.problem is not problem:  # its reference point was inferred
                self._publish_all(run)
            run.steering.forget_skip()
            if not run.finished:  # computed while the world is told of this evaluation
                suggestion = self._parts.worker.submit(run.suggest)
            self._report(run, message)
            tell(message)
            self._judge(run, message)

    # ------------------------------------------------------------------ the start

    def _announce(self, run: Run) -> None:
        self._parts.status.set(
            state=msg.TunerStatus.WAITING, run_id=run.run_id, phase="", fraction=0.0, message=""
        )
        self._parts.status.set(publish=False, stop_reason="")
        self._publish_all(run)

    def _publish_all(self, run: Run) -> None:
        """What is tuned and what there is of it, when a run begins or its problem changes."""
        parts = self._parts
        parts.publishers.problem(run.problem_message(parts.now()))
        parts.publishers.front(run.front(parts.now()))
        self._publish_figures(run)

    def _publish_figures(self, run: Run) -> None:
        self._parts.status.set(
            budget=run.budget,
            evaluations=run.index,
            failed=run.failed,
            feasible=run.feasible,
            hypervolume=run.optimizer.hypervolume,
        )

    async def _meet_machine(self, run: Run) -> None:
        parts = self._parts
        try:
            machine = await parts.machine.describe(
                parts.parameters["discovery_timeout"], run.interrupt
            )
            if machine is None:
                return
            run.meet(machine)
        except (MachineLostError, ProblemError) as error:
            raise RunError(Tune.Result.MACHINE_UNAVAILABLE, str(error)) from None
        await self._ends.prepare(run)
        parts.log.info(f"run '{run.run_id}' tunes '{machine.name}'")

    # ------------------------------------------------------------------ between two evaluations

    async def _next(self, run: Run, suggestion: Future) -> Suggestion | None:
        """What to evaluate next, once the run may; None when it shall not go on.

        One suggestion is made for every evaluation, whatever becomes of it, so that a run depends
        on what was asked of it and not on the moment.
        """
        steering = run.steering
        while True:
            if run.interrupted or steering.stopping:
                return None
            if steering.change is not None:
                if await self._suggested(run, suggestion) is None:
                    return None
                await self._apply_change(run)
                if run.finished:
                    return None
                suggestion = self._parts.worker.submit(run.suggest)
            suggested = await self._suggested(run, suggestion)
            if run.interrupted or suggested is None:
                return None
            if steering.change is not None or steering.stopping:
                continue
            if not steering.waits:
                break
            self._parts.status.set(
                state=msg.TunerStatus.PAUSED, message=f"paused before evaluation {run.index}"
            )
            await first_of(self._parts.node, run.interrupt, steering.news, timeout=PAUSE_PERIOD)
        self._parts.status.set(message="")
        steering.take_step()
        while steering.queue:
            setpoint = steering.queue.popleft()
            try:
                check_bounds(run.problem, setpoint)  # which may have changed since
            except ProblemError as error:
                self._parts.log.warning(f"a queued set-point is dropped: {error}")
                continue
            return Suggestion(setpoint, "operator", suggested.seconds)
        return suggested

    async def _suggested(self, run: Run, suggestion: Future) -> Suggestion | None:
        """The suggestion, once it is computed; None when interrupted."""
        parts = self._parts
        if not suggestion.done():
            parts.status.set(state=msg.TunerStatus.SUGGESTING, phase="", fraction=0.0)
        patience = parts.parameters["suggestion_timeout"]
        done = await first_of(parts.node, suggestion, run.interrupt, timeout=patience)
        if run.interrupted:
            return None
        if done is None:
            raise RunError(Tune.Result.INTERNAL, f"no suggestion came within {patience:g} s")
        suggested: Suggestion = suggestion.result()
        return suggested

    async def _apply_change(self, run: Run) -> None:
        change, run.steering.change = run.steering.change, None
        assert change is not None
        await self._parts.worker.submit(run.apply, change, seconds(self._parts.now()))
        self._parts.log.info(f"run '{run.run_id}' is changed before evaluation {run.index}")
        self._publish_all(run)

    # ------------------------------------------------------------------ an evaluation

    async def _evaluate(self, run: Run, suggested: Suggestion) -> Outcome | None:
        """What became of an evaluation; None when it was interrupted, which leaves no trace."""
        if run.steering.skip.done():
            return Outcome(self._attempts.skipped(), 0)
        return await self._attempts.evaluate(run, suggested.setpoint)

    def _report(self, run: Run, message: msg.Evaluation) -> None:
        """Tell the world of an evaluation."""
        parts = self._parts
        parts.publishers.evaluation(message)
        if message.non_dominated:
            parts.publishers.front(run.front(parts.now()))
        parts.status.set(publish=False, message="")
        self._publish_figures(run)

    def _judge(self, run: Run, message: msg.Evaluation) -> None:
        """After a failed evaluation, pause or end the run where the parameters say so.

        Raises:
            RunError: it ends.
        """
        if message.valid:
            return
        reason = message.error_msg
        self._parts.log.warning(f"evaluation {message.index} failed: {reason}")
        parameters = self._parts.parameters
        if message.error_code == EvaluateSetpoint.Result.CANCELED:
            return
        if parameters["on_failure"] == "abort":
            raise RunError(
                Tune.Result.MACHINE_ERROR, f"evaluation {message.index} failed: {reason}"
            )
        limit = parameters["max_consecutive_failures"]
        if run.consecutive_failures >= limit:
            raise RunError(
                Tune.Result.MACHINE_ERROR, f"{limit} evaluations failed in a row: {reason}"
            )
        if (
            message.error_code == EvaluateSetpoint.Result.VIOLATION
            and parameters["pause_on_violation"]
        ):
            run.steering.paused = True
            run.steering.steps = 0
