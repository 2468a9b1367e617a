"""What a machine must be able to do so that `MachineServer` can serve it.

A backend neither knows actions nor clients. Its coroutines run on the executor's thread: a simulated
machine steps itself, a bridge waits for topics.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Protocol

from rclpy.executors import Executor
from rclpy.task import Future

from mobo_msgs_py import msg
from mobo_msgs_py.action import EvaluateSetpoint

RAMPING = "ramping"
SETTLING = "settling"
MEASURING = "measuring"


@dataclass(frozen=True)
class Failure:
    """Why something was refused or ended early.

    Attributes:
        code: one of the error codes of `EvaluateSetpoint.Result`, not NONE.
        message: one sentence for the user.
    """

    code: int
    message: str


@dataclass(frozen=True)
class Measurement:
    """What was measured, all or a part of it.

    Attributes:
        readbacks: one for each variable, averaged while measuring.
        diagnostics: those that were measured.
        shots: how many they are means of.
        failure: why the measurement is no good; None where it is, or where it was interrupted.
    """

    readbacks: Sequence[msg.NamedValue] = ()
    diagnostics: Sequence[msg.NamedValue] = ()
    shots: int = 0
    failure: Failure | None = None


@dataclass
class Operation:
    """A move, with or without a measurement, while it goes on: how far it is, and whether it must end.

    Attributes:
        interrupt: done when the operation must end. The machine was told to hold by then; whoever
            works on the operation returns soon, with what there is.
        phase: RAMPING, SETTLING or MEASURING.
        fraction: of this phase, 0 to 1.
    """

    executor: Executor
    hold: Callable[[], None]
    critical: Sequence[msg.Constraint] = ()
    on_phase: Callable[[], None] = lambda: None
    phase: str = ""
    fraction: float = 0.0
    interrupt: Future = field(init=False)

    def __post_init__(self) -> None:
        self.interrupt = Future(executor=self.executor)

    @property
    def failure(self) -> Failure | None:
        """Why the operation must end; None while it may go on."""
        return self.interrupt.result() if self.interrupt.done() else None

    def progress(self, phase: str, fraction: float) -> None:
        """Say how far the operation is; a new phase is told to the client at once."""
        changed = phase != self.phase
        self.phase, self.fraction = phase, min(1.0, max(0.0, fraction))
        if changed:
            self.on_phase()

    def shot(self, values: Mapping[str, float]) -> None:
        """Show the diagnostics of one shot; one beyond a critical limit ends the operation.

        What is NaN was not measured, and violates nothing.
        """
        for limit in self.critical:
            value = values.get(limit.name, math.nan)
            if value < limit.min or value > limit.max:
                unit = f" {limit.unit}" if limit.unit else ""
                self.stop(
                    Failure(
                        EvaluateSetpoint.Result.VIOLATION,
                        f"{limit.name} = {value:g}{unit} in one shot is outside the critical "
                        f"limits, {limit.min:g} to {limit.max:g}{unit}",
                    )
                )
                return

    def stop(self, failure: Failure) -> None:
        """End the operation for this reason; the machine holds at once. Only the first call counts."""
        if not self.interrupt.done():
            # Now, not when the operation's coroutine wakes up.
            self.hold()
            self.interrupt.set_result(failure)


class MachineBackend(Protocol):
    """A machine: what it is, and how it moves and measures. It is asked for one thing at a time."""

    @property
    def name(self) -> str:
        """Of the machine, for people."""

    @property
    def variables(self) -> Sequence[msg.Variable]:
        """What can be set, with hard limits."""

    @property
    def diagnostics(self) -> Sequence[msg.Observable]:
        """What can be measured."""

    @property
    def max_shots(self) -> int:
        """The most shots that a measurement may average over."""

    def refusal(self) -> Failure | None:
        """Why nothing may move now (INTERLOCK, NOT_ACTIVE, MACHINE_LOST); None where all may."""

    def readbacks(self) -> Iterable[msg.NamedValue]:
        """Where the machine is now; a variable whose readback is not known is NaN."""

    async def move(self, setpoint: Mapping[str, float], operation: Operation) -> Failure | None:
        """Go to a set-point within the limits, ramped, and settle there.

        Returns:
            Why the machine did not arrive; None where it did, or where it was interrupted.
        """

    async def measure(self, shots: int, operation: Operation) -> Measurement:
        """Measure where the machine is, showing every shot to `operation.shot`.

        Args:
            shots: to average over; 0 = as many as the machine thinks fit.
            operation: when it is interrupted, what was measured so far is returned.
        """

    def hold(self) -> None:
        """Stop at once whatever moves, where it is; called also when nothing does."""
