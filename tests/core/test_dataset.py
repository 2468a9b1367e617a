"""Evaluations: what counts as valid and feasible, and the arrays made of them."""

from __future__ import annotations

import math

import numpy as np
import pytest

from mobo_tuner.core.dataset import Dataset
from mobo_tuner.core.problem import Problem, ProblemError

PROBLEM = Problem.from_dict(
    {
        "variables": {"a": {"min": 0, "max": 2}, "b": {"min": -1, "max": 1}},
        "objectives": {
            "f": {"reference": 1.0},
            "g": {"reference": 0.0, "direction": "maximize"},
        },
        "constraints": {"h": {"max": 0.5}},
    }
)
MIDDLE = {"a": 1.0, "b": 0.0}


def test_arrays_follow_the_order_of_telling() -> None:
    data = Dataset(PROBLEM)
    data.add(MIDDLE, {"f": 0.1, "g": (2.0, 0.3), "h": 0.4})
    data.add({"a": 2.0, "b": -1.0}, {"f": 0.2, "g": 3.0, "h": 0.6, "extra": 9.0})
    np.testing.assert_array_equal(data.inputs, [[0.0, 0.0], [1.0, -1.0]])
    np.testing.assert_array_equal(data.objectives, [[0.1, -2.0], [0.2, -3.0]])
    np.testing.assert_array_equal(data.column("extra"), [math.nan, 9.0])
    np.testing.assert_array_equal(data.stddev_column("g"), [0.3, math.nan])
    np.testing.assert_array_equal(data.valid, [True, True])
    np.testing.assert_array_equal(data.feasible, [True, False])
    assert [e.index for e in data.evaluations] == [0, 1]


@pytest.mark.parametrize(
    "outputs",
    [
        {},
        {"f": 0.1, "g": 2.0},
        {"f": math.nan, "g": 2.0, "h": 0.1},
        {"f": 0.1, "g": math.inf, "h": 0.1},
        {"f": 0.1, "g": None, "h": 0.1},
        {"f": 0.1, "g": (math.nan, 1.0), "h": 0.1},
    ],
)
def test_what_is_not_measured_makes_an_evaluation_invalid(outputs: dict[str, float]) -> None:
    evaluation = Dataset(PROBLEM).add(MIDDLE, outputs)
    assert not evaluation.valid
    assert not evaluation.feasible


@pytest.mark.parametrize("value", ["high", (1.0, 2.0, 3.0), object(), ("a", 1.0)])
def test_an_output_that_is_no_number_is_refused(value: object) -> None:
    data = Dataset(PROBLEM)
    with pytest.raises(ProblemError, match="output 'f' must be a number or a pair"):
        data.add(MIDDLE, {"f": value})  # type: ignore[dict-item]
    assert len(data) == 0


def test_an_empty_dataset_has_empty_arrays() -> None:
    data = Dataset(PROBLEM)
    assert data.inputs.shape == (0, 2)
    assert data.objectives.shape == (0, 2)
    assert data.valid.shape == (0,)


def test_an_impossible_uncertainty_counts_as_unknown() -> None:
    data = Dataset(PROBLEM)
    data.add(MIDDLE, {"f": (0.1, -1.0), "g": (2.0, math.inf), "h": (0.1, 0.0)})
    np.testing.assert_array_equal(data.stddev_column("f"), [math.nan])
    np.testing.assert_array_equal(data.stddev_column("g"), [math.nan])
    np.testing.assert_array_equal(data.stddev_column("h"), [0.0])
