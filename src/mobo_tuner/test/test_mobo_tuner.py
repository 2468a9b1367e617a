"""The package by itself, for `colcon test`; the whole test suite is in tests/ of the repository."""

import importlib
import math
from pathlib import Path

import pytest

from mobo_tuner.core import Optimizer, Problem
from mobo_tuner.core.hypervolume import hypervolume

PACKAGE = Path(__file__).parents[1]


@pytest.mark.parametrize("node", ["console", "machine_bridge", "recorder", "steer", "tuner"])
def test_every_node_can_be_imported(node: str) -> None:
    assert callable(importlib.import_module(f"mobo_tuner.nodes.{node}").main)


def test_the_hypervolume_of_two_points() -> None:
    front = [[1.0, 2.0], [2.0, 1.0]]
    assert hypervolume(front, [3.0, 3.0]) == pytest.approx(3.0)


def test_the_shipped_problem_can_be_read() -> None:
    problem = Problem.from_yaml(PACKAGE / "config" / "awa.yaml")
    assert len(problem.objectives) == 7


def test_a_few_steps_find_a_front() -> None:
    problem = Problem.from_yaml(PACKAGE / "config" / "toy.yaml")
    optimizer = Optimizer(problem, seed=0)
    for _ in range(8):
        x = optimizer.ask()
        near, far = (math.hypot(x["x1"] - c, x["x2"] - c) for c in (1.0, -1.0))
        optimizer.tell(x, {"f1": near, "f2": far})
    assert optimizer.pareto_front()
    assert 0.0 < optimizer.hypervolume < 4.3**2
