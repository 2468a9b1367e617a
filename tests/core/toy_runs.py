"""Runs of the optimiser on the paper's toy problem."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any

from mobo_tuner.core import Optimizer, Problem

REFERENCE = 4.3
TOY: dict[str, Any] = {
    "variables": {"x1": {"min": -2.0, "max": 2.0}, "x2": {"min": -2.0, "max": 2.0}},
    "objectives": {"f1": {"reference": REFERENCE}, "f2": {"reference": REFERENCE}},
}
Machine = Callable[[Mapping[str, float]], dict[str, Any]]


def toy(x: Mapping[str, float]) -> dict[str, Any]:
    """The paper's toy problem, Eq. (eqn:toy_problem), and its constrained quantity g."""
    return {
        "f1": math.hypot(x["x1"] - 1.0, x["x2"] - 1.0),
        "f2": math.hypot(x["x1"] + 1.0, x["x2"] + 1.0),
        "g": x["x1"],
    }


def tune(optimizer: Optimizer, evaluations: int, machine: Machine = toy) -> list[dict[str, float]]:
    """Ask and tell; returns what was asked."""
    asked = []
    for _ in range(evaluations):
        asked.append(optimizer.ask())
        optimizer.tell(asked[-1], machine(asked[-1]))
    return asked


def with_changes(**changes: Any) -> Problem:
    return Problem.from_dict(TOY | changes)
