"""A machine that changes at once: when is found, and what is said of it afterwards is true."""

from __future__ import annotations

import json
import math
from collections.abc import Callable

import numpy as np
import pytest

from mobo_tuner.core import Optimizer, Problem, ProblemError
from mobo_tuner.core.domain import sobol

PROBLEM = Problem.from_dict(
    {
        "variables": {name: {"min": -2.0, "max": 2.0} for name in "xy"},
        "objectives": {name: {"reference": 4.3} for name in "fg"},
    }
)
PERIOD = 30.0  # [s] between evaluations
Shift = Callable[[int], float]


def truth(x: float, y: float, shift: float) -> dict[str, float]:
    """Distances to two points that move along x together."""
    return {
        "f": math.hypot(x - shift - 1.0, y - 1.0),
        "g": math.hypot(x - shift + 1.0, y + 1.0),
    }


def measure(optimizer: Optimizer, shift: Shift, last: int, noise: float = 0.0) -> Optimizer:
    """Tell of evaluations all over the space, 30 s apart, up to a number of them."""
    rng = np.random.default_rng(5)
    points = 4.0 * sobol(2, 64, 3) - 2.0
    for i in range(len(optimizer.dataset), last):
        x, y = points[i]
        outputs = truth(x, y, shift(i))
        readings = {n: v + noise * rng.normal() for n, v in outputs.items()}
        optimizer.tell({"x": x, "y": y}, readings, time=1e9 + PERIOD * i)
    return optimizer


def suggest(optimizer: Optimizer, shift: Shift, count: int) -> None:
    """Evaluate suggestions, before each of which the models are trained, and train them once more.

    What is taken for drift first is seen to be a jump by the next training.
    """
    for i in range(len(optimizer.dataset), len(optimizer.dataset) + count):
        setpoint = optimizer.ask()
        optimizer.tell(setpoint, truth(**setpoint, shift=shift(i)), time=1e9 + PERIOD * i)
    optimizer.ask()


@pytest.mark.parametrize(
    ("drift", "first", "noise"),
    [("auto", 30, 0.0), ("auto", 30, 0.03), ("auto", 12, 0.0), ("on", 30, 0.0)],
)
def test_when_a_machine_changed_is_found(drift: str, first: int, noise: float) -> None:
    def jump(i: int) -> float:
        return 0.8 * (i >= first)

    optimizer = measure(Optimizer(PROBLEM, seed=0, drift=drift), jump, 44, noise)
    suggest(optimizer, jump, 2)
    assert optimizer.models.jumps == (1e9 + PERIOD * first,)
    assert any(f"before evaluation {first}" in hint for hint in optimizer.hints())
    promised = [
        (p["objectives"][n], truth(**p["setpoint"], shift=0.8)[n])
        for p in optimizer.pareto_front(probability=False)
        for n in "fg"
    ]
    off = np.abs(np.subtract(*np.transpose(promised)))
    assert np.median(off) < 0.02 + noise
    state = json.loads(json.dumps(optimizer.get_state()))
    restored = Optimizer.from_state(state)
    assert restored.models.jumps == optimizer.models.jumps
    assert restored.ask() == optimizer.ask()
    state["models"]["context"]["jumps"] = [float("nan")]
    with pytest.raises(ProblemError, match="not one that get_state gave"):
        Optimizer.from_state(state)


@pytest.mark.parametrize("noise", [0.0, 0.1])
def test_a_machine_that_is_steady_or_drifts_slowly_did_not_jump(noise: float) -> None:
    for shift in (lambda _: 0.0, lambda i: 0.02 * i):
        optimizer = measure(Optimizer(PROBLEM, seed=0, drift="auto"), shift, 44, noise)
        suggest(optimizer, shift, 2)
        assert optimizer.models.jumps == ()


def test_each_of_two_changes_is_found() -> None:
    def jumps(i: int) -> float:
        return 0.8 * (i >= 20) - 0.6 * (i >= 46)

    optimizer = measure(Optimizer(PROBLEM, seed=0, drift="on"), jumps, 36)
    suggest(optimizer, jumps, 2)
    measure(optimizer, jumps, 62)
    suggest(optimizer, jumps, 2)
    assert optimizer.models.jumps == (1e9 + PERIOD * 20, 1e9 + PERIOD * 46)
