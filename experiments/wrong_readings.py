"""What several wrong readings cost, of random kinds: the hypervolume visited and reported, against none of them.

One to five readings are 10 to 1e6 ranges off, in an objective, in a constraint or in all outputs, of either sign, alike
or not, one after another or not, at neighbouring set-points or where the optimiser asks, early or late.

    python -m experiments.wrong_readings --kinds 40
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from mobo_tuner.core import Optimizer, Problem

PROBLEM = Problem.from_dict(
    {
        "variables": {name: {"min": -2.0, "max": 2.0} for name in "xy"},
        "objectives": {name: {"reference": 3.0} for name in "fg"},
        "constraints": {"h": {"max": 1.5}},
    }
)
RANGES = {"f": 4.0, "g": 4.0, "h": 3.0}
EVALUATIONS = 40
TARGET = 0.98
MOST_REPORTED = 1.05


@dataclass(frozen=True)
class Kind:
    """Wrong readings of a run.

    Attributes:
        errors: What is added to the outputs, by name, in evaluations by index.
        set_points: Set-points in place of those that are asked, by index.
    """

    errors: Mapping[int, Mapping[str, float]]
    set_points: Mapping[int, dict[str, float]]


def truth(x: float, y: float) -> dict[str, float]:
    """Return the outputs at a set-point."""
    return {
        "f": math.hypot(x - 1.0, y - 1.0),
        "g": math.hypot(x + 1.0, y + 1.0),
        "h": 0.8 * abs(x - y),
    }


def kind(number: int) -> Kind:
    """Return a kind of wrong readings by its number."""
    rng = np.random.default_rng(number)
    count, near = int(rng.integers(1, 6)), bool(rng.random() < 0.5)
    start, times = int(rng.choice([2, 6, 12, 24])), float(10.0 ** rng.uniform(1.0, 6.0))
    sign = float(rng.choice([-1.0, 1.0]))
    outputs = [["f"], ["h"], ["f", "g"], ["f", "g", "h"]][int(rng.integers(4))]
    mixed, alike = bool(rng.random() < 0.3), bool(rng.random() < 0.5)
    base = rng.uniform(-1.5, 1.5, 2)
    if near or rng.random() < 0.5:
        at = list(range(start, start + count))
    else:
        at = sorted(rng.choice(np.arange(start, 36), count, replace=False).tolist())
    beside = {i: base + 0.05 * j * np.array([1.0, 0.5]) for j, i in enumerate(at)} if near else {}
    errors: dict[int, dict[str, float]] = {i: {} for i in at}
    for error in errors.values():
        for name in outputs:
            turned = sign * (float(rng.choice([-1.0, 1.0])) if mixed else 1.0)
            size = times if alike else times * float(10.0 ** rng.uniform(-1.0, 1.0))
            error[name] = turned * size * RANGES[name]
    return Kind(errors, {i: dict(zip("xy", x.tolist(), strict=True)) for i, x in beside.items()})


def play(case: Kind, seed: int) -> tuple[float, float]:
    """Return the hypervolume of the true values at all set-points of a run, and the one that is reported."""
    optimizer, check = Optimizer(PROBLEM, seed=seed), Optimizer(PROBLEM)
    for i in range(EVALUATIONS):
        setpoint = optimizer.ask()
        setpoint = case.set_points.get(i, setpoint)
        outputs = truth(**setpoint)
        check.tell(setpoint, outputs)
        errors = case.errors.get(i, {})
        optimizer.tell(setpoint, {name: v + errors.get(name, 0.0) for name, v in outputs.items()})
    return check.hypervolume, optimizer.hypervolume


def main() -> None:
    """Print every kind that misses the target, and how many there are."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--kinds", type=int, default=40, help="number of kinds")
    options = parser.parse_args()
    missed = 0
    for number in range(options.kinds):
        case = kind(number)
        without, _ = play(Kind({}, case.set_points), number)
        visited, reported = play(case, number)
        ratio = reported / visited
        if visited < TARGET * without or not 2.0 - MOST_REPORTED < ratio < MOST_REPORTED:
            missed += 1
            print(
                f"  {number}: wrong at {list(case.errors)}, visited {visited / without:.3f} of without, "
                f"reported / visited {ratio:.3g}",
                flush=True,
            )
    print(
        f"{missed} of {options.kinds} kinds miss {TARGET} of the hypervolume, or report another one"
    )


if __name__ == "__main__":
    main()
