"""A machine that measures its own inputs, so that what acts on them can be seen by itself."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar

from awa_sim_node.machine.behaviour import AWA, Behaviour, Mode
from awa_sim_node.machine.description import Diagnostic, ModelDescription, Variable
from awa_sim_node.machine.diagnostics import ShotNoise
from awa_sim_node.machine.kind import Kind
from awa_sim_node.machine.models import Model

START = {"current": 100.0, "phase": 10.0, "other_phase": -10.0, "gradient": 70.0}


class EchoModel(Model):
    """Its diagnostics are its inputs, and a transmission that falls with the current over 150 A."""

    description = ModelDescription(
        name="echo",
        title="a machine that measures its own inputs",
        variables=(
            Variable("current", "A", 0.0, 200.0, START["current"]),
            Variable("phase", "deg", -50.0, 50.0, START["phase"]),
            Variable("other_phase", "deg", -50.0, 50.0, START["other_phase"]),
            Variable("gradient", "MV/m", 60.0, 75.0, START["gradient"]),
        ),
        diagnostics=(
            Diagnostic("current_seen", "A"),
            Diagnostic("phase_seen", "deg"),
            Diagnostic("other_phase_seen", "deg"),
            Diagnostic("gradient_seen", "MV/m"),
            Diagnostic("charge", "nC"),
            Diagnostic("transmission", ""),
        ),
    )
    kinds: ClassVar[Mapping[str, Kind]] = {
        "current": Kind.SOLENOID,
        "phase": Kind.PHASE,
        "other_phase": Kind.PHASE,
        "gradient": Kind.GRADIENT,
        "charge": Kind.CHARGE,
        "coupler_kick": Kind.FIXED,
    }
    noise: ClassVar[Mapping[str, ShotNoise]] = {
        "current_seen": ShotNoise(),
        "phase_seen": ShotNoise(),
        "other_phase_seen": ShotNoise(),
        "gradient_seen": ShotNoise(),
        "charge": ShotNoise(0.01),
        "transmission": ShotNoise(),
    }
    images: ClassVar[tuple[tuple[str, ...], ...]] = (
        ("phase_seen", "other_phase_seen"),
        ("gradient_seen",),
    )
    gun: ClassVar[str] = "gradient"
    modes: ClassVar[Mapping[Mode, Behaviour]] = AWA

    def true_values(self, inputs: Mapping[str, float]) -> dict[str, float]:
        """Return the inputs."""
        return {
            "current_seen": inputs["current"],
            "phase_seen": inputs["phase"],
            "other_phase_seen": inputs["other_phase"],
            "gradient_seen": inputs["gradient"],
            "charge": inputs["charge"],
            "transmission": 1.0 if inputs["current"] < 150.0 else 0.8,
        }
