"""Count violations of a constraint by suggestions that must be believed safe, and by the usual ones.

    python -m experiments.safe --seeds 20

Three problems, whose fronts end at a constraint; both methods begin at the same safe point.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from mobo_tuner.core import Optimizer, Problem

EVALUATIONS = 40
SAFE = 0.95


@dataclass(frozen=True)
class Case:
    """A problem, its machine, and where it is safe."""

    name: str
    definition: Mapping[str, Any]
    measure: Callable[[Mapping[str, float]], dict[str, float]]
    start: Mapping[str, float]


def _definition(
    names: list[str], ends: tuple[float, float], reference: float, most: float
) -> dict[str, Any]:
    low, high = ends
    return {
        "variables": {name: {"min": low, "max": high} for name in names},
        "objectives": {name: {"reference": reference} for name in ("f1", "f2")},
        "constraints": {"g": {"max": most}},
    }


def _toy(x: Mapping[str, float]) -> dict[str, float]:
    a, b = x["x1"], x["x2"]
    return {"f1": float(np.hypot(a - 1, b - 1)), "f2": float(np.hypot(a + 1, b + 1)), "g": a}


def _bnh(x: Mapping[str, float]) -> dict[str, float]:
    a, b = x["x1"], x["x2"]
    return {"f1": a * a + b * b, "f2": (a - 5) ** 2 + (b - 5) ** 2, "g": float(np.hypot(a, b))}


def _curved(x: Mapping[str, float]) -> dict[str, float]:
    v = np.array([x[f"x{i}"] for i in range(1, 5)])
    g = float(v @ v + 0.8 * np.sin(3.0 * v[0]) * v[1])
    return {"f1": float(np.linalg.norm(v - 0.7)), "f2": float(np.linalg.norm(v + 0.7)), "g": g}


CASES = (
    Case(
        "toy",
        _definition(["x1", "x2"], (-2.0, 2.0), 4.3, -0.2),
        _toy,
        {"x1": -1.0, "x2": 0.5},
    ),
    Case(
        "bnh",
        _definition(["x1", "x2"], (0.0, 5.0), 60.0, 4.0),
        _bnh,
        {"x1": 1.0, "x2": 1.0},
    ),
    Case(
        "curved",
        _definition(["x1", "x2", "x3", "x4"], (-1.5, 1.5), 3.0, 1.0),
        _curved,
        {"x1": 0.0, "x2": 0.0, "x3": 0.1, "x4": 0.0},
    ),
)


def run(case: Case, seed: int, safe: bool, evaluations: int = EVALUATIONS) -> tuple[int, float]:
    """Tune once; return the number of violations and the hypervolume."""
    definition = dict(case.definition)
    if safe:
        limits = {n: {**c, "safe": SAFE} for n, c in definition["constraints"].items()}
        definition |= {"constraints": limits}
    problem = Problem.from_dict(definition)
    optimizer = Optimizer(problem, seed=seed)
    optimizer.tell(case.start, case.measure(case.start))
    violations = 0
    for _ in range(evaluations):
        setpoint = optimizer.ask()
        values = case.measure(setpoint)
        violations += not problem.is_feasible(values)
        optimizer.tell(setpoint, values)
    return violations, optimizer.hypervolume


def main() -> None:
    """Print the violations and hypervolumes of all problems."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--case", choices=[case.name for case in CASES])
    options = parser.parse_args()
    print(
        "| problem | violations, soft | violations, safe | hypervolume, safe / soft | worst seed |"
    )
    print("|---|---|---|---|---|")
    for case in CASES:
        if options.case not in (None, case.name):
            continue
        made = np.array(
            [[run(case, seed, safe) for safe in (False, True)] for seed in range(options.seeds)]
        )
        count = options.seeds * EVALUATIONS
        share = made[:, 1, 1] / made[:, 0, 1]
        soft, safe = 100.0 * made[:, :, 0].sum(axis=0) / count
        print(
            f"| {case.name} | {soft:.1f} % | {safe:.2f} % | {100 * np.median(share):.1f} % "
            f"| {100 * share.min():.1f} % |",
            flush=True,
        )


if __name__ == "__main__":
    main()
