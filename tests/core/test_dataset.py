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
def test_what_is_not_measured_makes_an_evaluation_incomplete(outputs: dict[str, float]) -> None:
    data = Dataset(PROBLEM)
    evaluation = data.add(MIDDLE, outputs)
    assert not evaluation.complete
    assert not evaluation.feasible
    # Only where nothing that is required was measured has it failed.
    assert evaluation.failed == (outputs == {})
    assert evaluation.valid != evaluation.failed
    np.testing.assert_array_equal(data.failed, [evaluation.failed])


def test_what_the_machine_reports_decides_whether_an_evaluation_failed() -> None:
    data = Dataset(PROBLEM)
    data.add(MIDDLE, {"f": 0.1, "g": 2.0, "h": 0.4}, failed=True)
    data.add(MIDDLE, {}, failed=False)
    np.testing.assert_array_equal(data.failed, [True, False])
    np.testing.assert_array_equal(data.feasible, [False, False])
    np.testing.assert_array_equal(data.column("f"), [math.nan, math.nan])


def test_an_evaluation_or_a_diagnostic_is_withdrawn_and_taken_back() -> None:
    data = Dataset(PROBLEM)
    for f in (0.1, 0.2):
        data.add(MIDDLE, {"f": f, "g": 2.0, "h": 0.4})
    data.forget(0)
    data.forget(1, "g")
    np.testing.assert_array_equal(data.column("f"), [math.nan, 0.2])
    np.testing.assert_array_equal(data.column("g"), [math.nan, math.nan])
    np.testing.assert_array_equal(data.valid, [False, True])
    np.testing.assert_array_equal(data.failed, [False, False])
    np.testing.assert_array_equal(data.complete, [False, False])
    assert data.withdrawn == [(0, None), (1, "g")]
    data.unforget(0)
    data.unforget(1, "g")
    assert data.feasible.all()
    assert data.withdrawn == []


@pytest.mark.parametrize(
    ("index", "name", "sentence"),
    [(2, None, "index is 2"), (-1, None, "index is -1"), (True, None, "index"), (0, "q", "'q'")],
)
def test_what_was_never_told_cannot_be_withdrawn(
    index: int, name: str | None, sentence: str
) -> None:
    data = Dataset(PROBLEM)
    data.add(MIDDLE, {"f": 0.1})
    for change in (data.forget, data.unforget):
        with pytest.raises(ProblemError, match=sentence):
            change(index, name)


@pytest.mark.parametrize("value", ["high", (1.0, 2.0, 3.0), object(), ("a", 1.0)])
def test_an_output_that_is_no_number_is_refused(value: object) -> None:
    data = Dataset(PROBLEM)
    with pytest.raises(ProblemError, match="output 'f' must be a number"):
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
