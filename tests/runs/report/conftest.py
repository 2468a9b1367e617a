"""A run with evaluations of all kinds."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from tests.support.run_folders import evaluation, write_run


@pytest.fixture
def mixed(tmp_path: Path) -> Path:
    """Eight evaluations of all kinds, ended by the budget."""
    return write_run(
        tmp_path / "run1",
        [
            evaluation(0, {"f1": 5.0, "f2": 5.0}),
            evaluation(1, {"f1": math.nan, "f2": 1.0}, valid=False, feasible=False, error_code=3),
            evaluation(2, {"f1": 2.0, "f2": 8.0}),
            evaluation(3, {"f1": 6.0, "f2": 6.0}),  # dominated
            evaluation(4, {"f1": 1.0, "f2": 1.0}, feasible=False),
            evaluation(5, {"f1": 0.5, "f2": 10.0}),  # not better than the reference
            evaluation(6, {"f1": 8.0, "f2": 2.0}, suggest_seconds=0.7, total_seconds=0.97),
            evaluation(7, {"f1": 5.0, "f2": 5.0}),  # a repetition
        ],
        end={"stop_reason": "budget", "stamp": 2000.0},
    )
