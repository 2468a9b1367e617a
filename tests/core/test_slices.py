"""Slices of the models through a set-point."""

from __future__ import annotations

import numpy as np
import pytest

from mobo_tuner.core import Optimizer, Problem
from mobo_tuner.core.slices import slices

PROBLEM = Problem.from_dict(
    {
        "variables": {"a": {"min": 0.0, "max": 4.0}, "b": {"min": -1.0, "max": 1.0}},
        "objectives": {
            "f": {"direction": "maximize", "reference": -20.0},
            "g": {"reference": 20.0},
        },
    }
)


def truth(a: float, b: float) -> dict[str, float]:
    return {"f": 3.0 - (a - 1.0) ** 2 - b**2, "g": (a - 3.0) ** 2 + (b - 0.5) ** 2}


@pytest.fixture(scope="module")
def optimizer() -> Optimizer:
    optimizer = Optimizer(PROBLEM, seed=2, initial_evaluations=12, exploration=0.0)
    for _ in range(16):
        x = optimizer.ask()
        optimizer.tell(x, truth(**x))
    optimizer.ask()
    return optimizer


def test_the_models_are_near_the_truth_along_each_variable(optimizer: Optimizer) -> None:
    found = slices(optimizer, {"a": 2.0, "b": 0.2})
    assert [*found] == ["a", "b"]
    along = found["a"]
    np.testing.assert_allclose(along.values[[0, -1]], [0.0, 4.0])
    for name in ("f", "g"):
        true = np.array([truth(a, 0.2)[name] for a in along.values])
        inside = np.abs(along.means[name] - true) <= 3.0 * along.stddevs[name] + 0.2
        assert inside.mean() > 0.9
    assert (along.stddevs["f"] >= 0.0).all()


def test_the_acquisition_function_is_largest_at_the_candidate(optimizer: Optimizer) -> None:
    candidate = optimizer.ask()
    here = optimizer.log_acquisition(PROBLEM.normalize(candidate)[None])[0]
    for along in slices(optimizer, candidate).values():
        assert along.acquisition.max() <= here + 1e-3
    assert optimizer.ask() == candidate  # nothing was changed


def test_without_models_there_is_no_acquisition_function() -> None:
    optimizer = Optimizer(PROBLEM, seed=2, initial_evaluations=12)
    assert np.isnan(optimizer.log_acquisition(np.zeros((3, 2)))).all()
