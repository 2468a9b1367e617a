"""One evaluation: going to a set-point, waiting until it is settled, and measuring there."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum

from awa_sim_node.machine.beam import Shot, ShotStatus
from awa_sim_node.machine.description import MachineDescription
from awa_sim_node.machine.diagnostics import Reading
from mobo_tuner.machine.averaging import average


class Phase(StrEnum):
    """What an evaluation is doing."""

    RAMP = "ramp"
    SETTLE = "settle"
    MEASURE = "measure"
    DONE = "done"
    STOPPED = "stopped"
    FAILED = "failed"

    @property
    def finished(self) -> bool:
        """Whether nothing more will happen."""
        return self in (Phase.DONE, Phase.STOPPED, Phase.FAILED)


class Cause(StrEnum):
    """Why an evaluation failed."""

    INTERLOCK = "interlock"
    TRIP = "trip"
    CHARGE = "charge"
    LOSS = "loss"
    NO_DATA = "no data"


@dataclass(frozen=True)
class EvaluationFailure:
    """Why an evaluation failed: the cause, and one sentence."""

    cause: Cause
    message: str


@dataclass(frozen=True)
class EvaluationResult:
    """What an evaluation brought.

    Attributes:
        readbacks: One reading a variable, averaged over the shots, in the machine's order.
        diagnostics: One reading a diagnostic, averaged over the shots, in the machine's order; NaN
            if not measured.
        shots: Number of shots that gave anything.
        retaken: Number of shots that were taken again besides, since their charge was off.
        duration: Simulated time the evaluation took [s].
        failure: Why it failed, with what was measured so far; None where it did not.
    """

    readbacks: tuple[Reading, ...]
    diagnostics: tuple[Reading, ...]
    shots: int
    retaken: int
    duration: float
    failure: EvaluationFailure | None = None


class Evaluation:
    """The state of an evaluation, kept by the machine and looked at by whoever drives it."""

    def __init__(self, setpoint: dict[str, float], shots: int, duration: float) -> None:
        """Create the state of an evaluation that is about to start.

        Args:
            setpoint: Where it goes.
            shots: Number of shots it will average.
            duration: Simulated time it will take if nothing goes wrong [s].
        """
        self.setpoint = setpoint
        self.shots = shots
        self.duration = duration
        self.phase = Phase.RAMP
        self.elapsed = 0.0
        self.waited = 0.0
        """Simulated time without progress so far, in trips or by shots that were retaken [s]."""
        self.without_beam = 0.0
        """Part of it without beam [s]."""
        self.retaken = 0
        self.result: EvaluationResult | None = None
        """The result; None until the evaluation is finished."""
        self._readbacks: list[dict[str, float]] = []
        self._shots: list[Shot] = []

    @property
    def fraction(self) -> float:
        """How far it is, from 0 to 1; it stays put once stopped."""
        if self.phase is Phase.DONE:
            return 1.0
        worked = max(0.0, self.elapsed - self.waited)
        return min(1.0, worked / self.duration) if self.duration > 0.0 else 0.0

    @property
    def remaining(self) -> float:
        """Simulated time until it is done, if nothing else goes wrong [s]."""
        if self.phase.finished:
            return 0.0
        return max(0.0, self.duration + self.waited - self.elapsed)

    @property
    def taken(self) -> int:
        """Number of shots taken so far, those retaken not counted."""
        return len(self._shots)

    @property
    def complete(self) -> bool:
        """Whether all shots are taken."""
        return self.taken >= self.shots

    def add(self, shot: Shot, readbacks: dict[str, float]) -> None:
        """Keep one shot, and what the readbacks showed with it."""
        self._shots.append(shot)
        self._readbacks.append(readbacks)

    def finish(
        self,
        description: MachineDescription,
        phase: Phase,
        failure: EvaluationFailure | None,
        where: dict[str, float],
    ) -> None:
        """End the evaluation with what was measured so far.

        Args:
            description: Of the machine.
            phase: How it ended.
            failure: Why, where ``phase`` is ``FAILED``.
            where: What the readbacks show now.
        """
        # Where the machine was stopped is worth knowing even if no shot was taken there.
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

    def verdict(self, description: MachineDescription) -> EvaluationFailure | None:
        """Return why the shots, all taken, are no measurement; None where they are one."""
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
                f"beam was lost in {len(lost)} of {self.taken} shots, down to a transmission of "
                f"{worst:.3g}, so that {missing[0]} could not be measured",
            )
        return EvaluationFailure(
            Cause.NO_DATA, f"none of {self.taken} shots gave a valid {missing[0]}"
        )


def _reading(name: str, unit: str, values: Sequence[float]) -> Reading:
    value, stddev = average(values)
    return Reading(name, value, stddev, unit)
