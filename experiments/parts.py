"""Derived objectives predicted by the models of their parts, against models of the result alone.

    python -m experiments.parts --seeds 8

    orbit      distances of two orbits from the axis, each of two readings: hypot(x1, x2) and abs(y1) + abs(y2)
    emittance  sqrt(ex * ey), abs(ex / ey - 1) and a size that is measured itself
    ratio      transmission and brightness, both with the charge that came out
    rough      the difference of two readings that are rough together, and a smooth one

Printed are the hypervolumes after 10, 15, 20, 30 and 40 evaluations of each start, and the quantities that were ever
predicted by their parts.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable, Mapping

import numpy as np

from mobo_tuner.core import Optimizer, Problem
from mobo_tuner.core.derived import Derived

SHOWN = (10, 15, 20, 30, 40)
Measured = Mapping[str, float]


def orbit(c: list[float]) -> dict[str, float]:
    """Return the readings of two monitors."""
    return {
        "x1": c[0] + 0.5 * c[1] + 0.2 * c[2] ** 2 - 0.3,
        "x2": math.sin(c[1] - c[0]) + 0.3 * c[3] + 0.2,
        "y1": 1.2 * c[2] - 0.4 * c[3] + 0.2 * c[0] * c[1] - 0.5,
        "y2": c[3] + 0.3 * math.cos(2.0 * c[2]) - 0.1,
    }


def emittance(c: list[float]) -> dict[str, float]:
    """Return two emittances and a size."""
    return {
        "ex": 1.0 + 4.0 * (c[0] - 0.3) ** 2 + c[1] ** 2,
        "ey": 1.2 + 2.0 * (c[0] + 0.2) ** 2 + 2.0 * (c[1] - 0.4) ** 2 + 0.3 * c[2],
        "sz": 1.0 + (c[2] - c[1]) ** 2 + 0.5 * c[0],
    }


def ratio(c: list[float]) -> dict[str, float]:
    """Return the charges before and after, and two sizes."""
    before = 2.0 + 0.5 * c[2]
    return {
        "before": before,
        "after": before * math.exp(-1.5 * (c[0] ** 2 + (c[1] - 0.3) ** 2)),
        "sx": 0.3 + (c[0] - 0.6) ** 2,
        "sy": 0.4 + (c[1] + 0.4) ** 2 + 0.1 * c[2],
    }


def rough(c: list[float]) -> dict[str, float]:
    """Return two readings that are rough together, and a smooth one."""
    wave = 3.0 * math.sin(9.0 * c[0] + 7.0 * c[1])
    smooth = (c[0] - 0.4) ** 2 + (c[1] + 0.3) ** 2
    return {"p": smooth + wave, "q": wave, "r": (c[0] + 0.5) ** 2 + (c[1] - 0.2) ** 2}


Case = tuple[Callable[[list[float]], dict[str, float]], int, dict[str, str], dict[str, float]]
CASES: dict[str, Case] = {
    "orbit": (
        orbit,
        4,
        {"ox": "hypot(x1, x2)", "oy": "abs(y1) + abs(y2)"},
        {"ox": 2.0, "oy": 2.0},
    ),
    "emittance": (
        emittance,
        3,
        {"e4": "sqrt(ex * ey)", "asymmetry": "abs(ex / ey - 1)"},
        {"e4": 6.0, "asymmetry": 3.0, "sz": 4.0},
    ),
    "ratio": (
        ratio,
        3,
        {"lost": "-after / before", "dimness": "-after / (sx * sy)"},
        {"lost": 0.0, "dimness": 0.0},
    ),
    "rough": (rough, 2, {"s": "p - q"}, {"s": 4.0, "r": 4.0}),
}


def run(name: str, seed: int, evaluations: int, *, parts: bool) -> tuple[list[float], list[str]]:
    """Return the hypervolumes of a run, and what was ever predicted by its parts.

    Without parts, the optimiser is told the results of the formulas as if they were measured.
    """
    measure, d, formulas, references = CASES[name]
    problem = Problem.from_dict(
        {
            "variables": {f"c{i}": {"min": -1.0, "max": 1.0} for i in range(d)},
            "derived": {q: {"formula": text} for q, text in formulas.items()} if parts else {},
            "objectives": {quantity: {"reference": r} for quantity, r in references.items()},
        }
    )
    optimizer, found, composed = Optimizer(problem, seed=seed), [], set[str]()
    for index in range(evaluations):
        at = optimizer.ask()
        measured = measure([at[v] for v in problem.variable_names])
        if not parts:
            readings = {q: (value, 0.0) for q, value in measured.items()}
            results = {q: Derived(q, text).of(readings).value for q, text in formulas.items()}
            measured = {q: (measured | results)[q] for q in references}
        optimizer.tell(at, measured)
        composed |= optimizer.archive.models.by_parts
        if index + 1 in SHOWN:
            found.append(optimizer.hypervolume)
    return found, sorted(composed)


def main() -> None:
    """Print the hypervolumes of all runs, and their means."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("--cases", nargs="+", choices=CASES, default=[*CASES])
    parser.add_argument("--seeds", type=int, default=8)
    parser.add_argument("--evaluations", type=int, default=max(SHOWN))
    options = parser.parse_args()
    for name in options.cases:
        for label in ("result", "parts"):
            rows = []
            for seed in range(options.seeds):
                row, composed = run(name, seed, options.evaluations, parts=label == "parts")
                rows.append(row)
                shown = " ".join(f"{value:8.3f}" for value in row)
                print(f"{name:10} {label:6} {seed:5} {shown}  {' '.join(composed)}", flush=True)
            for what, of in (("mean", np.mean), ("worst", np.min)):
                shown = " ".join(f"{value:8.3f}" for value in of(rows, axis=0))
                print(f"{name:10} {label:6} {what:>5} {shown}", flush=True)


if __name__ == "__main__":
    main()
