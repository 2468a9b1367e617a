"""The package by itself, for `colcon test`; the whole test suite is in tests/ of the repository."""

import importlib
from pathlib import Path

import pytest

from mobo_tuner.core import Problem
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
