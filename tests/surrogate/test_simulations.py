"""The table of simulations: complete, within its ranges, and physically possible."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.stats import qmc

from awa_sim_node.surrogate import metadata
from awa_sim_node.surrogate.simulations import SIMULATIONS_FILE, Simulations

RANGES = np.array([quantity.training_range for quantity in metadata.INPUTS])
ELECTRON_MASS = 0.51099895  # MeV


@pytest.fixture(scope="module")
def table() -> Simulations:
    return Simulations.read()


def test_size(table: Simulations) -> None:
    assert table.fine.sum() == 227
    assert (~table.fine).sum() == 500
    assert table.inputs.shape == (727, 8)
    assert table.outputs.shape == (727, 2, 9)
    assert SIMULATIONS_FILE.stat().st_size < 200_000


def test_every_row_is_within_the_ranges_and_there_once(table: Simulations) -> None:
    assert np.all((table.inputs >= RANGES[:, 0]) & (table.inputs <= RANGES[:, 1]))
    assert len(np.unique(table.inputs, axis=0)) == len(table.inputs)
    for fine in (True, False):
        assert len(np.unique(table.sample[table.fine == fine])) == (table.fine == fine).sum()


def test_fine_rows_are_the_sobol_points_they_claim_to_be(table: Simulations) -> None:
    low, high = RANGES.T
    corner_low, corner_high = low.copy(), high.copy()
    corner_low[1], corner_high[4] = 250.0, 66.0
    space = low + qmc.Sobol(8, seed=11).random(256) * (high - low)
    corner = corner_low + qmc.Sobol(8, seed=12).random(128) * (corner_high - corner_low)
    for sample, inputs in zip(table.sample[table.fine], table.inputs[table.fine], strict=True):
        ten, rest = divmod(int(sample), 10)
        expected = space[7 * ten + rest] if rest < 7 else corner[3 * ten + rest - 7]
        np.testing.assert_allclose(inputs, expected, rtol=1e-5, atol=1e-5)


def test_coarse_rows_are_round_beams_of_the_usual_charge(table: Simulations) -> None:
    coarse = ~table.fine
    assert np.all(table.inputs[coarse, 6] == 40.0)
    assert np.all(table.inputs[coarse, 7] == 0.0)
    widths = table.outputs[coarse][:, :, [0, 1]]
    emittances = table.outputs[coarse][:, :, [3, 4]]
    assert np.abs(np.log(widths[..., 0] / widths[..., 1])).max() < 0.03
    assert np.abs(np.log(emittances[..., 0] / emittances[..., 1])).max() < 0.05


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


def test_a_table_with_a_hole_is_refused(tmp_path: Path) -> None:
    lines = SIMULATIONS_FILE.read_text().splitlines()[:3]
    lines[2] = lines[2].rsplit(",", 1)[0] + ",nan"
    path = tmp_path / "simulations.csv"
    path.write_text("\n".join(lines) + "\n")
    with pytest.raises(ValueError, match=r"must hold finite values only$"):
        Simulations.read(path)
