"""The training: it runs, learns, repeats itself, and never sees the held-out rows."""

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
from awa_sim_node.surrogate.simulations import SIMULATIONS_FILE, Simulations
from awa_sim_node.surrogate.train import Recipe, error_table, fit, held_out_errors, tables, train

SMALL = Recipe(members=1, hidden=12, steps=60, batch=200)


@pytest.fixture(scope="module")
def some() -> Simulations:
    table = Simulations.read()
    return table.where(table.sample < 600)


def test_the_script_writes_a_surrogate_that_loads(tmp_path: Path) -> None:
    arguments = ["--members", "2", "--steps", "3", "--folder", str(tmp_path)]
    script = [sys.executable, "-m", "awa_sim_node.surrogate.train", *arguments]
    done = subprocess.run(script, check=True, timeout=100, capture_output=True, text=True)
    content = json.loads((tmp_path / "trained.json").read_text())
    assert all(text in done.stdout for text in tables(content))
    assert content["recipe"]["steps"] == 3
    table = Simulations.read()
    assert content["rows"] == (~table.held_out).sum()
    assert content["held_out"]["box"]["rows"] == table.held_out.sum()
    assert content["held_out"]["corner"]["rows"] == (table.held_out & table.corner).sum()
    settings = {"K1": 475.0, "K2": 230.0, "phi1": -5.0, "phi2": -5.0, "G1": 67.5, "G2": 20.0}
    surrogate = Surrogate.load(tmp_path)
    low, high = content["output_ranges"]["energy"]
    assert low <= surrogate.predict(settings)["energy"] <= high
    # The weights are kept with fewer digits than they were trained with.
    again = held_out_errors(surrogate, table)["box"]["errors"]["eps_x"]
    assert again == pytest.approx(content["held_out"]["box"]["errors"]["eps_x"], rel=1e-3)


def test_the_weights_hold_plain_arrays() -> None:
    with np.load(metadata.TRAINED_FILE.with_name("weights.npz"), allow_pickle=False) as file:
        assert all(file[name].dtype == np.float32 for name in file.files)


def test_training_learns_and_repeats_itself(some: Simulations) -> None:
    untrained = EnsembleNetwork(1, SMALL.hidden, SMALL.seed).double()
    first, second = fit(some, SMALL), fit(some, SMALL)
    for one, other in zip(first.parameters(), second.parameters(), strict=True):
        assert torch.equal(one, other)
    simulated = some.outputs[:, 0]
    trained_error = error_table(Surrogate(first.arrays()).predict_array(some.inputs), simulated)
    before = error_table(Surrogate(untrained.arrays()).predict_array(some.inputs), simulated)
    assert trained_error["eps_x"]["median"] < 0.5 * before["eps_x"]["median"]


def test_members_differ(some: Simulations) -> None:
    both = fit(some, dataclasses.replace(SMALL, members=2, steps=5))
    for matrix in both.matrices():
        assert not torch.allclose(matrix[0], matrix[1])


def test_held_out_rows_are_never_seen(tmp_path: Path) -> None:
    """What the held-out rows say must change the errors only, not the weights."""
    text = SIMULATIONS_FILE.read_text().splitlines()
    table = Simulations.read()
    first = int(np.argmax(table.held_out))
    few = [text[0], *text[1:40], *text[1 + first : 21 + first]]
    wrong = [line if i < 40 else _with_larger_outputs(line) for i, line in enumerate(few)]
    contents = []
    for name, lines in (("right", few), ("wrong", wrong)):
        (tmp_path / name).mkdir()
        path = tmp_path / name / "table.csv"
        path.write_text("\n".join(lines) + "\n")
        recipe = dataclasses.replace(SMALL, steps=4, batch=16)
        contents.append(train(recipe, tmp_path / name, lambda _: None, path))
    right, wrong_ones = [np.load(tmp_path / name / "weights.npz") for name in ("right", "wrong")]
    for name in right.files:
        np.testing.assert_array_equal(right[name], wrong_ones[name])
    errors = [content["held_out"]["box"]["errors"]["energy"]["median"] for content in contents]
    assert errors[0] < 0.7 * errors[1]


def _with_larger_outputs(line: str) -> str:
    """The same row with a ten times greater energy at the screen."""
    cells = line.split(",")
    cells[-2] = str(10.0 * float(cells[-2]))
    return ",".join(cells)


def test_a_table_without_held_out_rows_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "table.csv"
    path.write_text("\n".join(SIMULATIONS_FILE.read_text().splitlines()[:4]) + "\n")
    with pytest.raises(ValueError, match=r"held-out rows, .* 3 and 0$"):
        train(SMALL, tmp_path, lambda _: None, path)


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
