"""Names, units and ranges of the surrogate's inputs and outputs."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Final

DEFAULT_CHARGE: Final = 40.0
"""Default bunch charge [nC]: that of the paper."""

DEFAULT_COUPLER_KICK: Final = 1.2
"""Default integrated quadrupole kick of the linac coupler [mT].

It makes the beam at the screen about 15 % wider than high, as measured at the real machine.
"""


@dataclass(frozen=True)
class Input:
    """One input of the surrogate.

    Attributes:
        name: Name of the input.
        unit: Unit of the input.
        training_range: Range of the training data; inputs outside it are refused.
        machine_limits: Range that the simulated machine accepts: the paper's bounds for the six
            settings, the training range for charge and coupler kick.
        meaning: Short description.
    """

    name: str
    unit: str
    training_range: tuple[float, float]
    machine_limits: tuple[float, float]
    meaning: str


@dataclass(frozen=True)
class Output:
    """One output of the surrogate, at the screen 3.1 m from the cathode.

    Attributes:
        name: Name of the output.
        unit: Unit of the output; empty if it has none.
        meaning: Short description.
    """

    name: str
    unit: str
    meaning: str


SETTINGS: Final = (
    Input(
        "K1", "A", (392.5, 557.5), (400.0, 550.0), "current of the bucking and focusing solenoid"
    ),
    Input("K2", "A", (175.0, 285.0), (180.0, 280.0), "current of the matching solenoid"),
    Input("phi1", "deg", (-10.5, 0.5), (-10.0, 0.0), "gun phase from crest"),
    Input("phi2", "deg", (-10.5, 0.5), (-10.0, 0.0), "linac phase from crest"),
    Input("G1", "MV/m", (59.25, 75.75), (60.0, 75.0), "gun gradient"),
    Input("G2", "MV/m", (14.5, 25.5), (15.0, 25.0), "linac gradient"),
)
"""The six settings of the machine."""

INPUTS: Final = (
    *SETTINGS,
    Input("charge", "nC", (30.0, 50.0), (30.0, 50.0), "bunch charge"),
    Input(
        "coupler_kick", "mT", (0.0, 2.5), (0.0, 2.5), "integrated quadrupole kick of the coupler"
    ),
)
"""All inputs of the surrogate, in its order."""

OUTPUTS: Final = (
    Output("sigma_x", "mm", "rms beam width"),
    Output("sigma_y", "mm", "rms beam height"),
    Output("sigma_z", "mm", "rms bunch length"),
    Output("eps_x", "mm mrad", "normalised rms emittance, horizontal"),
    Output("eps_y", "mm mrad", "normalised rms emittance, vertical"),
    Output("eps_z", "mm mrad", "normalised rms emittance, longitudinal"),
    Output("dE", "MeV", "rms energy spread"),
    Output("energy", "MeV", "mean kinetic energy"),
    Output("transmission", "", "fraction of the bunch that reaches the screen"),
)
"""All outputs of the surrogate, in its order."""

TRAINED_FILE: Final = Path(__file__).with_name("trained.json")
"""Results of the training: held-out errors and the ranges of the outputs."""


def output_ranges() -> dict[str, tuple[float, float]]:
    """Return the lowest and highest value of each output over the machine's limits, in its unit.

    They serve to map every output to [-1, 1], as in the paper.
    """
    ranges = json.loads(TRAINED_FILE.read_text())["output_ranges"]
    return {output.name: (ranges[output.name][0], ranges[output.name][1]) for output in OUTPUTS}
