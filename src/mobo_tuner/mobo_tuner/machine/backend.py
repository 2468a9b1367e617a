"""Interface between `MachineServer` and a machine.

A backend does not use actions or clients. Its coroutines run on the executor's thread.
`ramped.RampedBackend` is a backend for machines whose variables are ramped and read back,
`simple.SimpleMachine` one that consists of a few plain functions.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field

from rclpy.executors import Executor
from rclpy.task import Future

from mobo_msgs_py import msg
from mobo_msgs_py.action import EvaluateSetpoint
from mobo_tuner.machine.averaging import MAX_SHOTS
from mobo_tuner.ros.diagnostics import Health

# The constants PHASE_* of the actions.
RAMPING = "ramping"
SETTLING = "settling"
MEASURING = "measuring"


@dataclass(frozen=True)
class Failure:
    """Reason why something was refused or ended early.

    Attributes:
        code: Error code of `EvaluateSetpoint.Result`, not NONE.
        message: One sentence for the user.
    """

    code: int
    message: str


@dataclass(frozen=True)
class Measurement:
    """Result of a measurement, complete or partial.

    Attributes:
        readbacks: One value for each variable, averaged during the measurement.
        diagnostics: Diagnostics that were measured.
        shots: Number of shots that they are means of.
        failure: Reason why the measurement is invalid; None if it is valid or was interrupted.
    """

    readbacks: Sequence[msg.NamedValue] = ()
    diagnostics: Sequence[msg.NamedValue] = ()
    shots: int = 0
    failure: Failure | None = None


@dataclass
class Operation:
    """A running move or measurement: its progress, and whether it must end.

    Attributes:
        executor: Executor of the coroutines that wait for `interrupt`.
        hold: Function that makes the machine hold where it is.
        critical: Limits that no single shot may violate.
        on_phase: Function that is called when a new phase begins.
        phase: RAMPING, SETTLING or MEASURING; empty before the first phase.
        fraction: Completed part of this phase, 0 to 1.
        interrupt: Future that is done when the operation must end. The machine is holding by then;
            the backend's coroutine returns soon, with what it has.
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
        """Reason why the operation must end; None while it may continue."""
        return self.interrupt.result() if self.interrupt.done() else None

    def progress(self, phase: str, fraction: float) -> None:
        """Report how far the operation is; the client learns of a new phase at once."""
        changed = phase != self.phase
        self.phase, self.fraction = phase, min(1.0, max(0.0, fraction))
        if changed:
            self.on_phase()

    def shot(self, values: Mapping[str, float]) -> None:
        """Check the diagnostics of one shot; a value beyond a critical limit ends the operation.

        Args:
            values: Diagnostics by name; NaN was not measured and violates nothing.
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


class MachineBackend(ABC):
    """Description, moves and measurements of a machine, which does one thing at a time.

    Attributes:
        name: Name of the machine, for people.
        variables: Variables with their hard limits.
        diagnostics: Diagnostics that the machine can measure.
        max_shots: Largest number of shots that a measurement may average over.
        inactive: Reason why the state of the machine's node forbids motion; empty if it does not.
    """

    name: str
    variables: Sequence[msg.Variable]
    diagnostics: Sequence[msg.Observable]
    max_shots: int = MAX_SHOTS
    inactive: str = ""

    @abstractmethod
    def readbacks(self) -> Iterable[msg.NamedValue]:
        """Return the current readbacks; NaN for a variable whose readback is unknown."""

    @abstractmethod
    async def move(self, setpoint: Mapping[str, float], operation: Operation) -> Failure | None:
        """Ramp to a set-point and settle there.

        Args:
            setpoint: Values of all variables, within their limits.
            operation: Operation that this is part of.

        Returns:
            Reason why the machine did not arrive; None if it did or was interrupted.
        """

    @abstractmethod
    async def measure(self, shots: int, operation: Operation) -> Measurement:
        """Measure at the current position, passing every shot to `operation.shot`.

        Args:
            shots: Number of shots to average; 0 = the machine's own number.
            operation: Operation that this is part of; if it is interrupted, the measurement so far
                is returned.
        """

    @abstractmethod
    def hold(self) -> None:
        """Stop all moves at once; also called if nothing moves."""

    def refusal(self) -> Failure | None:
        """Return a failure (INTERLOCK, MACHINE_LOST) if nothing may move now; optional."""
        return None

    def parts(self) -> Mapping[str, Callable[[], Health]]:
        """Return functions for the health of further parts of the machine, by name; optional."""
        return {}

    def close(self) -> None:  # noqa: B027 - optional
        """Release what the backend holds, before its node is destroyed; optional."""
