"""Where the machine goes when a run does not end as it should: nowhere, back, or to the best point."""

from __future__ import annotations

from typing import Any

from mobo_msgs_py import msg
from mobo_msgs_py.action import EvaluateSetpoint, Tune
from mobo_tuner.core.focus import largest_box
from mobo_tuner.ros.conversions import named_values
from mobo_tuner.tuner.context import TunerParts
from mobo_tuner.tuner.machine_client import MachineLostError, clip_to_limits
from mobo_tuner.tuner.messages import problem_units
from mobo_tuner.tuner.run.run import Run, RunError

HOLD, RESTORE, BEST = POLICIES = ("hold", "restore", "best")
EVENTS = ("on_abort", "on_violation", "on_client_lost")
SEND_OFF_TIMEOUT = 1.2  # [s] for the machine to accept a move while this process is stopping


class Ends:
    """The policies of `on_abort`, `on_violation` and `on_client_lost`.

    The last two are told to the machine with every evaluation, since it must act when nobody else
    can. `on_abort` is the tuner's own: after a cancel, a stop or an error it sends the machine there.
    """

    def __init__(self, parts: TunerParts) -> None:
        self._parts = parts

    async def prepare(self, run: Run) -> None:
        """Before anything moves, learn where the machine is, if a policy wants it back there.

        Raises:
            RunError: the machine cannot tell.
        """
        wanting = [event for event in EVENTS if self._parts.parameters[event] == RESTORE]
        if not wanting:
            return
        assert run.machine is not None
        try:
            where = await self._parts.machine.where(run.interrupt)
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
        """Where the machine goes at an event; empty where it holds.

        The best point of the front is the one that dominates the largest volume by itself; where
        there is no front yet, the machine holds.
        """
        policy = self._parts.parameters[event]
        if policy == RESTORE:
            return dict(run.state_before or {})
        if policy == BEST:
            best = largest_box(run.problem, run.optimizer.pareto_front())
            return dict(best["setpoint"]) if best else {}
        return {}

    async def act(self, run: Run) -> str:
        """Do what `on_abort` says for a run that has ended otherwise than it should.

        The machine must not be lost. Where this process is ending it finishes the move by itself.

        Returns:
            What was done, in a few words; empty where nothing was to be done.
        """
        target = self.target(run, "on_abort")
        if run.machine is None or not target:
            return ""
        parts = self._parts
        policy = parts.parameters["on_abort"]
        what = "the state before the run" if policy == RESTORE else "the best point"
        setpoint = named_values(target, problem_units(run.problem))
        parts.log.info(f"run '{run.run_id}': the machine goes to {what}")
        parts.status.set(state=msg.TunerStatus.MOVING, phase="", fraction=0.0)
        if parts.stopping.done():
            accepted = await parts.machine.send_off(setpoint, SEND_OFF_TIMEOUT)
            return (
                f"the machine is going to {what} by itself"
                if accepted
                else f"the machine did not accept to go to {what}"
            )

        def on_feedback(feedback: Any) -> None:
            parts.status.set(publish=False, phase=feedback.phase, fraction=feedback.fraction)

        try:
            answer = await parts.machine.apply(setpoint, on_feedback, parts.stopping, cancel=False)
        except MachineLostError as error:
            return f"the machine did not go to {what}: {error}"
        if answer.error_code == EvaluateSetpoint.Result.CANCELED and parts.stopping.done():
            return f"the machine is going to {what} by itself"
        if answer.error_code != EvaluateSetpoint.Result.NONE:
            return f"the machine did not go to {what}: {answer.error_msg}"
        return f"the machine went to {what}"
