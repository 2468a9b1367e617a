"""Set-points that the machine cannot tell apart: grids, dead bands and repetitions."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from mobo_tuner.core import Optimizer, Problem
from mobo_tuner.core.dataset import Dataset
from mobo_tuner.core.resolution import (
    SAME,
    grid_steps,
    is_repeated,
    readings_agree,
    readings_differ,
    taken,
)

Move = Callable[[dict[str, float]], dict[str, float]]


def problem(**bounds: tuple[float, float]) -> Problem:
    """A problem of one objective."""
    return Problem.from_dict(
        {
            "variables": {name: {"min": a, "max": b} for name, (a, b) in bounds.items()},
            "objectives": {"f": {"reference": 60.0}},
        }
    )


@pytest.mark.parametrize("step", [0.5, 0.2, 0.04])
@pytest.mark.parametrize("seed", range(5))
def test_the_step_of_a_grid_is_found_and_never_taken_for_a_wider_one(
    step: float, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    targets = rng.uniform(-1.0, 1.0, (12, 2))
    inputs = targets.copy()
    inputs[:, 0] = step * np.round(targets[:, 0] / step)
    steps = grid_steps(inputs, targets)
    assert steps[1] == 0.0
    assert 0.0 < steps[0] <= step * (1.0 + 1e-6)
    assert step / steps[0] == pytest.approx(round(step / steps[0]))


@pytest.mark.parametrize("readback", ["as sent", "offset", "noisy"])
def test_a_continuous_variable_has_no_grid(readback: str) -> None:
    rng = np.random.default_rng(1)
    targets = rng.uniform(-1.0, 1.0, (15, 3))
    shift: Any = {"as sent": 0.0, "offset": 0.3, "noisy": rng.normal(0.0, 0.01, (15, 3))}
    assert not grid_steps(targets + shift[readback], targets).any()


@pytest.mark.parametrize("told", ["set-point", "readback"])
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_every_value_of_an_integer_is_tried_before_any_is_repeated(told: str, seed: int) -> None:
    optimizer = Optimizer(problem(n=(1.0, 10.0)), seed=seed)
    tried = []
    for _ in range(11):
        setpoint = optimizer.ask()
        n = round(setpoint["n"])
        tried.append(n)
        outputs = {"f": (n - 7) ** 2 + 3.0 * math.sin(3.0 * n)}
        if told == "readback":
            optimizer.tell(setpoint, outputs, {"n": n})
        else:
            optimizer.tell({"n": n}, outputs)
    assert set(tried[:10]) == set(range(1, 11))
    assert optimizer.ask() == optimizer.ask()  # a repetition, as nothing else is left


def test_every_point_of_a_grid_is_tried_before_any_is_repeated() -> None:
    optimizer = Optimizer(problem(x=(0.0, 1.0), y=(0.0, 1.0)), seed=2)
    tried = set()
    for _ in range(25):
        setpoint = optimizer.ask()
        where = {name: round(4.0 * value) / 4.0 for name, value in setpoint.items()}
        tried.add(tuple(where.values()))
        optimizer.tell(setpoint, {"f": where["x"] ** 2 + where["y"]}, where)
    assert len(tried) == 25


def test_a_dead_band_costs_few_repetitions() -> None:
    optimizer = Optimizer(problem(x=(0.0, 1.0), y=(0.0, 1.0)), seed=1)
    at = {"x": 0.0, "y": 0.0}
    visited = set()
    for _ in range(30):
        setpoint = optimizer.ask()
        at = {n: v if abs(v - at[n]) > 0.03 else at[n] for n, v in setpoint.items()}
        visited.add(tuple(at.values()))
        optimizer.tell(setpoint, {"f": (at["x"] - 0.3) ** 2 + (at["y"] - 0.6) ** 2}, at)
    assert len(visited) >= 22
    assert min(e.values["f"] for e in optimizer.dataset.evaluations) < 1e-3


def test_a_readback_that_is_always_off_costs_few_repetitions() -> None:
    optimizer = Optimizer(problem(x=(0.0, 1.0), y=(0.0, 1.0)), seed=1)
    for _ in range(25):
        setpoint = optimizer.ask()
        at = {n: v + 0.0125 for n, v in setpoint.items()}
        # Best where x is least, which the readback never is.
        optimizer.tell(setpoint, {"f": 8.0 * at["x"] + (at["y"] - 0.3) ** 2}, at)
    targets = optimizer.dataset.targets
    distances = np.abs(targets[:, None] - targets).max(axis=2) + np.eye(len(targets))
    assert np.count_nonzero(distances.min(axis=1) < 2e-3) <= 8


@pytest.mark.parametrize(("acquisition", "noise"), [("ehvi", 0.0), ("ei", 0.0), ("ehvi", 0.05)])
@pytest.mark.parametrize("seed", [0, 4])
def test_a_slope_does_not_hide_the_well_beside_it(
    acquisition: str, noise: float, seed: int
) -> None:
    def f(x: float, y: float) -> float:
        well = math.exp(-(((x - 0.8) / 0.12) ** 2) - ((y - 0.7) / 0.12) ** 2)
        return x + y - 3.0 * well

    rng = np.random.default_rng(seed + 7)
    optimizer = Optimizer(problem(x=(0.0, 1.0), y=(0.0, 1.0)), seed=seed, acquisition=acquisition)
    evaluations = 48 if noise else 40
    for _ in range(evaluations):
        setpoint = optimizer.ask()
        optimizer.tell(setpoint, {"f": f(**setpoint) + noise * rng.normal()})
    asked = [e.setpoint for e in optimizer.dataset.evaluations]
    # A noisy reading may be worth taking again.
    assert (
        len({tuple(setpoint.values()) for setpoint in asked})
        >= (0.9 if noise else 1.0) * evaluations
    )
    assert min(f(**setpoint) for setpoint in asked) < -1.3


def told(rows: list[tuple[float, float, dict[str, Any]]]) -> Dataset:
    """Evaluations: set-point, readback and outputs."""
    data = Dataset(problem(x=(-1.0, 1.0)))
    for target, where, outputs in rows:
        data.add({"x": target}, outputs, {"x": where})
    return data


def test_a_repeated_place_is_taken_as_far_as_its_targets_were() -> None:
    used = taken(told([(0.1, 0.0, {"f": 1.0}), (-0.05, 0.0, {"f": 1.0}), (0.5, 0.5, {"f": 2.0})]))
    x = np.array([[0.19], [-0.19], [0.21], [0.5], [0.5 + 10.0 * SAME], [-0.5]])
    assert used.contains(x).tolist() == [True, True, False, True, False, False]


def test_an_evaluation_that_lacks_an_output_may_be_measured_again() -> None:
    both = Problem.from_dict(
        {
            "variables": {"x": {"min": -1.0, "max": 1.0}},
            "objectives": {"f": {"reference": 1.0}, "g": {"reference": 1.0}},
        }
    )
    data = Dataset(both)
    data.add({"x": 0.0}, {"f": 0.5})
    at = np.zeros((1, 1))
    assert taken(data).contains(at).all()  # where g was measured nowhere, nothing is expected of it
    data.add({"x": 1.0}, {"g": 0.5, "f": 0.5})
    assert not taken(data).contains(at).any()
    data.add({"x": 0.0}, {"f": 0.5})
    assert taken(data).contains(at).all()  # it will not be measured there


@pytest.mark.parametrize("known", [(), ("x",)])
def test_what_lacks_an_output_is_not_asked_again_and_again(known: tuple[str, ...]) -> None:
    grid = {"min": 0, "max": 2, "step": 1}
    objectives = {"f": {"reference": 5.0}, "g": {"reference": 5.0}}
    tuned = Optimizer(
        Problem.from_dict({"variables": {"x": grid, "y": grid}, "objectives": objectives})
    )
    asked = []
    for _ in range(9):
        at = tuned.ask()
        asked.append((at["x"], at["y"]))
        outputs = {"f": abs(at["x"] - 1.0) + at["y"], "g": 2.0 - at["y"] + at["x"]}
        tuned.tell(at, outputs if known and at["x"] != 1.0 else {"f": outputs["f"]})
    assert max(Counter(asked).values()) <= (2 if known else 1)


def test_repetitions_tell_whether_readings_are_noisy() -> None:
    rows: list[tuple[float, float, dict[str, Any]]] = [(x, x, {"f": x}) for x in (0.0, 0.5, 0.5)]
    assert not readings_differ(told(rows))
    assert readings_differ(told([*rows, (0.5, 0.5, {"f": 0.6})]))


def test_where_the_noise_is_known_a_setpoint_may_be_measured_again() -> None:
    optimizer = Optimizer(problem(x=(0.0, 1.0)), seed=1)
    rng = np.random.default_rng(0)
    for _ in range(20):
        setpoint = optimizer.ask()
        optimizer.tell(setpoint, {"f": (10.0 * setpoint["x"] + rng.normal(0.0, 1.0), 1.0)})
    places = np.round([e.setpoint["x"] for e in optimizer.dataset.evaluations], 3)
    assert 1 < np.unique(places, return_counts=True)[1].max() < 15


def test_what_was_measured_again_says_whether_the_machine_is_noisy() -> None:
    data = Dataset(
        Problem.from_dict(
            {
                "variables": {"a": {"min": 0.0, "max": 1.0}},
                "objectives": {name: {"reference": 60.0} for name in "fg"},
            }
        )
    )

    def told(a: float, **outputs: float) -> tuple[bool, bool, bool]:
        data.add({"a": a}, outputs)
        return is_repeated(data), readings_agree(data), readings_differ(data)

    assert told(0.2, f=1.0, g=5.0) == (False, False, False)
    assert told(0.7, f=3.0, g=6.0) == (False, False, False)
    assert told(0.2, f=1.0) == (True, False, False)  # nothing is known of g yet
    assert told(0.7, f=3.0, g=6.0) == (True, True, False)
    assert told(0.2, f=1.1, g=5.0) == (True, False, True)
