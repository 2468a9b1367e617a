"""The one way from the tuner to the machine: no motion leaves the bounds of now unasked."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol

from rclpy.task import Future

from mobo_msgs_py import msg
from mobo_msgs_py.action import ApplySetpoint, EvaluateSetpoint
from mobo_msgs_py.srv import DescribeMachine
from mobo_tuner.core.problem import Problem
from mobo_tuner.errors import UserError
from mobo_tuner.ros.conversions import named_values
from mobo_tuner.tuner.machine_client import Answer, FeedbackCallback
from mobo_tuner.tuner.messages import limit_messages

READBACK_MARGIN = 0.01
"""Distance from a bound, as a share of the range, at which a readback is taken for the bound itself."""


class BoundsError(UserError):
    """A set-point to which the tuner may not send the machine."""


class Target(NamedTuple):
    """Where the machine is to go.

    Attributes:
        setpoint: Every variable, in its unit.
        anyway: Whether an operator has said that it may be outside the problem's bounds.
        via: Set-point to pass on the way; None = straight there.
        straight: Reason why the machine goes straight there, although some variables have an `approach`; empty if
            it does not, or if there is nothing to approach.
    """

    setpoint: Mapping[str, float]
    anyway: bool = False
    via: Mapping[str, float] | None = None
    straight: str = ""


@dataclass(frozen=True)
class EvaluationRequest:
    """One attempt at an evaluation; the fields are those of `EvaluateSetpoint.Goal`.

    Attributes:
        anyway: Whether an operator has said that the set-point may be outside the problem's bounds.
    """

    run_id: str
    index: int
    attempt: int
    setpoint: Mapping[str, float]
    shots: int = 0
    critical: Sequence[msg.Constraint] = ()
    client_timeout: float = 0.0
    if_client_lost: Target | None = None
    if_violated: Target | None = None
    anyway: bool = False


class Machine(Protocol):
    """What the gate needs of the machine's client; `MachineClient` says what each does."""

    @property
    def action_name(self) -> str:
        """Full name of the action `evaluate_setpoint`."""

    @property
    def is_there(self) -> bool:
        """Whether a machine serves that action."""

    async def describe(
        self, timeout: float, *interrupts: Future
    ) -> DescribeMachine.Response | None:
        """Wait for the machine and ask what it can do."""

    async def where(self, *interrupts: Future, patience: float = 0.0) -> dict[str, float] | None:
        """Return where the machine is."""

    async def evaluate(
        self, goal: EvaluateSetpoint.Goal, on_feedback: FeedbackCallback, *interrupts: Future
    ) -> Answer:
        """Have one set-point evaluated."""

    async def apply(
        self,
        goal: ApplySetpoint.Goal,
        on_feedback: FeedbackCallback,
        *interrupts: Future,
        leave: Future | None = None,
    ) -> Answer:
        """Have the machine go to a set-point."""

    async def send_off(self, goal: ApplySetpoint.Goal, timeout: float) -> bool:
        """Have the machine go to a set-point by itself."""


class Observer(Protocol):
    """What is told of every motion."""

    def begin(self, setpoint: Sequence[msg.NamedValue]) -> None:
        """Take note of the set-point of a motion that begins."""

    def progress(self, readbacks: Sequence[msg.NamedValue], *, last: bool = False) -> None:
        """Take note of readbacks, the last ones at its end."""


