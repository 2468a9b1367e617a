"""One evaluation by the machine: tried again, given up or waited for, as the parameters say."""

from __future__ import annotations

import time
from dataclasses import replace

from mobo_msgs_py import msg
from mobo_msgs_py.action import EvaluateSetpoint, Tune
from mobo_tuner.core import ProblemError
from mobo_tuner.ros.conversions import named_values
from mobo_tuner.ros.waiting import first_of
from mobo_tuner.tuner.context import TunerParts
from mobo_tuner.tuner.machine_client import Answer, MachineLostError
from mobo_tuner.tuner.messages import constraint_messages, problem_units
from mobo_tuner.tuner.run.fallbacks import Ends
from mobo_tuner.tuner.run.run import Outcome, Run, RunError, missing_diagnostics

_RESULT = EvaluateSetpoint.Result
# What the machine did go for and could not measure: an evaluation that failed, to be learned from.
_FAILED = (_RESULT.TIMEOUT, _RESULT.INVALID_MEASUREMENT, _RESULT.UNKNOWN)
# The machine or the way to it was lost: nothing is known of the set-point.
_LOST = (_RESULT.MACHINE_LOST, _RESULT.CLIENT_LOST)
# The machine would not, which may pass.
_REFUSED = (_RESULT.INTERLOCK, _RESULT.NOT_ACTIVE)
# The machine is there and will be ready, after what went before; a bridge that has just started does
# not know its interlocks yet.
_SOON = (_RESULT.BUSY, *_REFUSED)
SHORTEST_DELAY, LONGEST_DELAY = 0.1, 60.0  # [s] between two attempts


