"""Choices without an order: the same problem with names, and with numbers that stand for them.

    python -m experiments.choices --seeds 5

One of six targets is in the beam. Each moves the optimum and adds a loss of its own; neither follows their numbers.
Printed are the hypervolumes after 15 and 30 evaluations, with the choices told as names and as ordered numbers.
"""

from __future__ import annotations

import argparse

import numpy as np

from mobo_tuner.core import Optimizer, Problem

COUNT = 6
REFERENCE = 4.0
EVALUATIONS = (15, 30)


def make_problem(named: bool) -> Problem:
    """Return the problem, with names or with numbers as choices of its target."""
    values = [float(i) for i in range(COUNT)]
    names = [f"target {i}" for i in range(COUNT)]
    choices = {"choices": names, "values": values} if named else {"choices": values}
    return Problem.from_dict(
        {
            "variables": {
                "x": {"min": 0.0, "max": 1.0},
                "y": {"min": 0.0, "max": 1.0},
                "target": choices,
            },
            "objectives": {"f": {"reference": REFERENCE}, "g": {"reference": REFERENCE}},
        }
    )


def volumes(named: bool, seed: int) -> list[float]:
    """Return the hypervolumes of one run after `EVALUATIONS`."""
    rng = np.random.default_rng(100 + seed)
    losses, shifts = rng.permutation(COUNT) / 3.0, 0.1 * rng.permutation(COUNT)
    optimizer = Optimizer(make_problem(named), seed=seed)
    found = []
    for _ in range(max(EVALUATIONS)):
        setpoint = optimizer.ask()
        x, y, target = setpoint["x"], setpoint["y"], int(setpoint["target"])
        f = 4.0 * (x - 0.2 - shifts[target]) ** 2 + y + losses[target]
        g = 4.0 * (x - 0.8) ** 2 + (1.0 - y) ** 2 + losses[target]
        optimizer.tell(setpoint, {"f": f, "g": g})
        found.append(optimizer.hypervolume)
    return [found[count - 1] for count in EVALUATIONS]


def main() -> None:
    """Print both ways, seed by seed, and their means."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("--seeds", type=int, default=5)
    table = []
    for seed in range(parser.parse_args().seeds):
        row = [volume for named in (True, False) for volume in volumes(named, seed)]
        table.append(row)
        print(
            f"seed {seed}: names {row[0]:.3f} {row[1]:.3f}, numbers {row[2]:.3f} {row[3]:.3f}",
            flush=True,
        )
    means = np.mean(table, axis=0)
    print(f"mean: names {means[0]:.3f} {means[1]:.3f}, numbers {means[2]:.3f} {means[3]:.3f}")


if __name__ == "__main__":
    main()
