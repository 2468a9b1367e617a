"""What one run does, from its first step to its end: propose, evaluate, learn, report."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Literal, NamedTuple

from rclpy.duration import Duration
from rclpy.task import Future

from mobo_msgs_py import msg
from mobo_msgs_py.action import EvaluateSetpoint, Tune
from mobo_tuner.core import ProblemError
from mobo_tuner.ros.conversions import named_values
from mobo_tuner.ros.waiting import STEADY_CLOCK, first_of, until
from mobo_tuner.runs.records import EndRecord, EvaluationRecord, StopReason
from mobo_tuner.tuner.context import TunerContext, describe
from mobo_tuner.tuner.gate import BoundsError, Gate, Target, check_bounds
from mobo_tuner.tuner.machine_client import MachineLostError
from mobo_tuner.tuner.messages import evaluation_message
from mobo_tuner.tuner.parameters import TunerParameters
from mobo_tuner.tuner.recording import Recording
from mobo_tuner.tuner.run.attempts import PAUSE_PERIOD, Attempts
from mobo_tuner.tuner.run.fallbacks import Fallbacks
from mobo_tuner.tuner.run.run import Run, RunError, Suggestion
from mobo_tuner.tuner.session import Session
from mobo_tuner.wording import counted

CHUNK = 20  # evaluations of an earlier run that are published before the next wait
TIME_PERIOD = 1.0  # [s] between two looks at the time of a run
ACKNOWLEDGE_TIMEOUT = 2.0  # [s] for the subscribers to receive a chunk
_OUTSIDE = 0.02  # distance of a readback from its bounds, where a variable spans 2, that is noise
_AT_ONCE = Duration(nanoseconds=1)
_CODES = Tune.Result
_BY_ITSELF = (
    StopReason.BUDGET,
    StopReason.HYPERVOLUME_GOAL,
    StopReason.STAGNATION,
    StopReason.LITTLE_EXPECTED,
)

Listener = Callable[[EvaluationRecord, msg.Evaluation], None]


class Ending(NamedTuple):
    """How a run ended; the fields are those of `Tune.Result`."""

    stop_reason: str
    error_code: int = _CODES.NONE
    error_msg: str = ""


class RunLoop:
    """Carries out runs, one at a time.

    Args:
        context: The tuner's node and what works in it.
        session: Session that a run occupies until its end.
        recording: Whether runs are recorded.
    """

    def __init__(self, context: TunerContext, session: Session, recording: Recording) -> None:
        self._context = context
        self._session = session
        self._recording = recording
        self._fallbacks = Fallbacks(context)
        self._attempts = Attempts(context, self._fallbacks)
        self._hinted: tuple[str, ...] = ()  # what was logged last

    async def carry_out(self, run: Run, listener: Listener) -> Ending:
        """Carry out a run; whatever happens, its journal is closed at the end.

        Args:
            run: Run that has been prepared.
            listener: Called with every evaluation, after the topics have it.
        """
        context = self._context
        try:
            with self._session.running(run), self._watching_time(run):
                await self._recording.await_subscribers(run.interrupt)
                with context.topics.heartbeat.of(run.run_id):
                    ending, done = await self._leave(run, await self._tune(run, listener))
                    if ending.error_code == _CODES.NONE and run.changeable and run.barren:
                        text = f"{run.barren}; {done}" if done else run.barren
                        ending = Ending(StopReason.ERROR, _CODES.MACHINE_ERROR, text)
                    ending = end_run(context, run, ending)
                    context.topics.front(run.front_message(context.now()))
                    context.status.hint("run", run.hints)  # not what its fallbacks would do
                    context.status.set(
                        publish=False,
                        message=ending.error_msg or done,
                        stop_reason=ending.stop_reason,
                    )
        finally:
            context.status.work(msg.TunerStatus.IDLE)
        context.log.info(
            f"run '{run.run_id}': {counted(run.index, 'evaluation')}, hypervolume "
            f"{run.found.hypervolume:.6g}, stopped by {ending.stop_reason}"
        )
        return ending

    async def _tune(self, run: Run, listener: Listener) -> Ending:
        """Make evaluations until the run is done, interrupted or must end; return how it ended."""
        try:
            try:
                await self._begin(run)
                await self._repeat(run, listener)
            finally:
                run.steering.end()
            await self._withdraw(run)
        except Exception as error:
            code = error.code if isinstance(error, RunError) else _CODES.INTERNAL
            text = str(error) if isinstance(error, RunError) else describe(error)
            self._context.log.error(f"run '{run.run_id}' ends: {text}")
            return Ending(StopReason.ERROR, code, text)
        if run.interrupted:
            return _canceled(run)
        if run.steering.stopping:
            return Ending(run.steering.stop.result())
        spent = run.index >= run.budget
        return Ending(StopReason.BUDGET if spent else StopReason.HYPERVOLUME_GOAL)

    async def _leave(self, run: Run, ending: Ending) -> tuple[Ending, str]:
        """Send the machine where the policies say at the end of a run.

        A run that holds a working point ends where its caller says.

        Returns:
            How the run ended in the end, as it may be canceled on the way, and what was done, in a few
            words.
        """
        done = ""
        if ending.error_code == _CODES.NONE and run.changeable:
            done = await self._fallbacks.act(run, "on_end", run.interrupt)
            if run.interrupted:
                ending = _canceled(run)
        # Where the goal was refused, nothing has moved.
        if ending.error_code not in (_CODES.NONE, _CODES.MACHINE_LOST, _CODES.INVALID_GOAL):
            done = await self._fallbacks.act(run, "on_abort")
            if done:
                ending = ending._replace(error_msg=f"{ending.error_msg}; {done}")
        if done:
            self._context.log.info(f"run '{run.run_id}': {done}")
        undone = run.steering.undone(stopped=ending.stop_reason not in _BY_ITSELF)
        if undone:
            text = f"the run ended before {undone}"
            self._context.log.warning(f"run '{run.run_id}': {text}")
            done = f"{done}; {text}" if done else text
        return ending, done

    @contextmanager
    def _watching_time(self, run: Run) -> Iterator[None]:
        """End a run when its time is over, whatever it waits for; an evaluation in flight is finished."""
        node = self._context.node
        run.progress.begin(run.found.hypervolume)

        def look() -> None:
            if run.changeable and run.progress.is_late(self._context.parameters):
                self._stop(run, StopReason.TIME)

        timer = node.create_timer(TIME_PERIOD, look, clock=STEADY_CLOCK)
        try:
            yield
        finally:
            node.destroy_timer(timer)

    def _stop(self, run: Run, reason: StopReason) -> None:
        """Let a run end before its next evaluation."""
        run.steering.request_stop(reason)
        run.steering.notify()

    def _suggest(self, run: Run) -> Future:
        expecting = run.changeable and self._context.parameters.stop_below_expected_gain > 0.0
        return self._context.worker.submit(run.suggest, expecting)

    async def _repeat(self, run: Run, listener: Listener) -> None:
        worker = self._context.worker
        run.step_started = time.perf_counter()
        suggestion = self._suggest(run)
        while not run.finished:
            suggested = await self._next(run, suggestion)
            if suggested is None:
                return
            outcome = await self._attempts.evaluate(run, suggested.setpoint)
            if outcome is None:
                return
            problem = run.problem
            record = await worker.submit(run.learn, suggested, outcome)
            await self._recording.await_journal(run)
            if run.problem is not problem:  # its reference point was inferred
                self._publish_all(run)
            run.steering.forget_skip(record.failed and run.steering.skip.done())
            if not run.finished:  # computed while the evaluation is reported
                suggestion = self._suggest(run)
            # Saved after the suggestion, while the machine works: nobody waits for it.
            worker.submit(run.save)
            self._report(run, record, listener)
            self._judge(run, record)
            if run.finished:
                while run.finished and run.steering.changes:  # asked for during the last evaluation
                    await self._apply_change(run)
                if not run.finished:
                    suggestion = self._suggest(run)

    # ------------------------------------------------------------------ the start

    async def _begin(self, run: Run) -> None:
        """Publish what there is of a run, and meet the machine.

        Raises:
            RunError: If no suitable machine answers.
        """
        context = self._context
        patience = context.parameters.discovery_timeout
        context.status.set(publish=False, stop_reason="", run_id=run.run_id, last_failure="")
        publish_figures(context, run, at_once=False)  # in place of those of the run before
        self._recording.begin()
        context.status.work(
            msg.TunerStatus.WAITING, f"waiting up to {patience:g} s for a machine to answer"
        )
        self._publish_all(run)
        await self._publish_earlier(run)
        try:
            machine = await context.gate.describe(patience, run.interrupt)
            if machine is None:
                return
            run.meet(machine)
        except (MachineLostError, ProblemError) as error:
            raise RunError(_CODES.MACHINE_UNAVAILABLE, str(error)) from None
        if run.optimizer.needs_start and not run.index:
            await self._start_from_present(run)
        await self._fallbacks.prepare(run)
        context.status.work(msg.TunerStatus.SUGGESTING, "")
        context.log.info(f"run '{run.run_id}' tunes '{machine.name}'")

    async def _start_from_present(self, run: Run) -> None:
        """Let a run whose suggestions must be safe begin where the machine is.

        Raises:
            RunError: If the machine does not say where it is, or is outside the bounds.
        """
        try:
            patience = self._context.parameters.discovery_timeout
            present = await self._context.gate.where(run.interrupt, patience=patience)
        except MachineLostError as error:
            raise RunError(_CODES.MACHINE_UNAVAILABLE, str(error)) from None
        if present is None:
            return
        for variable in run.problem.variables:
            value = present.get(variable.name, math.nan)
            if not abs(variable.normalize(value)) <= 1.0 + _OUTSIDE:
                raise RunError(
                    _CODES.MACHINE_UNAVAILABLE,
                    f"the run must begin where the machine is, whose {variable.name} is {value:g}; "
                    f"{variable.minimum:g} to {variable.maximum:g} is allowed",
                )
        run.present = {
            v.name: v.denormalize(v.normalize(present[v.name])) for v in run.problem.variables
        }

    async def _publish_earlier(self, run: Run) -> None:
        """Publish the evaluations with which a run begins, no faster than they are received."""
        topics = self._context.topics
        for start in range(0, len(run.records), CHUNK):
            for problem, record in run.records[start : start + CHUNK]:
                topics.evaluation(evaluation_message(problem, record, run.run_id))
            await until(
                self._context.node,
                lambda: topics.acknowledged(_AT_ONCE),
                timeout=ACKNOWLEDGE_TIMEOUT,
            )

    def _publish_all(self, run: Run) -> None:
        """Publish problem, records, front and figures when a run begins or its problem changes."""
        publish_run(self._context, run)
        self._publish_figures(run)

    def _publish_figures(self, run: Run) -> None:
        publish_figures(self._context, run)
        self._context.status.hint("run", [*self._fallbacks.hints(run), *run.hints])
        for hint in run.hints:
            if hint not in self._hinted:
                self._context.log.warning(f"run '{run.run_id}': {hint}")
        self._hinted = run.hints

    # ------------------------------------------------------------------ between two evaluations

    async def _next(self, run: Run, suggestion: Future) -> Suggestion | None:
        """Return what to evaluate next, once the run may; None if it must not continue.

        One suggestion is made for every evaluation, whether it is used or not, so that a run depends
        on what was asked of it and not on when.
        """
        steering = run.steering
        while True:
            await self._recording.await_journal(run)
            if run.log.trouble:
                raise RunError(_CODES.INTERNAL, run.log.trouble)
            if run.interrupted or steering.stopping:
                return None
            if steering.changes:
                if await self._suggested(run, suggestion) is None:
                    return None
                await self._apply_change(run)
                if run.finished:
                    return None
                suggestion = self._suggest(run)
            suggested = await self._suggested(run, suggestion)
            if run.interrupted or suggested is None:
                return None
            if steering.changes or steering.stopping:
                continue
            if not steering.waits:
                break
            self._context.status.work(
                msg.TunerStatus.PAUSED, f"paused before evaluation {run.index}: {steering.reason}"
            )
            await first_of(self._context.node, run.interrupt, steering.news, timeout=PAUSE_PERIOD)
        self._context.status.work(msg.TunerStatus.SUGGESTING, "")
        parameters = self._context.parameters
        if run.progress.promises_little(suggested.expected_gain, parameters) and not steering.queue:
            self._stop(run, StopReason.LITTLE_EXPECTED)
            return None
        steering.take_step()
        queued, dropped = take_queued(run, self._context.gate)
        for reason in dropped:
            self._context.log.warning(f"a queued set-point is dropped: {reason}")
        return Suggestion(queued, "operator", suggested.seconds) if queued else suggested

    async def _suggested(self, run: Run, suggestion: Future) -> Suggestion | None:
        """Return the suggestion once it is computed; None if the run was interrupted.

        Raises:
            RunError: If it takes too long.
        """
        context = self._context
        if not suggestion.done():
            context.status.work(msg.TunerStatus.SUGGESTING)
        patience = context.parameters.suggestion_timeout
        done = await first_of(context.node, suggestion, run.interrupt, timeout=patience)
        if run.interrupted:
            return None
        if done is None:
            raise RunError(_CODES.INTERNAL, f"no suggestion came within {patience:g} s")
        suggested: Suggestion = suggestion.result()
        return suggested

    async def _apply_change(self, run: Run) -> None:
        await self._withdraw(run)
        change, run.steering.change = run.steering.change, None
        if change is None:
            return
        await self._context.worker.submit(run.apply, change, self._context.stamp())
        self._context.log.info(f"run '{run.run_id}' is changed before evaluation {run.index}")
        self._publish_all(run)

    async def _withdraw(self, run: Run) -> None:
        """Forget what operators withdraw."""
        waiting = run.steering.withdrawals
        while waiting:
            await self._context.worker.submit(run.withdraw, waiting[0])
            waiting.popleft()  # not before it is done: a request meanwhile is checked against it
            self._publish_all(run)

    # ------------------------------------------------------------------ an evaluation

    def _report(self, run: Run, record: EvaluationRecord, listener: Listener) -> None:
        message = run.evaluation_message(record)
        self._context.topics.evaluation(message)
        publish_front_change(self._context, run)
        # A wait during the evaluation is over, even if the machine answered without feedback.
        self._context.status.set(publish=False, state=msg.TunerStatus.SUGGESTING, message="")
        self._publish_figures(run)
        listener(record, message)

    def _judge(self, run: Run, record: EvaluationRecord) -> None:
        """Pause or end the run after a failed evaluation, if the parameters say so.

        Raises:
            RunError: If it must end.
        """
        if record.failed:
            text = f"evaluation {record.index} failed: {record.error_msg}"
            self._context.log.warning(text)
        verdict = judge(record, run.consecutive_failures, self._context.parameters)
        if verdict.action == "pause":
            run.steering.pause(verdict.reason)
        elif verdict.action == "end":
            raise RunError(_CODES.MACHINE_ERROR, verdict.reason)
        reason = run.progress.reason(self._context.parameters)
        if reason is not None and run.changeable and not run.finished:
            self._stop(run, reason)


def _canceled(run: Run) -> Ending:
    why = f"the run was stopped: {run.interrupt.result()}"
    return Ending(StopReason.CANCELED, _CODES.CANCELED, why)


def take_queued(run: Run, gate: Gate) -> tuple[dict[str, float] | None, list[str]]:
    """Take the next queued set-point that the bounds, which may have changed, allow.

    Returns:
        The set-point, or None, and the reasons why those before it were dropped.
    """
    dropped: list[str] = []
    while run.steering.queue:
        setpoint = run.steering.queue.popleft()
        try:
            check_bounds(run.problem, setpoint)
            gate.check(Target(setpoint))
        except BoundsError as error:
            dropped.append(str(error))
        else:
            return setpoint, dropped
    return None, dropped


class Verdict(NamedTuple):
    """Whether a run continues after an evaluation, pauses or ends, and for what reason."""

    action: Literal["continue", "pause", "end"]
    reason: str = ""


def judge(
    record: EvaluationRecord, consecutive_failures: int, parameters: TunerParameters
) -> Verdict:
    """Judge whether a run continues after an evaluation."""
    if not record.failed or record.error_code == EvaluateSetpoint.Result.CANCELED:
        return Verdict("continue")
    reason = f"evaluation {record.index} failed: {record.error_msg}"
    if parameters.on_failure == "abort":
        return Verdict("end", reason)
    limit = parameters.max_consecutive_failures
    if consecutive_failures >= limit:
        return Verdict("end", f"{counted(limit, 'evaluation')} failed in a row: {record.error_msg}")
    violated = record.error_code == EvaluateSetpoint.Result.VIOLATION
    if parameters.on_failure == "pause" or (violated and parameters.pause_on_violation):
        return Verdict("pause", reason)
    return Verdict("continue")


def publish_run(context: TunerContext, run: Run) -> None:
    """Publish the problem of a run, how it was set up, and its front."""
    now = context.now()
    context.topics.run_records(run.records_message(now))
    context.topics.problem(run.problem_message(now))
    context.topics.front(run.front_message(now))


def publish_figures(context: TunerContext, run: Run, *, at_once: bool = True) -> None:
    """Publish the counts and the hypervolume of a run; that of a client with its own loop has no budget."""
    found = run.found
    context.status.set(
        publish=at_once,
        budget=0 if run.by_client else run.budget,
        evaluations=found.evaluations,
        failed=found.failed,
        feasible=found.feasible,
        front_size=len(found.front),
        hypervolume=found.hypervolume,
        hypervolume_measured=found.hypervolume_measured,
        contexts=named_values({c.name: c.value for c in found.contexts}, found.problem.units),
        stale_contexts=[c.name for c in found.contexts if c.stale],
    )


def publish_front_change(context: TunerContext, run: Run) -> None:
    """Publish the front of a run if it has changed enough since it was published last."""
    indices = (point["index"] for point in run.found.front)
    context.topics.front_changed(indices, lambda: run.front_message(context.now()))


def end_run(context: TunerContext, run: Run, ending: Ending) -> Ending:
    """Write the end of a run into its journal, close it, and return how the run ended.

    A run with evaluations that its journal lacks ended with an error.
    """
    run.log.keep(EndRecord(context.stamp(), *ending))
    lacking = [r.index for r in run.log.waiting if isinstance(r, EvaluationRecord)]
    if run.log.trouble:
        context.log.error(f"the end of run '{run.run_id}' is not kept: {run.log.trouble}")
    if lacking:
        text = f"{run.log.trouble}; it lacks evaluation {', '.join(map(str, lacking))}"
        ending = Ending(StopReason.ERROR, ending.error_code or _CODES.INTERNAL, text)
    run.log.close()
    return ending
