"""What the presets ask: recorded once, so that a change of the code that changes it is seen."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mobo_tuner.core import Optimizer, Problem

RECORDED = json.loads((Path(__file__).parent / "asks_of_presets.json").read_text(encoding="utf-8"))
TOY: dict[str, Any] = {
    "variables": {"x1": {"min": -2.0, "max": 2.0}, "x2": {"min": -2.0, "max": 2.0}},
    "objectives": {"f1": {"reference": 4.3}, "f2": {"reference": 4.3}},
}
INJECTOR: dict[str, Any] = {
    "variables": {
        "K1": {"min": 400.0, "max": 550.0},
        "K2": {"min": 180.0, "max": 280.0},
        "phi1": {"min": -10.0, "max": 0.0},
        "phi2": {"min": -10.0, "max": 0.0},
        "G1": {"min": 60.0, "max": 75.0},
        "G2": {"min": 15.0, "max": 25.0},
    },
    "objectives": {f"f{p}": {"reference": 3.0} for p in range(7)},
    "constraints": {"g": {"min": -0.6}},
}


def toy(x: Mapping[str, float]) -> dict[str, float]:
    return {
        "f1": math.hypot(x["x1"] - 1.0, x["x2"] - 1.0),
        "f2": math.hypot(x["x1"] + 1.0, x["x2"] + 1.0),
    }


def injector(x: Mapping[str, float]) -> dict[str, float]:
    """Seven smooth objectives of six variables, each least somewhere else, and a constraint."""
    limits = INJECTOR["variables"]
    u = np.array([(x[n] - v["min"]) / (v["max"] - v["min"]) for n, v in limits.items()])
    values = {
        f"f{p}": float(np.sum((u - 0.5 - 0.4 * np.sin(np.arange(6) + p)) ** 2)) for p in range(7)
    }
    return values | {"g": float(np.cos(3.0 * u[0]) + 0.5 * u[3])}


CASES = {"toy": (TOY, toy), "injector": (INJECTOR, injector)}


def asks(case: str, preset: str) -> list[list[float]]:
    """The first twelve set-points, seven of which come from the models."""
    problem, machine = CASES[case]
    optimizer = Optimizer(Problem.from_dict(problem), preset=preset, seed=3, initial_evaluations=5)
    asked = []
    for _ in range(12):
        x = optimizer.ask()
        asked.append(list(x.values()))
        optimizer.tell(x, machine(x))
    return asked


@pytest.mark.parametrize("preset", ["default", "paper"])
@pytest.mark.parametrize("case", list(CASES))
def test_a_preset_asks_what_it_always_asked(case: str, preset: str) -> None:
    recorded = np.array(RECORDED[f"{case} {preset}"])
    # To the last bit on the computer that recorded it; another one rounds a little differently.
    np.testing.assert_allclose(asks(case, preset), recorded, rtol=1e-4, atol=1e-3)
