"""One evaluation: move to a set-point, wait until the machine is settled, and measure."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum

from awa_sim_node.machine.beam import Shot, ShotStatus
from awa_sim_node.machine.description import ModelDescription
from awa_sim_node.machine.diagnostics import Reading
from mobo_tuner.machine.averaging import average


class Phase(StrEnum):
    """Phase of an evaluation."""

    RAMP = "ramp"
    SETTLE = "settle"
    MEASURE = "measure"
    DONE = "done"
    STOPPED = "stopped"
    FAILED = "failed"

    @property
    def finished(self) -> bool:
        """Whether the evaluation has ended."""
        return self in (Phase.DONE, Phase.STOPPED, Phase.FAILED)


class Cause(StrEnum):
    """Cause of a failed evaluation."""

    INTERLOCK = "interlock"
    TRIP = "trip"
    CHARGE = "charge"
    LOSS = "loss"
    NO_DATA = "no data"


@dataclass(frozen=True)
class EvaluationFailure:
    """Failure of an evaluation.

    Attributes:
        cause: Cause of the failure.
        message: One sentence for people.
    """

    cause: Cause
    message: str


@dataclass(frozen=True)
class EvaluationResult:
    """Result of an evaluation.

    Attributes:
        readbacks: One reading per variable, averaged over the shots, in the machine's order.
        diagnostics: One reading per diagnostic, averaged over the shots, in the machine's order;
            NaN if it was not measured.
        shots: Number of shots that returned data.
        retaken: Number of additional shots that were discarded because of their charge.
        duration: Simulated time that the evaluation took [s].
        failure: Failure of the evaluation; None if it succeeded. The readings are those taken
            before it failed.
    """

    readbacks: tuple[Reading, ...]
    diagnostics: tuple[Reading, ...]
    shots: int
    retaken: int
    duration: float
    failure: EvaluationFailure | None = None


class Evaluation:
    """State of an evaluation, updated by the machine and read by its caller."""

    def __init__(self, setpoint: dict[str, float], shots: int, duration: float) -> None:
        """Create the state of an evaluation that is about to start.

        Args:
            setpoint: Set-point to evaluate.
            shots: Number of shots to average.
            duration: Simulated time that it takes without trips and retaken shots [s].
        """
        self.setpoint = setpoint
        self.shots = shots
        self.duration = duration
        self.phase = Phase.RAMP
        self.elapsed = 0.0
        self.waited = 0.0
        """Simulated time lost so far by trips and retaken shots [s]."""
        self.without_beam = 0.0
        """Part of ``waited`` without beam [s]."""
        self.retaken = 0
        self.result: EvaluationResult | None = None
        """Result of the evaluation; None until it is finished."""
        self._readbacks: list[dict[str, float]] = []
        self._shots: list[Shot] = []

    @property
    def fraction(self) -> float:
        """Progress from 0 to 1; it no longer changes once the evaluation is stopped."""
        if self.phase is Phase.DONE:
            return 1.0
        worked = max(0.0, self.elapsed - self.waited)
        return min(1.0, worked / self.duration) if self.duration > 0.0 else 0.0

    @property
    def remaining(self) -> float:
        """Simulated time until the evaluation is done, without further trips and retakes [s]."""
        if self.phase.finished:
            return 0.0
        return max(0.0, self.duration + self.waited - self.elapsed)

    @property
    def taken(self) -> int:
        """Number of shots taken so far, without retaken ones."""
        return len(self._shots)

    @property
    def complete(self) -> bool:
        """Whether all shots have been taken."""
        return self.taken >= self.shots

    def add(self, shot: Shot, readbacks: dict[str, float]) -> None:
        """Add one shot and the readbacks at its time."""
        self._shots.append(shot)
        self._readbacks.append(readbacks)

    def finish(
        self,
        description: ModelDescription,
        phase: Phase,
        failure: EvaluationFailure | None,
        where: dict[str, float],
    ) -> None:
        """End the evaluation with the shots taken so far.

        Args:
            description: Description of the machine.
            phase: Final phase.
            failure: Failure of the evaluation, if ``phase`` is ``FAILED``.
            where: Current readbacks, used if no shot was taken.
        """
        # The position is reported even if no shot was taken.
        readbacks = self._readbacks or [where]
        self.result = EvaluationResult(
            readbacks=tuple(
                _reading(v.name, v.unit, [each[v.name] for each in readbacks])
                for v in description.variables
            ),
            diagnostics=tuple(
                _reading(d.name, d.unit, [shot.measured[d.name] for shot in self._shots])
                for d in description.diagnostics
            ),
            shots=sum(shot.status is not ShotStatus.DROPPED for shot in self._shots),
            retaken=self.retaken,
            duration=self.elapsed,
            failure=failure,
        )
        self.phase = phase

    def verdict(self, description: ModelDescription) -> EvaluationFailure | None:
        """Return the failure if the completed shots do not form a valid measurement, else None."""
        missing = [
            diagnostic.name
            for diagnostic in description.diagnostics
            if all(math.isnan(shot.measured[diagnostic.name]) for shot in self._shots)
        ]
        if not missing:
            return None
        lost = [shot for shot in self._shots if shot.status is ShotStatus.LOST]
        if lost:
            worst = min(shot.measured["transmission"] for shot in lost)
            return EvaluationFailure(
                Cause.LOSS,
                f"{missing[0]} could not be measured: beam was lost in {len(lost)} of "
                f"{self.taken} shots; the lowest transmission was {worst:.3g}",
            )
        return EvaluationFailure(
            Cause.NO_DATA, f"{missing[0]} has no valid value in any of {self.taken} shots"
        )


def _reading(name: str, unit: str, values: Sequence[float]) -> Reading:
    value, stddev = average(values)
    return Reading(name, value, stddev, unit)
