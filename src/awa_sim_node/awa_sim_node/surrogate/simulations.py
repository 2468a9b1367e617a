"""The simulated beams the surrogate is trained on: one row a run of the particle-in-cell code."""

from __future__ import annotations

import csv
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from awa_sim_node.surrogate.metadata import INPUTS, OUTPUTS

SIMULATIONS_FILE: Final = Path(__file__).with_name("simulations.csv")
PLANES: Final = ("3.1", "1.95")
"""Where the beam was recorded [m from the cathode]: at the screen, and half-way to it."""


@dataclass(frozen=True)
class Simulations:
    """A table of n simulations.

    Attributes:
        inputs: The eight inputs, in the order of ``INPUTS`` and in their units, ``(n, 8)``.
        outputs: The nine outputs at both ``PLANES``, in the order of ``OUTPUTS``, ``(n, 2, 9)``.
        fine: Whether the row was made with the fine mesh, ``(n,)``.
        sample: Number of the row in its series, ``(n,)``.
    """

    inputs: NDArray[np.float64]
    outputs: NDArray[np.float64]
    fine: NDArray[np.bool_]
    sample: NDArray[np.int64]

    @property
    def corner(self) -> NDArray[np.bool_]:
        """Whether the row is in the hard corner, K2 > 250 A and G1 < 66 MV/m, ``(n,)``."""
        return (self.inputs[:, 1] > 250.0) & (self.inputs[:, 4] < 66.0)

    @classmethod
    def read(cls, path: Path = SIMULATIONS_FILE) -> Simulations:
        """Read a table.

        Raises:
            ValueError: If a value is not finite.
        """
        with path.open(newline="") as file:
            rows = list(csv.DictReader(file))
        inputs = [[float(row[quantity.name]) for quantity in INPUTS] for row in rows]
        outputs = [
            [[float(row[f"{quantity.name}@{plane}"]) for quantity in OUTPUTS] for plane in PLANES]
            for row in rows
        ]
        table = cls(
            np.asarray(inputs),
            np.asarray(outputs),
            np.asarray([row["mesh"] == "fine" for row in rows]),
            np.asarray([int(row["sample"]) for row in rows]),
        )
        if not (np.isfinite(table.inputs).all() and np.isfinite(table.outputs).all()):
            raise ValueError(f"{path} must hold finite values only")
        return table