class Gate:
    """Checks every set-point that the tuner sends, and is the only one that talks to the machine.

    A set-point must be inside the bounds and limits of the tuner's problem as it is at that moment, and
    inside the machine's limits. Only a target with an operator's word, `anyway`, may cross those of the
    problem; nothing may cross those of the machine.

    Args:
        machine: Client of the machine.
        bounds: Function that returns the tuner's problem as it is now.
        motion: Observer of all motions; None if there is none.
    """

    def __init__(
        self, machine: Machine, bounds: Callable[[], Problem], motion: Observer | None = None
    ) -> None:
        self._machine = machine
        self._bounds = bounds
        self._motion = motion
        self._limits: Sequence[msg.Variable] = ()  # of the machine that answered last

    @property
    def bounds(self) -> Problem:
        """Problem whose bounds hold now."""
        return self._bounds()

    @property
    def action_name(self) -> str:
        """Full name of the machine's action `evaluate_setpoint`."""
        return self._machine.action_name

    @property
    def is_open(self) -> bool:
        """Whether there is a machine behind it."""
        return self._machine.is_there

    def check(self, target: Target) -> None:
        """Check where the machine is to go.

        Raises:
            BoundsError: If the machine may not go there.
        """
        for setpoint in (target.setpoint, target.via or {}):
            if not target.anyway:
                check_bounds(self.bounds, setpoint)
            for limit in self._limits:
                _check_range(limit.name, setpoint, limit.min, limit.max, limit.unit)

    def settled(self, readbacks: Mapping[str, float]) -> dict[str, float]:
        """Return readbacks as a set-point: those a hair outside a bound or a limit are taken for it."""
        setpoint = settle_on_bounds(self.bounds, readbacks)
        for limit in self._limits:
            if limit.name in setpoint:
                setpoint[limit.name] = _settled(setpoint[limit.name], limit.min, limit.max)
        return setpoint

    def allows(self, target: Target) -> bool:
        """Return whether the machine may go to a target."""
        try:
            self.check(target)
        except BoundsError:
            return False
        return True

    async def describe(
        self, timeout: float, *interrupts: Future
    ) -> DescribeMachine.Response | None:
        """Wait for the machine and ask what it can do; see `MachineClient.describe`."""
        machine = await self._machine.describe(timeout, *interrupts)
        if machine is not None:
            self._limits = tuple(machine.variables)
        return machine

    async def where(self, *interrupts: Future, patience: float = 0.0) -> dict[str, float] | None:
        """Return where the machine is; nothing moves. See `MachineClient.where`."""
        return await self._machine.where(*interrupts, patience=patience)

    async def evaluate(
        self,
        request: EvaluationRequest,
        units: Mapping[str, str],
        on_feedback: FeedbackCallback,
        *interrupts: Future,
    ) -> Answer:
        """Have one set-point evaluated; see `MachineClient.evaluate`.

        Raises:
            BoundsError: If the set-point or one of the fallbacks is not allowed; nothing was sent.
            MachineLostError: If the machine refused the goal, fell silent or took too long.
        """
        wanted = Target(request.setpoint, request.anyway)
        targets = [wanted, request.if_client_lost, request.if_violated]
        for target in targets:
            if target is not None:
                self.check(target)
        at, if_client_lost, if_violated = (
            named_values(target.setpoint, units) if target is not None else [] for target in targets
        )
        client_lost_via, violated_via = (
            named_values(target.via or {}, units) if target is not None else []
            for target in targets[1:]
        )
        goal = EvaluateSetpoint.Goal(
            run_id=request.run_id,
            index=request.index,
            attempt=request.attempt,
            setpoint=at,
            shots=request.shots,
            limits=self._limits_for(wanted),
            critical=list(request.critical),
            client_timeout=request.client_timeout,
            if_client_lost=if_client_lost,
            if_client_lost_via=client_lost_via,
            if_violated=if_violated,
            if_violated_via=violated_via,
        )
        watched = self._watched(at, on_feedback)
        answer = await self._machine.evaluate(goal, watched, *interrupts)
        return self._ended(answer, units)

    async def move(
        self,
        target: Target,
        units: Mapping[str, str],
        on_feedback: FeedbackCallback,
        *interrupts: Future,
        leave: Future | None = None,
    ) -> Answer:
        """Have the machine go to a target, ramped and verified; see `MachineClient.apply`.

        Raises:
            BoundsError: If the target is not allowed; nothing was sent.
            MachineLostError: If the machine refused the goal, fell silent or took too long.
        """
        goal = self._goal(target, units)
        watched = self._watched(goal.setpoint, on_feedback)
        answer = await self._machine.apply(goal, watched, *interrupts, leave=leave)
        return self._ended(answer, units)

    async def send_off(self, target: Target, units: Mapping[str, str], timeout: float) -> bool:
        """Have the machine go to a target by itself; see `MachineClient.send_off`.

        Raises:
            BoundsError: If the target is not allowed; nothing was sent.
        """
        goal = self._goal(target, units)
        if self._motion is not None:
            self._motion.begin(goal.setpoint)
        return await self._machine.send_off(goal, timeout)

    def _goal(self, target: Target, units: Mapping[str, str]) -> ApplySetpoint.Goal:
        """Return the goal of a move.

        Raises:
            BoundsError: If the target is not allowed.
        """
        self.check(target)
        return ApplySetpoint.Goal(
            setpoint=named_values(target.setpoint, units),
            via=named_values(target.via or {}, units),
            limits=self._limits_for(target),
        )

    def _limits_for(self, target: Target) -> list[msg.Limit]:
        """Return the limits on sums of variables that the machine keeps on its way to a target.

        An operator's word leads across them, too: those that a target does not meet are left out.
        """
        points = [target.setpoint, *([target.via] if target.via else [])]
        return limit_messages(
            limit
            for limit in self.bounds.limits
            if all(name in target.setpoint for name, _ in limit.coefficients)
            and all(map(limit.is_met, points))
        )

    def _watched(
        self, setpoint: Sequence[msg.NamedValue], on_feedback: FeedbackCallback
    ) -> FeedbackCallback:
        """Tell the observer of a motion that begins; return what also tells it of the feedback."""
        motion = self._motion
        if motion is None:
            return on_feedback
        motion.begin(setpoint)

        def watched(feedback: Any) -> None:
            motion.progress(feedback.readbacks)
            on_feedback(feedback)

        return watched

    def _ended(self, answer: Answer, units: Mapping[str, str]) -> Answer:
        """Tell the observer of the end of a motion."""
        if self._motion is not None:
            self._motion.progress(named_values(answer.readbacks, units), last=True)
        return answer


