"""One evaluation: going to a set-point, waiting until it is settled, and measuring there."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

from awa_sim_node.machine.diagnostics import Reading


class Phase(StrEnum):
    """What an evaluation is doing."""

    RAMP = "ramp"
    SETTLE = "settle"
    MEASURE = "measure"
    DONE = "done"
    STOPPED = "stopped"

    @property
    def finished(self) -> bool:
        """Whether nothing more will happen."""
        return self in (Phase.DONE, Phase.STOPPED)


@dataclass(frozen=True)
class EvaluationResult:
    """What an evaluation brought.

    Attributes:
        readbacks: One reading a variable, averaged over the shots, in the machine's order.
        diagnostics: One reading a diagnostic, averaged over the shots, in the machine's order; NaN
            if not measured.
        shots: Number of shots taken.
        duration: Simulated time the evaluation took [s].
    """

    readbacks: tuple[Reading, ...]
    diagnostics: tuple[Reading, ...]
    shots: int
    duration: float


class Evaluation:
    """The state of an evaluation, kept by the machine and looked at by whoever drives it."""

    def __init__(self, setpoint: dict[str, float], shots: int, duration: float) -> None:
        """Create the state of an evaluation that is about to start.

        Args:
            setpoint: Where it goes.
            shots: Number of shots it will average.
            duration: Simulated time it will take [s].
        """
        self.setpoint = setpoint
        self.shots = shots
        self.duration = duration
        self.phase = Phase.RAMP
        self.elapsed = 0.0
        self.result: EvaluationResult | None = None
        """The result; None until the evaluation is finished."""

    @property
    def fraction(self) -> float:
        """How much of its simulated time has passed, from 0 to 1; it stays put once stopped."""
        if self.phase is Phase.DONE:
            return 1.0
        return min(1.0, self.elapsed / self.duration) if self.duration > 0.0 else 0.0
