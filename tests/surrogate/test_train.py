"""The training script: it runs, learns, repeats itself, and keeps the held-out rows out."""

from __future__ import annotations

import dataclasses
import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import torch

from awa_sim_node.surrogate import Surrogate, metadata
from awa_sim_node.surrogate.network import EnsembleNetwork
from awa_sim_node.surrogate.simulations import Simulations
from awa_sim_node.surrogate.train import Recipe, cross_validate, error_table, fit

SMALL = Recipe(members=1, hidden=12, iterations=60)


@pytest.fixture(scope="module")
def table() -> Simulations:
    return Simulations.read()


def test_the_script_writes_a_surrogate_that_loads(tmp_path: Path) -> None:
    arguments = ["--members", "1", "--iterations", "5", "--folds", "2", "--folder", str(tmp_path)]
    script = [sys.executable, "-m", "awa_sim_node.surrogate.train", *arguments]
    done = subprocess.run(script, check=True, timeout=120, capture_output=True, text=True)
    assert "| transmission | " in done.stdout
    content = json.loads((tmp_path / "trained.json").read_text())
    assert content["recipe"]["iterations"] == 5
    assert content["held_out"]["box"]["rows"] == 227
    assert content["held_out"]["corner"]["rows"] == 89
    settings = {"K1": 475.0, "K2": 230.0, "phi1": -5.0, "phi2": -5.0, "G1": 67.5, "G2": 20.0}
    beam = Surrogate.load(tmp_path).predict(settings)
    low, high = content["output_ranges"]["energy"]
    assert low <= beam["energy"] <= high


def test_the_weights_hold_plain_arrays() -> None:
    with np.load(metadata.TRAINED_FILE.with_name("weights.npz"), allow_pickle=False) as file:
        assert all(file[name].dtype == np.float32 for name in file.files)


def test_training_learns_and_repeats_itself(table: Simulations) -> None:
    weights = np.ones((1, len(table.inputs)))
    untrained = EnsembleNetwork(1, SMALL.hidden, SMALL.seed).double()
    first, second = fit(table, weights, SMALL), fit(table, weights, SMALL)
    for one, other in zip(first.parameters(), second.parameters(), strict=True):
        assert torch.equal(one, other)
    simulated = table.outputs[table.fine, 0]
    trained_error = error_table(Surrogate(first).predict_array(table.inputs[table.fine]), simulated)
    before = error_table(Surrogate(untrained).predict_array(table.inputs[table.fine]), simulated)
    assert trained_error["eps_x"]["median"] < 0.5 * before["eps_x"]["median"]


def test_members_are_trained_as_if_alone(table: Simulations) -> None:
    both = fit(table, np.ones((2, len(table.inputs))), SMALL)
    other = np.ones((2, len(table.inputs)))
    other[1, ::2] = 0.0
    changed = fit(table, other, SMALL)
    for one, two in zip(both.parameters(), changed.parameters(), strict=True):
        torch.testing.assert_close(one[0], two[0], rtol=1e-4, atol=1e-5)
        assert not torch.equal(one[1], two[1])


def test_held_out_rows_stay_out(table: Simulations) -> None:
    """What a held-out row says must not change the prediction for it."""
    recipe = dataclasses.replace(SMALL, iterations=15)
    fine = np.flatnonzero(table.fine)
    fold = np.random.default_rng(recipe.seed).permutation(len(fine)) % 2
    predicted = cross_validate(table, recipe, folds=2)
    # Exchange two held-out rows of one fold, which keeps the scale of the outputs. The energy
    # stays: its scale depends on the inputs as well.
    one, other = fine[fold == 0][:2]
    outputs = table.outputs.copy()
    outputs[[one, other], :, :7] = outputs[[other, one], :, :7]
    again = cross_validate(dataclasses.replace(table, outputs=outputs), recipe, folds=2)
    np.testing.assert_allclose(again[fold == 0], predicted[fold == 0], rtol=1e-4)
    assert not np.allclose(again[fold == 1], predicted[fold == 1], rtol=1e-4)


def test_error_table() -> None:
    simulated = np.ones((3, 9))
    predicted = np.ones((3, 9))
    predicted[:, 0] = [1.1, 0.8, 1.0]
    predicted[:, 8] = [0.5, 1.0, 1.0]
    errors = error_table(predicted, simulated)
    assert errors["sigma_x"]["median"] == pytest.approx(0.1)
    assert errors["sigma_x"]["max"] == pytest.approx(0.2)
    assert errors["transmission"]["max"] == pytest.approx(0.5)
    assert errors["energy"] == {"median": 0.0, "p95": 0.0, "max": 0.0}
