"""The training data of the surrogate: one row per run of the particle-in-cell simulation."""

from __future__ import annotations

import csv
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from awa_sim_node.surrogate.metadata import INPUTS, OUTPUTS

SIMULATIONS_FILE: Final = Path(__file__).with_name("simulations.csv")
PLANES: Final = ("3.1", "1.95")
"""Positions of the recorded beams [m from the cathode]: the screen, and half-way to it."""

REGIONS: Final = ("space", "corner")
"""Purpose of a row: to fill the whole box, or the hard corner."""

FIRST_HELD_OUT: Final = 2000
"""Number of the first held-out sample. Every section of the series fills the space."""

_INPUTS: Final = [quantity.name for quantity in INPUTS]
_OUTPUTS: Final = [f"{quantity.name}@{plane}" for plane in PLANES for quantity in OUTPUTS]
_COLUMNS: Final = ["version", "sample", "region", *_INPUTS, *_OUTPUTS]


@dataclass(frozen=True)
class Simulations:
    """A table of n simulations.

    Attributes:
        inputs: Eight inputs, in the order of ``INPUTS`` and in their units, ``(n, 8)``.
        outputs: Nine outputs at both ``PLANES``, in the order of ``OUTPUTS``, ``(n, 2, 9)``.
        sample: Number of each row in the series, ``(n,)``.
        region: Purpose of each row, one of ``REGIONS``, ``(n,)``.
        version: Version of the simulation that computed each row, ``(n,)``.
    """

    inputs: NDArray[np.float64]
    outputs: NDArray[np.float64]
    sample: NDArray[np.int64]
    region: NDArray[np.str_]
    version: NDArray[np.int64]

    def __len__(self) -> int:
        return len(self.sample)

    @property
    def corner(self) -> NDArray[np.bool_]:
        """Whether the row is in the hard corner, K2 > 250 A and G1 < 66 MV/m, ``(n,)``."""
        return (self.inputs[:, 1] > 250.0) & (self.inputs[:, 4] < 66.0)

    @property
    def held_out(self) -> NDArray[np.bool_]:
        """Whether the row is excluded from the training, ``(n,)``."""
        return self.sample >= FIRST_HELD_OUT

    def where(self, rows: NDArray[np.bool_]) -> Simulations:
        """Return a table of the selected rows.

        Args:
            rows: Whether to keep each row, ``(n,)``.
        """
        return Simulations(*[getattr(self, field.name)[rows] for field in fields(self)])

    @classmethod
    def read(cls, path: Path = SIMULATIONS_FILE) -> Simulations:
        """Read a table.

        Args:
            path: CSV file.

        Raises:
            OSError: If the file cannot be read.
            ValueError: If a column is missing, there is no row, a sample occurs twice or has an
                unknown region, or a value is not a finite number.
        """
        with path.open(newline="") as file:
            reader = csv.DictReader(file)
            missing = [name for name in _COLUMNS if name not in (reader.fieldnames or ())]
            if missing:
                raise ValueError(f"{path} must have the column {missing[0]!r}")
            rows = list(reader)
        if not rows:
            raise ValueError(f"{path} must have at least one row")
        outputs = _numbers(path, rows, _OUTPUTS).reshape(-1, len(PLANES), len(OUTPUTS))
        table = cls(
            _numbers(path, rows, _INPUTS),
            outputs,
            _numbers(path, rows, ["sample"])[:, 0].astype(np.int64),
            np.asarray([row["region"] for row in rows]),
            _numbers(path, rows, ["version"])[:, 0].astype(np.int64),
        )
        numbers, counts = np.unique(table.sample, return_counts=True)
        if counts.max() > 1:
            raise ValueError(f"{path} must have each sample once, and has {numbers[counts > 1][0]}")
        unknown = ~np.isin(table.region, REGIONS)
        if unknown.any():
            raise ValueError(
                f"region = {str(table.region[unknown][0])!r} in {path} must be one of "
                f"{', '.join(REGIONS)}"
            )
        return table


def _numbers(path: Path, rows: list[dict[str, str]], columns: list[str]) -> NDArray[np.float64]:
    """Return some columns as numbers, ``(n, len(columns))``."""
    values = np.empty((len(rows), len(columns)))
    for i, row in enumerate(rows):
        for j, column in enumerate(columns):
            try:
                values[i, j] = float(row[column] or "nothing")
            except ValueError:
                values[i, j] = np.nan
            if not np.isfinite(values[i, j]):
                raise ValueError(
                    f"{column} = {row[column]} of sample {row['sample']} in {path} "
                    "must be a finite number"
                )
    return values
