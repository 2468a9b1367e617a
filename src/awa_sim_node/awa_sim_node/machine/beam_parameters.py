"""How often there is beam, and how well it is measured."""

from __future__ import annotations

from dataclasses import dataclass

from awa_sim_node.machine.parameter import CHOSEN, SOURCED, ParameterGroup, parameter


@dataclass(frozen=True)
class BeamParameters(ParameterGroup):
    """How often there is beam, and how well it is measured."""

    repetition_rate: float = parameter("shots per second [Hz]", 0.01, 1000.0, SOURCED)
    shots: int = parameter(
        "shots that an evaluation averages unless it asks for a number", 1, 10_000, CHOSEN
    )
    charge: float = parameter("bunch charge that is aimed at [nC]", 30.0, 50.0, SOURCED)
    coupler_kick: float = parameter(
        "integrated quadrupole kick of the linac coupler [mT]", 0.0, 2.5
    )
    noise_scale: float = parameter(
        "noise of all diagnostics, as a multiple of that of a good day", 0.0, 100.0
    )
    dropout: float = parameter("probability that a shot gives nothing", 0.0, 1.0)
    invalid_image: float = parameter("probability that an image cannot be evaluated", 0.0, 1.0)
    charge_window: float = parameter(
        "shots whose charge is farther from the target are retaken, as a fraction; 0 = none are",
        0.0,
        1.0,
        SOURCED,
    )
    retakes: float = parameter(
        "retaken shots that an evaluation allows for each shot it asks for", 0.0, 1000.0, CHOSEN
    )
    loss_limit: float = parameter(
        "transmission below which a shot is no valid measurement", 0.0, 1.0
    )
