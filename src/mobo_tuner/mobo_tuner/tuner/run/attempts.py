"""One evaluation by the machine: retried, given up or waited for, as the parameters say."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from typing import Literal, NamedTuple

from mobo_msgs_py import msg
from mobo_msgs_py.action import EvaluateSetpoint, Tune
from mobo_tuner.core import ProblemError
from mobo_tuner.ros.waiting import first_of
from mobo_tuner.tuner.context import TunerContext
from mobo_tuner.tuner.gate import BoundsError, EvaluationRequest
from mobo_tuner.tuner.machine_client import Answer, MachineLostError
from mobo_tuner.tuner.messages import constraint_messages
from mobo_tuner.tuner.parameters import TunerParameters
from mobo_tuner.tuner.run.fallbacks import Fallbacks
from mobo_tuner.tuner.run.run import Outcome, Run, RunError, measured_nothing

_CODES = EvaluateSetpoint.Result
# The machine went there but could not measure: a failed evaluation, from which the models learn.
_FAILED = (_CODES.TIMEOUT, _CODES.INVALID_MEASUREMENT, _CODES.UNKNOWN)
# The machine or the connection to it was lost: nothing is known of the set-point.
_LOST = (_CODES.MACHINE_LOST, _CODES.CLIENT_LOST)
# The machine refuses to move, which may pass.
_REFUSED = (_CODES.INTERLOCK, _CODES.NOT_ACTIVE)
SHORTEST_DELAY, LONGEST_DELAY = 0.1, 60.0  # [s] between two attempts


class Decision(NamedTuple):
    """What happens after an answer of the machine.

    Attributes:
        action: "accept" the answer as the outcome, try "again" after `delay`, "wait" for a lost machine
            to return, or "fail": the run ends.
        delay: Time until the next attempt [s].
        counts: Whether the attempt counts against `max_attempts`.
    """

    action: Literal["accept", "again", "wait", "fail"]
    delay: float = 0.0
    counts: bool = True


class Loss:
    """How long a lost machine is waited for: from its loss until it works again.

    Args:
        patience: Time that it is waited for in all [s].
        clock: Steady clock [s].
    """

    def __init__(self, patience: float, clock: Callable[[], float] = time.monotonic) -> None:
        self.patience = patience
        self._clock = clock
        self._deadline: float | None = None

    def begin(self) -> bool:
        """Note that the machine was lost; return whether that is new."""
        new = self._deadline is None
        if new:
            self._deadline = self._clock() + self.patience
        return new

    def end(self) -> None:
        """Note that the machine works again."""
        self._deadline = None

    @property
    def active(self) -> bool:
        """Whether the machine was lost and there is patience left."""
        return self.remaining() > 0.0

    def remaining(self) -> float:
        """Return the patience that is left [s]; 0 if the machine is not lost."""
        return 0.0 if self._deadline is None else max(0.0, self._deadline - self._clock())


def decide(answer: Answer, tries: int, loss: Loss, parameters: TunerParameters) -> Decision:
    """Decide what happens after an answer.

    Args:
        answer: Answer of the machine to the last attempt.
        tries: Number of attempts that count, the last one included.
        loss: Whether the machine was lost before.
        parameters: Parameters of the tuner.
    """
    code = answer.error_code
    if code in _LOST:
        return Decision("wait", counts=False)
    if loss.active and code in (_CODES.BUSY, *_REFUSED):
        # It has just returned: it may not be ready, or be on its way back; a bridge that has just
        # started does not know its interlocks yet.
        return Decision("again", parameters.retry_delay, counts=False)
    # A busy machine may still be stopping what was before, whatever the policy.
    retried = parameters.on_failure == "retry" and code in (*_FAILED, *_REFUSED)
    if tries < parameters.max_attempts and (retried or code == _CODES.BUSY):
        return Decision("again", min(parameters.retry_delay * 2.0 ** (tries - 1), LONGEST_DELAY))
    return Decision("accept" if code in (_CODES.NONE, _CODES.VIOLATION, *_FAILED) else "fail")


class Attempts:
    """Has set-points evaluated by the machine.

    Args:
        context: The tuner's node and what works in it.
        fallbacks: Fallbacks of the machine after a failed evaluation.
    """

    def __init__(self, context: TunerContext, fallbacks: Fallbacks) -> None:
        self._context = context
        self._fallbacks = fallbacks

    async def evaluate(self, run: Run, setpoint: dict[str, float]) -> Outcome | None:
        """Have the next evaluation of a run made; None if it was interrupted, which leaves no trace.

        An evaluation that was skipped has the error CANCELED.

        Raises:
            RunError: If the machine was lost for too long, or refuses the evaluation.
        """
        run.evaluating = True
        try:
            return await self._evaluate(run, setpoint)
        finally:
            run.evaluating = False

    async def _evaluate(self, run: Run, setpoint: dict[str, float]) -> Outcome | None:
        loss = Loss(self._context.parameters.machine_return_timeout)
        attempts = tries = 0
        while True:
            try:
                answer = await self._attempt(run, setpoint, attempts, loss)
            except BoundsError as error:
                return self._out_of_bounds(run, f"the bounds were changed: {error}", attempts)
            attempts += 1
            if answer.error_code == _CODES.NONE:
                return Outcome(answer, attempts)
            if not _stopped(run):
                decision = decide(answer, tries + 1, loss, self._context.parameters)
                if decision.action == "accept":
                    return Outcome(answer, attempts)
                tries += decision.counts
                await self._follow(run, decision, answer, loss)
            if run.interrupted:
                return None
            if run.steering.skip.done():
                return Outcome(self._canceled("skipped by an operator"), attempts)

    def _out_of_bounds(self, run: Run, reason: str, attempts: int) -> Outcome | None:
        """Give up an evaluation that new bounds forbid; a run that cannot change its bounds stops."""
        if run.changeable:
            return Outcome(self._canceled(reason), attempts)
        run.stop(reason)
        return None

    def _canceled(self, reason: str) -> Answer:
        return Answer(_CODES.CANCELED, reason, self._context.stamp())

    async def _follow(self, run: Run, decision: Decision, answer: Answer, loss: Loss) -> None:
        """Do what was decided before the next attempt.

        Raises:
            RunError: If there is no next attempt.
        """
        if decision.action == "wait":
            await self._await_return(run, answer.error_msg, loss)
        elif decision.action == "fail":
            what = "stopped: "
            if answer.error_code != _CODES.CANCELED:
                what = f"refused evaluation {run.index}: "
            raise RunError(Tune.Result.MACHINE_ERROR, f"the machine {what}{answer.error_msg}")
        else:
            if decision.counts:
                self._warn(run, answer, decision.delay)
            await self._pause(run, decision.delay)

    def _warn(self, run: Run, answer: Answer, delay: float) -> None:
        text = f"evaluation {run.index} failed: {answer.error_msg}; next attempt in {delay:g} s"
        self._context.log.warning(text)
        self._context.status.set(message=text)

    async def _attempt(
        self, run: Run, setpoint: dict[str, float], attempt: int, loss: Loss
    ) -> Answer:
        """Return the machine's answer to one attempt; a machine that does not answer is lost."""
        context = self._context
        request = EvaluationRequest(
            run_id=run.run_id,
            index=run.index,
            attempt=attempt,
            setpoint=setpoint,
            shots=context.parameters.shots,
            critical=constraint_messages(run.problem, critical_only=True),
            client_timeout=context.parameters.client_timeout,
            if_client_lost=self._fallbacks.target(run, "on_client_lost"),
            if_violated=self._fallbacks.target(run, "on_violation"),
        )

        def on_feedback(feedback: EvaluateSetpoint.Feedback) -> None:
            loss.end()
            context.status.progress(feedback.phase, feedback.fraction)

        context.status.work(msg.TunerStatus.EVALUATING)
        try:
            answer = await context.gate.evaluate(
                request, run.problem.units, on_feedback, run.interrupt, run.steering.skip
            )
        except MachineLostError as error:
            return Answer(_CODES.MACHINE_LOST, str(error), context.stamp())
        if answer.error_code == _CODES.NONE and measured_nothing(run.problem, answer):
            names = ", ".join(run.problem.required_diagnostics)
            return replace(
                answer,
                error_code=_CODES.INVALID_MEASUREMENT,
                error_msg=f"the machine measured none of {names}",
            )
        return answer

    async def _pause(self, run: Run, seconds: float) -> None:
        timeout = max(seconds, SHORTEST_DELAY)
        await first_of(self._context.node, run.interrupt, run.steering.skip, timeout=timeout)

    async def _await_return(self, run: Run, reason: str, loss: Loss) -> None:
        """Wait until the lost machine is there again, or the run is interrupted.

        Raises:
            RunError: If it did not return in time.
        """
        context, patience = self._context, loss.patience
        if patience <= 0.0:
            raise RunError(Tune.Result.MACHINE_LOST, reason)
        if loss.begin():
            context.log.warning(f"{reason}; the run waits up to {patience:g} s for its return")
        context.status.work(msg.TunerStatus.WAITING, f"{reason}; waiting for its return")
        try:
            await self._pause(run, context.parameters.retry_delay)
            machine = await context.gate.describe(
                loss.remaining(), run.interrupt, run.steering.skip
            )
            if machine is None:
                return
            run.meet(machine)
        except MachineLostError:
            raise RunError(
                Tune.Result.MACHINE_LOST, f"{reason}, and did not return within {patience:g} s"
            ) from None
        except ProblemError as error:
            raise RunError(Tune.Result.MACHINE_LOST, f"{reason}; {error}") from None
        context.log.info(f"'{machine.name}' is there again")
        context.status.set(message="")


def _stopped(run: Run) -> bool:
    return run.interrupted or run.steering.skip.done()
