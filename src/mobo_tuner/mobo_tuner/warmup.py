"""Compile the numerical kernels into numba's cache, so that the first run does not wait for them.

`python -m mobo_tuner.warmup` is part of the set-up.
"""

from __future__ import annotations

from mobo_tuner.core import Optimizer, Problem
from mobo_tuner.core.acquisition import ACQUISITION_FUNCTIONS
from mobo_tuner.core.hypervolume import BoxDecomposition
from mobo_tuner.core.pareto import count_nondominated

_PROBLEM = {
    "variables": {"x": {"min": 0.0, "max": 1.0}},
    "objectives": {"f": {"reference": 2.0}, "g": {"reference": 2.0}},
}


def warm_up() -> None:
    """Compute a few suggestions with every acquisition function."""
    for acquisition in ACQUISITION_FUNCTIONS:
        single = ACQUISITION_FUNCTIONS.find(acquisition).single_objective
        optimizer = Optimizer(
            Problem.from_dict(_PROBLEM),
            acquisition=acquisition,
            weights=(1.0, 1.0) if single else None,
            initial_evaluations=3,
        )
        for _ in range(5):
            setpoint = optimizer.ask()
            x = setpoint["x"]
            optimizer.tell(setpoint, {"f": x**2, "g": (1.0 - x) ** 2})
    far = [[9.0, 9.0]]
    BoxDecomposition([2.0, 2.0]).log_expected_improvement_with_gradient(far, [[0.1, 0.1]], None)
    count_nondominated([far])


if __name__ == "__main__":
    warm_up()
