"""Evaluations that are kept in little memory come back as they were."""

from __future__ import annotations

import math
import tracemalloc
from dataclasses import replace

import numpy as np
import pytest

from mobo_tuner.client import Evaluation
from mobo_tuner.displays.evaluations import EvaluationTable

FIRST = Evaluation(
    index=0,
    source="initial",
    attempts=2,
    stamp=1.75e9,
    setpoint={"K1": 420.0, "phi": -3.0},
    readbacks={"K1": 419.9},
    diagnostics={"size": (1.5, 0.1), "charge": (2.0, math.inf)},
    valid=True,
    feasible=True,
    non_dominated=False,
    hypervolume=0.5,
    hypervolume_measured=0.25,
    error_code=0,
    error_msg="",
    suggest_seconds=0.1,
    machine_seconds=1.0,
    total_seconds=1.2,
    run_id="run",
    objectives={"size": 1.5},
    units={"K1": "A"},
)
FAILED = replace(
    FIRST,
    index=7,
    source="operator",
    diagnostics={},
    valid=False,
    feasible=False,
    error_code=103,
    error_msg="the beam was lost",
    objectives={"size": -math.inf},
)


@pytest.fixture
def table() -> EvaluationTable:
    made = EvaluationTable()
    for evaluation in (FIRST, FAILED, replace(FIRST, index=8, setpoint={"K2": 1.0})):
        made.add(evaluation)
    return made


def test_evaluations_come_back_with_their_types(table: EvaluationTable) -> None:
    assert table[0] == FIRST
    assert table[1] == FAILED
    assert table[-1].setpoint == {"K2": 1.0}
    assert table[1:] == [FAILED, table[2]]
    for name, value in vars(table[0]).items():
        assert type(value) is type(getattr(FIRST, name)), name
    with pytest.raises(IndexError):
        table[3]


def test_one_quantity_of_all_evaluations_is_an_array(table: EvaluationTable) -> None:
    assert table.numbers("index").tolist() == [0.0, 7.0, 8.0]
    assert table.numbers("valid").tolist() == [1.0, 0.0, 1.0]
    np.testing.assert_equal(table.diagnostics("size"), [1.5, np.nan, 1.5])
    np.testing.assert_equal(table.objectives("size"), [1.5, -np.inf, 1.5])
    assert np.isnan(table.objectives("unknown")).all()
    assert len(EvaluationTable().objectives("size")) == 0


def test_an_evaluation_is_found_by_its_index(table: EvaluationTable) -> None:
    assert [table.position(index) for index in (0, 7, 8, 1, None)] == [0, 1, 2, None, None]


def test_an_evaluation_takes_less_than_a_kilobyte(table: EvaluationTable) -> None:
    tracemalloc.start()
    try:
        before, _ = tracemalloc.get_traced_memory()
        for index in range(1000):
            table.add(replace(FIRST, index=100 + index))
        after, _ = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert after - before < 1_000_000