def check_bounds(problem: Problem, setpoint: Mapping[str, float]) -> None:
    """Check that a set-point is inside the bounds and limits of a problem, as far as it has the variables.

    Raises:
        BoundsError: If it is outside.
    """
    for v in problem.variables:
        if v.is_open:
            raise BoundsError(f"the bounds of {v.name} are known only once a run has begun")
        _check_range(v.name, setpoint, v.minimum, v.maximum, v.unit)
    for limit in problem.limits:
        if all(name in setpoint for name, _ in limit.coefficients) and not limit.is_met(setpoint):
            total = sum(c * setpoint[name] for name, c in limit.coefficients)
            raise BoundsError(
                f"the limit {limit.name} is {total:g} there; "
                f"{limit.minimum:g} to {limit.maximum:g} is allowed"
            )


def check_grids(problem: Problem, setpoint: Mapping[str, float]) -> None:
    """Check that a set-point is on the grids of a problem; what is fixed may have any value.

    Raises:
        BoundsError: If it is not.
    """
    for v in problem.variables:
        value = setpoint[v.name]
        if v.fixed is None and v.values is not None and not v.is_allowed(value):
            nearest = sorted(v.values.tolist(), key=lambda allowed: abs(allowed - value))[:2]
            raise BoundsError(
                f"set-point {v.name} is {value:g}, which is not on its grid; "
                f"{' and '.join(f'{each:g}' for each in sorted(nearest))} are allowed"
                + (f" ({', '.join(v.choice_names)})" if v.choice_names else "")
            )


def settle_on_bounds(problem: Problem, readbacks: Mapping[str, float]) -> dict[str, float]:
    """Return readbacks as a set-point: those a hair outside a bound are taken for the bound."""
    setpoint = dict(readbacks)
    for v in problem.variables:
        if v.name in setpoint:
            setpoint[v.name] = _settled(setpoint[v.name], v.minimum, v.maximum)
    return setpoint


def _settled(value: float, minimum: float, maximum: float) -> float:
    margin = READBACK_MARGIN * (maximum - minimum)
    near = minimum - margin <= value <= maximum + margin
    return min(max(value, minimum), maximum) if near else value


def _check_range(
    name: str, setpoint: Mapping[str, float], minimum: float, maximum: float, unit: str
) -> None:
    value = setpoint.get(name)
    if value is not None and not (math.isfinite(value) and minimum <= value <= maximum):
        allowed = f"{minimum:g} to {maximum:g} {unit}".rstrip()
        raise BoundsError(f"set-point {name} is {value:g}; {allowed} is allowed")
