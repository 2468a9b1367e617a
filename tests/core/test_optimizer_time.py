"""The time of a suggestion: its budget, and runs of thousands of evaluations.

Times are those of the processor, which a busy machine does not change.
"""

from __future__ import annotations

import json
import time

import numpy as np
import pytest

from mobo_tuner.core import Optimizer, Problem

NAMES = [f"x{k}" for k in range(4)]


def make(objectives: int, suggestion_seconds: float | None = None) -> Optimizer:
    problem = Problem.from_dict(
        {
            "variables": {name: {"min": -1.0, "max": 1.0} for name in NAMES},
            "objectives": {f"f{j}": {"reference": 3.0} for j in range(objectives)},
        }
    )
    return Optimizer(problem, suggestion_seconds=suggestion_seconds)


def tell(optimizer: Optimizer, count: int, fails: float = 2.0, seed: int = 0) -> float:
    """Tell evaluations at random set-points, which fail where x0 is above a limit [s]."""
    rng = np.random.default_rng(seed)
    objectives = len(optimizer.problem.objectives)
    centres = np.random.default_rng(9).uniform(-1.0, 1.0, (objectives, len(NAMES)))
    begin = time.process_time()
    for x in rng.uniform(-1.0, 1.0, (count, len(NAMES))):
        distances = np.linalg.norm(centres - x, axis=1).tolist()
        outputs = {f"f{j}": value for j, value in enumerate(distances)} if x[0] < fails else {}
        optimizer.tell(dict(zip(NAMES, x.tolist(), strict=True)), outputs)
    return time.process_time() - begin


def seconds_to_ask(optimizer: Optimizer) -> float:
    begin = time.process_time()
    setpoint = optimizer.ask()
    seconds = time.process_time() - begin
    assert optimizer.last_source == "model"
    assert all(-1.0 <= value <= 1.0 for value in setpoint.values())
    return seconds


@pytest.mark.parametrize(
    ("count", "budget", "fails"),
    [(20, 0.05, 2.0), (100, 0.05, 2.0), (300, 0.1, 2.0), (300, 0.2, 0.3), (2000, 0.5, 2.0)],
)
def test_a_time_budget_holds_for_the_training_too(count: int, budget: float, fails: float) -> None:
    seconds_to_ask_small = make(7)
    tell(seconds_to_ask_small, 12)
    seconds_to_ask(seconds_to_ask_small)  # what is compiled or loaded once
    optimizer = make(7, suggestion_seconds=budget)
    tell(optimizer, count, fails)
    assert seconds_to_ask(optimizer) < 1.5 * budget + 0.1
    tell(optimizer, 1, seed=1)
    assert seconds_to_ask(optimizer) < 1.5 * budget + 0.1


def test_two_thousand_evaluations_are_told_and_asked_after_in_seconds() -> None:
    first = tell(make(7), 500)
    optimizer = make(7)
    assert tell(optimizer, 2000) < 10.0 * first + 0.5
    assert seconds_to_ask(optimizer) < 10.0
    tell(optimizer, 1, seed=1)
    assert seconds_to_ask(optimizer) < 1.0
    assert max(model.n for model in optimizer.archive.models.objectives) <= 510


def test_many_evaluations_are_searched_as_well_as_few() -> None:
    optimizer = make(2)
    tell(optimizer, 1200)
    before = optimizer.hypervolume
    centres = np.random.default_rng(9).uniform(-1.0, 1.0, (2, len(NAMES)))
    for _ in range(6):
        setpoint = optimizer.ask()
        x = np.array(list(setpoint.values()))
        distances = np.linalg.norm(centres - x, axis=1)
        optimizer.tell(setpoint, dict(zip(("f0", "f1"), distances.tolist(), strict=True)))
    # Where the front is known to be: on the line between the two centres.
    line = centres[1] - centres[0]
    away = []
    for evaluation in optimizer.dataset.evaluations[1200:]:
        along = np.array(list(evaluation.setpoint.values())) - centres[0]
        away.append(np.linalg.norm(along - (along @ line) / (line @ line) * line))
    assert np.median(away) < 0.1
    assert optimizer.hypervolume > before


def test_a_restored_run_of_many_evaluations_asks_the_same() -> None:
    optimizer = make(2)
    tell(optimizer, 560, fails=0.9)
    for _ in range(2):
        optimizer.tell(optimizer.ask(), {"f0": 1.0, "f1": 1.0})
    restored = Optimizer.from_state(json.loads(json.dumps(optimizer.get_state())))
    for _ in range(2):
        setpoint = optimizer.ask()
        assert restored.ask() == setpoint
        for each in (optimizer, restored):
            each.tell(setpoint, {"f0": 1.5, "f1": 1.5})
    optimizer.forget(3)
    restored = Optimizer.from_state(json.loads(json.dumps(optimizer.get_state())))
    assert restored.ask() == optimizer.ask()
