"""The table of simulations: complete, within its ranges, physically possible, and read with care."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from awa_sim_node.simulation.constants import VERSION
from awa_sim_node.simulation.samples import ROWS, sample
from awa_sim_node.simulation.table import HEADER
from awa_sim_node.surrogate import metadata
from awa_sim_node.surrogate.simulations import FIRST_HELD_OUT, SIMULATIONS_FILE, Simulations

RANGES = np.array([quantity.training_range for quantity in metadata.INPUTS])
ELECTRON_MASS = 0.51099895  # MeV


@pytest.fixture(scope="module")
def table() -> Simulations:
    return Simulations.read()


@pytest.fixture(scope="module")
def lines() -> list[str]:
    """The header and the first rows of the table."""
    with SIMULATIONS_FILE.open() as file:
        return [file.readline().strip() for _ in range(5)]


def test_the_table_is_the_whole_series(table: Simulations) -> None:
    np.testing.assert_array_equal(table.sample, np.arange(ROWS))
    assert ROWS >= 2000
    assert table.inputs.shape == (ROWS, 8)
    assert table.outputs.shape == (ROWS, 2, 9)
    assert np.all(table.version == int(VERSION))


def test_every_row_is_the_point_it_claims_to_be(table: Simulations) -> None:
    points = [sample(int(number)) for number in table.sample]
    np.testing.assert_array_equal(
        table.inputs,
        [[getattr(p.settings, quantity.name) for quantity in metadata.INPUTS] for p in points],
    )
    np.testing.assert_array_equal(table.region, [p.region for p in points])


def test_every_row_is_within_the_ranges_and_there_once(table: Simulations) -> None:
    assert np.all((table.inputs >= RANGES[:, 0]) & (table.inputs <= RANGES[:, 1]))
    assert len(np.unique(table.inputs, axis=0)) == len(table)


def test_outputs_are_physically_possible(table: Simulations) -> None:
    outputs = table.outputs
    assert np.all(outputs > 0.0)
    transmission = outputs[..., 8]
    assert np.all(transmission <= 1.0)
    # From 1.95 m (second plane) to 3.1 m beam can only be lost, and the energy hardly changes.
    assert np.all(transmission[:, 0] <= transmission[:, 1])
    assert np.abs(outputs[:, 0, 7] - outputs[:, 1, 7]).max() < 0.06
    # A longitudinal emittance is at most the product of length [um] and spread [mc^2].
    bound = outputs[..., 2] * 1e3 * outputs[..., 6] / ELECTRON_MASS
    assert np.all(outputs[..., 5] <= bound)


def test_held_out_rows_are_the_last_and_fill_the_box_and_the_corner(table: Simulations) -> None:
    held_out = table.where(table.held_out)
    assert len(table) - len(held_out) == FIRST_HELD_OUT >= 2000
    assert len(held_out) >= 200
    assert held_out.corner.sum() >= 60
    assert np.all(held_out.corner[held_out.region == "corner"])
    unit = (held_out.inputs - RANGES[:, 0]) / (RANGES[:, 1] - RANGES[:, 0])
    assert np.all(unit[held_out.region == "space"].min(axis=0) < 0.05)
    assert np.all(unit[held_out.region == "space"].max(axis=0) > 0.95)


@pytest.mark.parametrize(
    ("cell", "text", "message"),
    [
        ("eps_x@3.1", "nan", r"^eps_x@3\.1 = nan of sample 1 in .* must be a finite number$"),
        ("eps_x@3.1", "", r"^eps_x@3\.1 =  of sample 1 in .* must be a finite number$"),
        ("K1", "strong", r"^K1 = strong of sample 1 in .* must be a finite number$"),
        ("version", "old", r"^version = old of sample 1 in .* must be a finite number$"),
        ("sample", "0", r"must have each sample once, and has 0$"),
        ("region", "edge", r"^region = 'edge' in .* must be one of space, corner$"),
    ],
)
def test_a_bad_cell_is_named(
    tmp_path: Path, lines: list[str], cell: str, text: str, message: str
) -> None:
    cells = lines[2].split(",")
    cells[HEADER.split(",").index(cell)] = text
    with pytest.raises(ValueError, match=message):
        Simulations.read(_written(tmp_path, [*lines[:2], ",".join(cells)]))


def test_a_row_that_was_cut_off_is_refused(tmp_path: Path, lines: list[str]) -> None:
    with pytest.raises(ValueError, match=r"^transmission@3\.1 = None of sample 1 in .* must be"):
        Simulations.read(_written(tmp_path, [*lines[:2], lines[2].rsplit(",", 1)[0]]))


def test_another_table_is_refused(tmp_path: Path, lines: list[str]) -> None:
    header = lines[0].replace("charge", "current")
    with pytest.raises(ValueError, match=r"must have the column 'charge'$"):
        Simulations.read(_written(tmp_path, [header, *lines[1:]]))
    for content in ([], [""], ["mesh,sample"]):
        with pytest.raises(ValueError, match=r"must have the column 'version'$"):
            Simulations.read(_written(tmp_path, content))
    with pytest.raises(ValueError, match=r"must have at least one row$"):
        Simulations.read(_written(tmp_path, lines[:1]))
    with pytest.raises(FileNotFoundError, match=r"missing\.csv"):
        Simulations.read(tmp_path / "missing.csv")


def _written(folder: Path, lines: list[str]) -> Path:
    path = folder / "simulations.csv"
    path.write_text("\n".join(lines) + "\n")
    return path