class Attempts:
    """Has set-points evaluated.

    Args:
        parts: of the tuner's node.
        ends: where the machine goes when something happens.
    """

    def __init__(self, parts: TunerParts, ends: Ends) -> None:
        self._parts = parts
        self._ends = ends

    async def evaluate(self, run: Run, setpoint: dict[str, float]) -> Outcome | None:
        """Have the next evaluation of a run made; None when the run was interrupted.

        An evaluation that was skipped has the error CANCELED.

        Raises:
            RunError: the machine was lost, or it refuses what it must not.
        """
        loss = _Loss(self._parts.parameters["machine_return_timeout"])
        attempts = tries = 0
        while True:
            answer = await self._attempt(run, setpoint, attempts, loss)
            attempts += 1
            if answer.error_code == _RESULT.NONE:
                return Outcome(answer, attempts)
            if not _stopped(run):
                if answer.error_code in _LOST:
                    await self._await_return(run, answer.error_msg, loss)
                elif answer.error_code in _SOON and loss.going_on:
                    # The machine is there again, but not ready yet: it may be on its way back.
                    await self._pause(run, self._parts.parameters["retry_delay"])
                else:
                    tries += 1
                    if not self._shall_retry(answer, tries):
                        self._check(run, answer)
                        return Outcome(answer, attempts)
                    await self._back_off(run, answer, tries)
            if run.interrupted:
                return None
            if run.steering.skip.done():
                return Outcome(self.skipped(), attempts)

    def skipped(self) -> Answer:
        """What becomes of an evaluation that an operator skips."""
        return Answer(_RESULT.CANCELED, "skipped by an operator", self._parts.now())

    async def _attempt(
        self, run: Run, setpoint: dict[str, float], attempt: int, loss: _Loss
    ) -> Answer:
        """One attempt; a machine that does not answer is an answer, too."""
        parts, units = self._parts, problem_units(run.problem)
        goal = EvaluateSetpoint.Goal(
            run_id=run.run_id,
            index=run.index,
            attempt=attempt,
            setpoint=named_values(setpoint, units),
            shots=parts.parameters["shots"],
            critical=constraint_messages(run.problem, critical_only=True),
            client_timeout=parts.parameters["client_timeout"],
            if_client_lost=named_values(self._ends.target(run, "on_client_lost"), units),
            if_violated=named_values(self._ends.target(run, "on_violation"), units),
        )

        def on_feedback(feedback: EvaluateSetpoint.Feedback) -> None:
            loss.end()  # it is at work
            parts.status.set(publish=False, phase=feedback.phase, fraction=feedback.fraction)

        parts.status.set(state=msg.TunerStatus.EVALUATING, phase="", fraction=0.0)
        run.evaluating = True
        try:
            answer = await parts.machine.evaluate(
                goal, on_feedback, run.interrupt, run.steering.skip
            )
        except MachineLostError as error:
            return Answer(_RESULT.MACHINE_LOST, str(error), parts.now())
        finally:
            run.evaluating = False
        missing = missing_diagnostics(run.problem, answer)
        if answer.error_code == _RESULT.NONE and missing:
            return replace(
                answer,
                error_code=_RESULT.INVALID_MEASUREMENT,
                error_msg=f"the machine did not measure {', '.join(missing)}",
            )
        return answer

    def _shall_retry(self, answer: Answer, tries: int) -> bool:
        if tries >= self._parts.parameters["max_attempts"]:
            return False
        if answer.error_code == _RESULT.BUSY:  # it may still be stopping what was before
            return True
        retried = self._parts.parameters["on_failure"] == "retry"
        return retried and answer.error_code in (*_FAILED, *_REFUSED)

    async def _back_off(self, run: Run, answer: Answer, tries: int) -> None:
        """Wait before the next attempt, longer each time."""
        delay = min(self._parts.parameters["retry_delay"] * 2.0 ** (tries - 1), LONGEST_DELAY)
        text = f"evaluation {run.index} failed: {answer.error_msg}; it is tried again"
        self._parts.log.warning(f"{text} in {delay:g} s")
        self._parts.status.set(message=text)
        await self._pause(run, delay)

    async def _pause(self, run: Run, seconds: float) -> None:
        await first_of(
            self._parts.node,
            run.interrupt,
            run.steering.skip,
            timeout=max(seconds, SHORTEST_DELAY),
        )

    def _check(self, run: Run, answer: Answer) -> None:
        """Raise RunError where an answer is none that can be learned from."""
        if answer.error_code == _RESULT.CANCELED:
            raise RunError(Tune.Result.MACHINE_ERROR, f"the machine stopped: {answer.error_msg}")
        if answer.error_code not in (_RESULT.NONE, _RESULT.VIOLATION, *_FAILED):
            raise RunError(
                Tune.Result.MACHINE_ERROR,
                f"the machine refused evaluation {run.index}: {answer.error_msg}",
            )

    async def _await_return(self, run: Run, reason: str, loss: _Loss) -> None:
        """Wait until the machine that was lost is there again, or the run is interrupted.

        Raises:
            RunError: it did not return in time.
        """
        parts, patience = self._parts, loss.patience
        if patience <= 0.0:
            raise RunError(Tune.Result.MACHINE_LOST, reason)
        if loss.begin():
            parts.log.warning(f"{reason}; the run waits up to {patience:g} s for its return")
        parts.status.set(
            state=msg.TunerStatus.WAITING,
            phase="",
            fraction=0.0,
            message=f"{reason}; waiting for its return",
        )
        try:
            await self._pause(run, parts.parameters["retry_delay"])
            machine = await parts.machine.describe(
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
        parts.log.info(f"'{machine.name}' is there again")
        parts.status.set(message="")


class _Loss:
    """How long a machine that was lost is waited for yet: from its loss until it is at work again.

    Attributes:
        patience: how long in all [s].
    """

    def __init__(self, patience: float) -> None:
        self.patience = patience
        self._deadline: float | None = None

    def begin(self) -> bool:
        """The machine was lost; whether that is new."""
        new = self._deadline is None
        if new:
            self._deadline = time.monotonic() + self.patience
        return new

    def end(self) -> None:
        """It is at work again."""
        self._deadline = None

    @property
    def going_on(self) -> bool:
        """Whether it was lost and there is patience left."""
        return self._deadline is not None and time.monotonic() < self._deadline

    def remaining(self) -> float:
        """Seconds of patience from now."""
        return 0.0 if self._deadline is None else max(0.0, self._deadline - time.monotonic())


def _stopped(run: Run) -> bool:
    return run.interrupted or run.steering.skip.done()
