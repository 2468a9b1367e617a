"""Where the machine goes at the end of a run and in trouble: nowhere, back, or to the best point."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from rclpy.task import Future

from mobo_msgs_py import msg
from mobo_msgs_py.action import EvaluateSetpoint, Tune
from mobo_tuner.core.focus import largest_box
from mobo_tuner.tuner.context import TunerContext
from mobo_tuner.tuner.gate import BoundsError, Gate, Target, settle_on_bounds
from mobo_tuner.tuner.machine_client import MachineLostError, clip_to_limits
from mobo_tuner.tuner.parameters import TunerParameters
from mobo_tuner.tuner.run.moves import approached, keep_move, keep_state
from mobo_tuner.tuner.run.run import Run, RunError

RESTORE, RESTORE_ANYWAY, BEST = "restore", "restore_anyway", "best"
EVENTS = ("on_end", "on_abort", "on_violation", "on_client_lost")
SEND_OFF_TIMEOUT = 1.2  # [s] for the machine to accept a move while this process is stopping


class Fallbacks:
    """The policies `on_end`, `on_abort`, `on_violation` and `on_client_lost`: hold, restore or best.

    The last two are sent to the machine with every evaluation, because it must act when nobody else
    can. The tuner itself sends the machine where `on_end` says after a run that ended well, and where
    `on_abort` says after a cancel, an error or a stop of its process.
    None leads across the problem's bounds but `restore_anyway`.
    """

    def __init__(self, context: TunerContext) -> None:
        self._context = context

    async def prepare(self, run: Run) -> None:
        """Learn where the machine is before anything moves.

        It is kept, so that an operator can go back there after the run. The run cannot begin without it only
        if a policy may send the machine back there.

        Raises:
            RunError: If such a policy is given, and the machine cannot tell, or may not be sent back there.
        """
        policies = {event: self._policy(event) for event in EVENTS}
        wanting = [event for event in EVENTS if policies[event] in (RESTORE, RESTORE_ANYWAY)]
        assert run.machine is not None
        where: Mapping[str, float] | None = {}
        unknown = ""
        # A machine that has just started may know only after a while.
        patience = self._context.parameters.discovery_timeout if wanting else 0.0
        try:
            where = await self._context.gate.where(run.interrupt, patience=patience)
        except MachineLostError as error:
            unknown = f"the state before the run is unknown: {error}"
        if where is None:
            return
        missing = [v.name for v in run.machine.variables if v.name not in where]
        if missing:
            unknown = unknown or f"the machine has no readback of {missing[0]}"
            if wanting:
                raise RunError(
                    Tune.Result.MACHINE_UNAVAILABLE,
                    f"{wanting[0]} is '{policies[wanting[0]]}', but {unknown}",
                )
            self._context.log.info(f"run '{run.run_id}': {unknown}")
            return
        within = clip_to_limits(where, run.machine.variables)
        run.state_before = settle_on_bounds(self._context.gate.bounds, within)
        keep_state(self._context, run, run.state_before)
        for event in wanting:
            trouble = blocked(policies[event], run, self._context.gate)
            if trouble:
                raise RunError(
                    Tune.Result.INVALID_GOAL, f"{event} is '{policies[event]}', but {trouble}"
                )

    def hints(self, run: Run) -> list[str]:
        """Return which policies would not do what they say, as the bounds were changed."""
        found = []
        for event in EVENTS:
            policy = self._policy(event)
            if trouble := blocked(policy, run, self._context.gate):
                found.append(f"{event} is '{policy}', but the machine would hold: {trouble}")
        return found

    def target(self, run: Run, event: str) -> Target | None:
        """Return where the machine goes at an event; None if it holds."""
        return fallback_target(self._policy(event), run, self._context.gate)

    async def act(self, run: Run, event: str, *interrupts: Future) -> str:
        """Do what `on_end` or `on_abort` says for a run that is over.

        The machine must not be lost. While this process is ending, the machine finishes the move by
        itself; a request to skip and the interrupts stop it where it is.

        Returns:
            What was done, in a few words; empty if nothing had to be done.
        """
        if run.machine is None:
            return ""
        policy = self._policy(event)
        target = self.target(run, event)
        if target is None:
            trouble = blocked(policy, run, self._context.gate)
            return f"the machine holds: {trouble}" if trouble else ""
        what = "the best point" if policy == BEST else "the state before the run"
        try:
            keep_move(self._context, run, target, "best" if policy == BEST else "restore", event)
            went = await self._go(target, run, what, interrupts)
        except BoundsError as error:
            went = _Went(f"the machine holds: {what} is out of bounds: {error}")
        except OSError as error:
            return f"the machine holds: {what} is out of bounds, and {error}"
        keep_state(self._context, run, went.readbacks, "" if went.arrived else went.text)
        return f"{went.text}, straight: {target.straight}" if target.straight else went.text

    async def _go(self, target: Target, run: Run, what: str, interrupts: Sequence[Future]) -> _Went:
        """Go to a target and return what came of it.

        Raises:
            BoundsError: If the machine may not go there.
        """
        context, units = self._context, run.problem.units
        context.log.info(f"run '{run.run_id}': the machine goes to {what}")
        context.status.work(msg.TunerStatus.MOVING, f"the machine goes to {what}")
        run.steering.begin_fallback()
        by_itself = f"the machine is going to {what} by itself"
        if context.stopping.done():
            accepted = await context.gate.send_off(target, units, SEND_OFF_TIMEOUT)
            return _Went(by_itself if accepted else f"the machine did not accept to go to {what}")

        def on_feedback(feedback: Any) -> None:
            context.status.progress(feedback.phase, feedback.fraction)

        try:
            answer = await context.gate.move(
                target,
                units,
                on_feedback,
                run.steering.skip,
                *interrupts,
                leave=context.stopping,
            )
        except MachineLostError as error:
            return _Went(f"the machine did not go to {what}: {error}")
        where = answer.readbacks
        if answer.error_code == EvaluateSetpoint.Result.CANCELED:
            if run.steering.skip.done() or any(interrupt.done() for interrupt in interrupts):
                return _Went(f"the machine was stopped on its way to {what}", where)
            if context.stopping.done():
                return _Went(by_itself, where)
        if answer.error_code != EvaluateSetpoint.Result.NONE:
            return _Went(f"the machine did not go to {what}: {answer.error_msg}", where)
        return _Went(f"the machine went to {what}", where, arrived=True)

    def _policy(self, event: str) -> str:
        return fallback_policy(self._context.parameters, event)


class _Went(NamedTuple):
    """What came of a move, in a few words, the readbacks at its end, and whether it arrived."""

    text: str
    readbacks: Mapping[str, float] = {}
    arrived: bool = False


def fallback_policy(parameters: TunerParameters, event: str) -> str:
    """Return the policy at one of `EVENTS`."""
    policy: str = getattr(parameters, event)
    return policy


def fallback_target(policy: str, run: Run, gate: Gate) -> Target | None:
    """Return where a policy sends the machine; None if it holds.

    The best point is the one inside the bounds that dominates the largest volume by itself. The machine
    holds if there is none, or if the state before the run is outside the bounds. It comes to the best
    point from the side from which its evaluation was, where a variable has an `approach`.
    """
    if policy in (RESTORE, RESTORE_ANYWAY) and run.state_before is not None:
        target = Target(run.state_before, anyway=policy == RESTORE_ANYWAY)
        return target if gate.allows(target) else None
    if policy == BEST:
        allowed = [point for point in run.found.front if gate.allows(Target(point["setpoint"]))]
        best = largest_box(run.problem, allowed)
        return (
            approached(Target(dict(best["setpoint"])), run, best["index"], gate) if best else None
        )
    return None


def blocked(policy: str, run: Run, gate: Gate) -> str:
    """Return why a policy would not act, as the bounds were changed; empty if it would or need not."""
    if policy == BEST:
        points = [Target(point["setpoint"]) for point in run.found.front]
        if not points or any(gate.allows(point) for point in points):
            return ""
        return "no point of the front is within the bounds"
    if policy not in (RESTORE, RESTORE_ANYWAY) or run.state_before is None:
        return ""
    try:
        gate.check(Target(run.state_before, anyway=policy == RESTORE_ANYWAY))
    except BoundsError as error:
        return (
            f"the state before the run is out of bounds: {error}; '{RESTORE_ANYWAY}' goes back there "
            "all the same"
        )
    return ""
