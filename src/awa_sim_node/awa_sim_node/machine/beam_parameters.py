"""Parameters of the beam and of its measurement."""

from __future__ import annotations

from dataclasses import dataclass

from awa_sim_node.machine.parameter import CHOSEN, SOURCED, ParameterGroup, parameter


@dataclass(frozen=True)
class BeamParameters(ParameterGroup):
    """Parameters of the beam and of its measurement."""

    repetition_rate: float = parameter("shots per second [Hz]", 0.01, 1000.0, SOURCED)
    shots: int = parameter(
        "number of shots averaged if an evaluation does not ask for another number",
        1,
        10_000,
        CHOSEN,
    )
    charge: float = parameter("target bunch charge [nC]", 30.0, 50.0, SOURCED)
    coupler_kick: float = parameter(
        "integrated quadrupole kick of the linac coupler [mT]", 0.0, 2.5
    )
    noise_scale: float = parameter(
        "factor on the noise of all diagnostics on a good day", 0.0, 100.0
    )
    dropout: float = parameter("probability that a shot returns no data", 0.0, 1.0)
    invalid_image: float = parameter("probability that an image cannot be evaluated", 0.0, 1.0)
    charge_window: float = parameter(
        "largest relative deviation of a shot's charge from the target; shots beyond it are "
        "retaken; 0 = no limit",
        0.0,
        1.0,
        SOURCED,
    )
    retakes: float = parameter(
        "highest number of retaken shots per requested shot", 0.0, 1000.0, CHOSEN
    )
    loss_limit: float = parameter("transmission below which a shot is invalid", 0.0, 1.0)
