"""Where the machine goes when a run does not end well: nowhere, back, or to the best point."""

from __future__ import annotations

from typing import Any

from mobo_msgs_py import msg
from mobo_msgs_py.action import EvaluateSetpoint, Tune
from mobo_tuner.core.focus import largest_box
from mobo_tuner.ros.conversions import named_values
from mobo_tuner.tuner.context import TunerContext
from mobo_tuner.tuner.machine_client import MachineLostError, clip_to_limits
from mobo_tuner.tuner.run.run import Run, RunError

RESTORE, BEST = "restore", "best"
EVENTS = ("on_abort", "on_violation", "on_client_lost")
SEND_OFF_TIMEOUT = 1.2  # [s] for the machine to accept a move while this process is stopping


class Fallbacks:
    """The policies `on_abort`, `on_violation` and `on_client_lost`: hold, restore or best.

    The last two are sent to the machine with every evaluation, because it must act when nobody else
    can. `on_abort` is the tuner's own: after a cancel, a stop or an error it sends the machine there.
    """

    def __init__(self, context: TunerContext) -> None:
        self._context = context

    async def prepare(self, run: Run) -> None:
        """Learn where the machine is before anything moves, if a policy may send it back there.

        Raises:
            RunError: If the machine cannot tell.
        """
        wanting = [event for event in EVENTS if self._policy(event) == RESTORE]
        if not wanting:
            return
        assert run.machine is not None
        try:
            where = await self._context.machine.where(run.interrupt)
        except MachineLostError as error:
            raise RunError(
                Tune.Result.MACHINE_UNAVAILABLE,
                f"{wanting[0]} is '{RESTORE}', but the state before the run is unknown: {error}",
            ) from None
        if where is None:
            return
        missing = [v.name for v in run.machine.variables if v.name not in where]
        if missing:
            raise RunError(
                Tune.Result.MACHINE_UNAVAILABLE,
                f"{wanting[0]} is '{RESTORE}', but the machine has no readback of {missing[0]}",
            )
        run.state_before = clip_to_limits(where, run.machine.variables)

    def target(self, run: Run, event: str) -> dict[str, float]:
        """Return where the machine goes at an event; empty if it holds.

        The best point of the front is the one that dominates the largest volume by itself; without
        a front the machine holds.
        """
        policy = self._policy(event)
        if policy == RESTORE:
            return dict(run.state_before or {})
        if policy == BEST:
            best = largest_box(run.problem, list(run.found.front))
            return dict(best["setpoint"]) if best else {}
        return {}

    async def act(self, run: Run) -> str:
        """Do what `on_abort` says for a run that did not end well.

        The machine must not be lost. While this process is ending, the machine finishes the move by
        itself; a request to skip stops it where it is.

        Returns:
            What was done, in a few words; empty if nothing had to be done.
        """
        target = self.target(run, "on_abort")
        if run.machine is None or not target:
            return ""
        context = self._context
        restoring = self._policy("on_abort") == RESTORE
        what = "the state before the run" if restoring else "the best point"
        setpoint = named_values(target, run.problem.units)
        context.log.info(f"run '{run.run_id}': the machine goes to {what}")
        context.status.work(msg.TunerStatus.MOVING, f"the machine goes to {what}")
        run.steering.begin_fallback()
        by_itself = f"the machine is going to {what} by itself"
        if context.stopping.done():
            accepted = await context.machine.send_off(setpoint, SEND_OFF_TIMEOUT)
            return by_itself if accepted else f"the machine did not accept to go to {what}"

        def on_feedback(feedback: Any) -> None:
            context.status.progress(feedback.phase, feedback.fraction)

        try:
            answer = await context.machine.apply(
                setpoint, on_feedback, run.steering.skip, leave=context.stopping
            )
        except MachineLostError as error:
            return f"the machine did not go to {what}: {error}"
        if answer.error_code == EvaluateSetpoint.Result.CANCELED:
            if run.steering.skip.done():
                return f"the machine was stopped on its way to {what}"
            if context.stopping.done():
                return by_itself
        if answer.error_code != EvaluateSetpoint.Result.NONE:
            return f"the machine did not go to {what}: {answer.error_msg}"
        return f"the machine went to {what}"

    def _policy(self, event: str) -> str:
        policy: str = getattr(self._context.parameters, event)
        return policy
