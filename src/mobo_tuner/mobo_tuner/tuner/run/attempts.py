"""One evaluation by the machine: retried, given up or waited for, as the parameters say."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Literal, NamedTuple

from rclpy.task import Future

from mobo_msgs_py import msg
from mobo_msgs_py.action import EvaluateSetpoint, Tune
from mobo_tuner.core import ProblemError
from mobo_tuner.ros.waiting import first_of
from mobo_tuner.runs.records import PAUSED_DURING
from mobo_tuner.tuner.context import TunerContext
from mobo_tuner.tuner.gate import BoundsError, EvaluationRequest
from mobo_tuner.tuner.machine_client import Answer, MachineLostError
from mobo_tuner.tuner.messages import constraint_messages
from mobo_tuner.tuner.parameters import TunerParameters
from mobo_tuner.tuner.run.fallbacks import Fallbacks
from mobo_tuner.tuner.run.run import Outcome, Run, RunError, checked

_CODES = EvaluateSetpoint.Result
# The machine went there but could not measure: a failed evaluation, from which the models learn.
_FAILED = (_CODES.TIMEOUT, _CODES.INVALID_MEASUREMENT, _CODES.UNKNOWN)
# The machine or the connection to it was lost: nothing is known of the set-point.
_LOST = (_CODES.MACHINE_LOST, _CODES.CLIENT_LOST)
# The machine forbids to move, which may pass.
_FORBIDDEN = (_CODES.INTERLOCK, _CODES.NOT_ACTIVE)
SHORTEST_DELAY, LONGEST_DELAY = 0.1, 60.0  # [s] between two attempts
PAUSE_PERIOD = 3600.0  # [s] between two looks of a paused run at requests, which also wake it up
CLOCK_ERROR = 60.0  # [s] by which the machine's clock may differ from that of the tuner
WARNING_PERIOD = 60.0  # [s] between two warnings of its clock
_MOST_ATTEMPTS = 2**16 - 1  # that a goal can count


class Decision(NamedTuple):
    """What happens after an answer of the machine.

    Attributes:
        action: "accept" the answer as the outcome, try "again" after `delay`, "wait" until the machine is
            back or allows to move, "pause" until an operator resumes, or "fail": the run ends.
        delay: Time until the next attempt [s].
        counts: Whether the attempt counts against `max_attempts`.
    """

    action: Literal["accept", "again", "wait", "pause", "fail"]
    delay: float = 0.0
    counts: bool = True


class Loss:
    """How long a machine is waited for: from when it was lost or forbade to move until it works again.

    The times of an evaluation add up, so that a permit that comes and goes is not waited for without end.

    Args:
        patience: Time that it is waited for in all [s].
        clock: Steady clock [s].

    Attributes:
        count: How often it was lost or forbade to move.
    """

    def __init__(self, patience: float, clock: Callable[[], float] = time.monotonic) -> None:
        self.patience = patience
        self._clock = clock
        self._began: float | None = None
        self._spent = 0.0
        self.count = 0

    def begin(self) -> bool:
        """Note that the machine does not work; return whether that is new."""
        new = self._began is None
        if new:
            self._began = self._clock()
            self.count += 1
        return new

    def end(self) -> float | None:
        """Note that the machine works; return how long it did not [s], or None if it did all the time."""
        began, self._began = self._began, None
        if began is None:
            return None
        seconds = self._clock() - began
        self._spent += seconds
        return seconds

    @property
    def active(self) -> bool:
        """Whether the machine does not work and there is patience left."""
        return self.remaining() > 0.0

    def remaining(self) -> float:
        """Return the patience that is left [s]; 0 if the machine works."""
        if self._began is None:
            return 0.0
        return max(0.0, self._began + self.patience - self._spent - self._clock())

    def told(self, reason: str) -> str:
        """Return a reason, with how often it has come if that is more than once."""
        return reason if self.count < 2 else f"{reason}, {self.count} times in this evaluation"


def decide(answer: Answer, tries: int, loss: Loss, parameters: TunerParameters) -> Decision:
    """Decide what happens after an answer.

    Args:
        answer: Answer of the machine to the last attempt.
        tries: Number of attempts that count, the last one included.
        loss: Whether the machine was lost before.
        parameters: Parameters of the tuner.
    """
    code = answer.error_code
    if loss.active and code in (_CODES.BUSY, *_FORBIDDEN):
        # It has just returned: it may not be ready, or be on its way back; a bridge that has just
        # started does not know its interlocks yet.
        return Decision("again", parameters.retry_delay, counts=False)
    if code in (_CODES.NONE, _CODES.VIOLATION):
        return Decision("accept")
    if code in _FAILED:
        policy = {"retry": "retry", "ask": "pause"}.get(parameters.on_failure, "accept")
    elif code in _LOST:
        policy = parameters.on_fault
    elif code in _FORBIDDEN:
        policy = parameters.on_interlock
    else:
        # A busy machine may still be stopping what was before, whatever the policy.
        policy = "retry" if code == _CODES.BUSY else "abort"
    if policy == "retry" and tries < parameters.max_attempts:
        return Decision("again", min(parameters.retry_delay * 2.0 ** (tries - 1), LONGEST_DELAY))
    if policy in ("wait", "pause"):
        return Decision("wait" if policy == "wait" else "pause", counts=False)
    return Decision("accept" if code in _FAILED else "fail")


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

        An evaluation that was skipped has the error CANCELED, or that of which an operator was asked.

        Raises:
            RunError: If the machine was lost for too long, or refuses the evaluation.
        """
        run.evaluating, run.begun = True, run.index + 1
        try:
            return await self._evaluate(run, setpoint)
        finally:
            run.evaluating = run.obstructed = False

    async def _evaluate(self, run: Run, setpoint: dict[str, float]) -> Outcome | None:
        parameters = self._context.parameters
        lost = Loss(parameters.machine_return_timeout)
        forbidden = Loss(parameters.interlock_timeout)
        attempts = tries = 0
        while True:
            try:
                answer = await self._attempt(run, setpoint, attempts, (lost, forbidden))
            except BoundsError as error:
                return self._out_of_bounds(run, f"the bounds were changed: {error}", attempts)
            attempts += 1
            if answer.error_code == _CODES.NONE:
                return Outcome(answer, attempts)
            if not _stopped(run):
                self._context.status.fail(f"evaluation {run.index}: {answer.error_msg}")
                decision = decide(answer, tries + 1, lost, parameters)
                if decision.action == "accept":
                    return Outcome(answer, attempts)
                tries += decision.counts
                run.obstructed = decision.action in ("wait", "pause")
                waiting = lost if answer.error_code in _LOST else forbidden
                await self._follow(run, decision, answer, waiting)
                if run.obstructed and run.steering.stopping:
                    return None
            if run.interrupted:
                return None
            if run.steering.skip.done():
                if answer.error_code in _FAILED:  # of which an operator was asked: it teaches
                    run.steering.resume()
                    return Outcome(answer, attempts)
                return Outcome(self._canceled("skipped by an operator"), attempts)

    def _out_of_bounds(self, run: Run, reason: str, attempts: int) -> Outcome | None:
        """Give up an evaluation that new bounds forbid; a run that cannot change its bounds stops."""
        if run.changeable:
            return Outcome(self._canceled(reason), attempts)
        run.stop(reason)
        return None

    def _canceled(self, reason: str) -> Answer:
        return Answer(_CODES.CANCELED, reason, self._context.stamp())

    async def _attempt(
        self, run: Run, setpoint: dict[str, float], attempt: int, waits: Sequence[Loss]
    ) -> Answer:
        """Return the machine's answer to one attempt; a machine that does not answer is lost.

        What was waited for is over as soon as the machine says what it does.
        """
        context = self._context
        request = EvaluationRequest(
            run_id=run.run_id,
            index=run.index,
            attempt=min(attempt, _MOST_ATTEMPTS),
            setpoint=setpoint,
            shots=context.parameters.shots,
            critical=constraint_messages(run.problem, critical_only=True),
            client_timeout=context.parameters.client_timeout,
            if_client_lost=self._fallbacks.target(run, "on_client_lost"),
            if_violated=self._fallbacks.target(run, "on_violation"),
        )

        def on_feedback(feedback: EvaluateSetpoint.Feedback) -> None:
            run.obstructed = False
            waited = [seconds for wait in waits if (seconds := wait.end()) is not None]
            if waited:
                context.log.info(f"evaluation {run.index} continues after {max(waited):.1f} s")
                context.status.work(msg.TunerStatus.EVALUATING, "")
            context.status.progress(feedback.phase, feedback.fraction)

        if not any(wait.active for wait in waits):
            context.status.work(msg.TunerStatus.EVALUATING, "")
        began = context.stamp()
        try:
            answer = await context.gate.evaluate(
                request, run.problem.units, on_feedback, run.interrupt, run.steering.skip
            )
        except MachineLostError as error:
            return Answer(_CODES.MACHINE_LOST, str(error), context.stamp())
        answer = self._dated(answer, began)
        if answer.error_code == _CODES.NONE:
            return checked(run, setpoint, answer, "machine")
        return answer

    def _dated(self, answer: Answer, began: float) -> Answer:
        """Return an answer with a stamp between the beginning of the attempt and now, by which drift is judged."""
        now = self._context.stamp()
        earliest = min(began, now)  # unless the tuner's clock was set back meanwhile
        if earliest - CLOCK_ERROR <= answer.stamp <= now + CLOCK_ERROR:
            return answer
        self._context.log.warning(
            f"the machine's stamp is {answer.stamp:.0f} s, and it is {now:.0f} s now, which is kept: set its clock",
            throttle_duration_sec=WARNING_PERIOD,
        )
        return replace(answer, stamp=now)

    # ------------------------------------------------------------------ between two attempts

    async def _follow(self, run: Run, decision: Decision, answer: Answer, loss: Loss) -> None:
        """Do what was decided before the next attempt.

        Raises:
            RunError: If there is no next attempt.
        """
        reason, lost = answer.error_msg, answer.error_code in _LOST
        if decision.action == "pause":
            await self._await_operator(run, reason)
        elif decision.action == "wait":
            self._check_patience(run, reason, loss, lost)
            await (self._await_return if lost else self._await_permit)(run, reason, loss)
        elif decision.action == "fail":
            if lost:
                raise RunError(Tune.Result.MACHINE_LOST, reason)
            what = "stopped: "
            if answer.error_code != _CODES.CANCELED:
                what = f"refused evaluation {run.index}: "
            raise RunError(Tune.Result.MACHINE_ERROR, f"the machine {what}{reason}")
        elif decision.counts:
            text = f"evaluation {run.index} failed: {reason}; next attempt in {decision.delay:g} s"
            self._context.log.warning(text)
            self._context.status.set(message=text)
            await self._sleep(run, decision.delay)
        else:
            self._context.status.work(
                msg.TunerStatus.WAITING, f"{reason}; waiting until the machine is ready"
            )
            await self._sleep(run, decision.delay)

    def _check_patience(self, run: Run, reason: str, loss: Loss, lost: bool) -> None:
        """Check that there is patience left, and say when a wait begins.

        Raises:
            RunError: If there is none.
        """
        new = loss.begin()
        if loss.active:
            if new:
                self._context.log.warning(
                    f"evaluation {run.index}: {reason}; the run waits up to {loss.patience:g} s"
                )
            return
        reason = loss.told(reason)
        if lost:
            raise RunError(Tune.Result.MACHINE_LOST, reason)
        after = f", for {loss.patience:g} s now" if loss.patience > 0.0 else ""
        raise RunError(
            Tune.Result.MACHINE_ERROR,
            f"the machine refused evaluation {run.index}: {reason}{after}",
        )

    async def _sleep(self, run: Run, seconds: float, *wake: Future) -> None:
        timeout = max(seconds, SHORTEST_DELAY)
        await first_of(self._context.node, run.interrupt, run.steering.skip, *wake, timeout=timeout)

    async def _await_permit(self, run: Run, reason: str, loss: Loss) -> None:
        """Wait a little while the machine forbids to move; only the next attempt shows whether it does."""
        left = loss.remaining()
        self._context.status.work(
            msg.TunerStatus.WAITING,
            f"{loss.told(reason)}; waiting up to {loss.patience:g} s, {left:.0f} s are left",
        )
        delay = min(self._context.parameters.retry_delay, left)
        await self._sleep(run, delay, run.steering.stop)

    async def _await_return(self, run: Run, reason: str, loss: Loss) -> None:
        """Wait until the lost machine is there again, or the run is interrupted.

        Raises:
            RunError: If it did not return in time.
        """
        context, patience = self._context, loss.patience
        context.status.work(
            msg.TunerStatus.WAITING,
            f"{loss.told(reason)}; waiting for its return up to {patience:g} s, "
            f"{loss.remaining():.0f} s are left",
        )
        try:
            await self._sleep(run, context.parameters.retry_delay, run.steering.stop)
            machine = await context.gate.describe(
                loss.remaining(), run.interrupt, run.steering.skip, run.steering.stop
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

    async def _await_operator(self, run: Run, reason: str) -> None:
        """Pause before the next attempt, until an operator resumes or steps the run."""
        context, steering = self._context, run.steering
        steering.pause(reason)
        text = f"{PAUSED_DURING} evaluation {run.index}: {reason}"
        context.log.warning(text)
        while steering.waits and not (_stopped(run) or steering.stopping):
            context.status.work(msg.TunerStatus.PAUSED, text)
            await first_of(
                context.node, run.interrupt, steering.skip, steering.news, timeout=PAUSE_PERIOD
            )
        steering.take_step()
        context.status.work(msg.TunerStatus.EVALUATING, "")


def _stopped(run: Run) -> bool:
    return run.interrupted or run.steering.skip.done()
