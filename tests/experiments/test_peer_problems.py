"""The problems of the comparison, against values that BoTorch's and pymoo's definitions give (peer_problems.json)."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from experiments.peers.methods import METHODS, output_names
from experiments.peers.problems import HELD_OUT, PROBLEMS

ORACLE = json.loads(Path(__file__).with_name("peer_problems.json").read_text(encoding="utf-8"))


@pytest.mark.parametrize("name", ORACLE)
def test_values_agree_with_the_oracle(name: str) -> None:
    benchmark, told = PROBLEMS[name](), ORACLE[name]
    bounds = np.array([(v.minimum, v.maximum) for v in benchmark.problem.variables])
    low, high = bounds.T
    x = 2.0 * (np.array(told["x"]) - low) / (high - low) - 1.0
    np.testing.assert_allclose(benchmark.objectives(x), told["objectives"], rtol=1e-8)
    constraints = [c.name for c in benchmark.problem.constraints]
    assert len(constraints) == len(told.get("constraints", [[]])[0])
    for name, expected in zip(constraints, np.transpose(told.get("constraints", [])), strict=True):
        assert benchmark.others is not None
        np.testing.assert_allclose(benchmark.others[name](x), expected, rtol=1e-8, atol=1e-10)


def test_held_out_problems_have_an_oracle_and_are_apart_from_development() -> None:
    assert set(HELD_OUT) <= ORACLE.keys()
    own = {"toy", "dtlz2_3", "dtlz2_5", "awa_2", "awa_3", "awa_7"}
    published = {"bnh", "srn", "tnk", "osy", "cantilever", "i_beam", "truss", "kursawe", "dtlz7"}
    assert PROBLEMS.keys() - HELD_OUT == own | published


@pytest.mark.parametrize("method", ["default", "perfect", "random"])
def test_a_method_suggests_a_set_point_within_the_bounds(method: str) -> None:
    benchmark = PROBLEMS["disc_brake"]()
    x = np.random.default_rng(0).uniform(-1.0, 1.0, (6, 4))
    measured = [benchmark.measure(benchmark.problem.denormalize(row)) for row in x]
    y = np.array([[values[name] for name in output_names(benchmark)] for values in measured])
    suggested = METHODS[method](benchmark, len(x), 0, 1)(x, y)
    assert suggested.shape == (1, 4)
    if method == "random":
        assert METHODS[method](benchmark, len(x), 0, 3)(x, y).shape == (3, 4)
    assert (np.abs(suggested) <= 1.0).all()
