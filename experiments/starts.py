"""How many points the initial design should have: hypervolume against evaluations for several numbers of them.

    python -m experiments.starts [PROBLEM ...] [--seeds 8] [--evaluations 36]

The problems are those on which choices may be based (see `experiments.peers.problems.HELD_OUT`). Each number is a
multiple of the number of variables d, plus two. Printed are mean and worst seed of the hypervolume of the noiseless
values, as a share of the highest of all runs.
"""

from __future__ import annotations

import argparse

import numpy as np

from experiments.peers.problems import EVERY, HELD_OUT
from experiments.peers.race import hypervolumes, outputs
from mobo_tuner.core import Optimizer
from mobo_tuner.core.pareto import FloatArray

NUMBERS = {"d // 2 + 2": 0.5, "d + 2": 1.0, "2 d + 2": 2.0}
SHOWN = (12, 20, 30, 36, 60)  # evaluations
PROBLEMS = [
    *("toy", "dtlz2_3", "kursawe", "tnk", "osy", "awa_2", "awa_3"),
    *("well_3_3", "well_4_2", "tails_5_2", "cliff_4_3", "needle_3_2"),
]


def curve(name: str, seed: int, multiple: float, evaluations: int) -> FloatArray:
    """Return the hypervolume after each evaluation `(n,)`."""
    benchmark = EVERY[name]()
    problem = benchmark.problem
    starts = int(multiple * len(problem.variables)) + 2
    optimizer = Optimizer(problem, seed=seed, initial_evaluations=starts)
    for _ in range(evaluations):
        setpoint = optimizer.ask()
        optimizer.tell(setpoint, benchmark.measure(setpoint))
    x = np.array([problem.normalize(e.setpoint) for e in optimizer.dataset.evaluations])
    return hypervolumes(benchmark, outputs(benchmark, x))


def main() -> None:
    """Compare the numbers on the chosen problems."""
    parser = argparse.ArgumentParser(
        prog="python -m experiments.starts",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    allowed = [name for name in EVERY if name not in HELD_OUT]
    parser.add_argument("problems", nargs="*", default=PROBLEMS, metavar="PROBLEM")
    parser.add_argument("--seeds", type=int, default=8)
    parser.add_argument("--evaluations", type=int, default=36)
    options = parser.parse_args()
    for name in options.problems:
        if name not in allowed:
            parser.error(f"problem {name!r}: allowed are {', '.join(allowed)}")
        curves = {
            number: np.array(
                [curve(name, seed, multiple, options.evaluations) for seed in range(options.seeds)]
            )
            for number, multiple in NUMBERS.items()
        }
        highest = max(float(c.max()) for c in curves.values()) or 1.0
        for number, found in curves.items():
            shares = [
                f"{n}: {found[:, n - 1].mean() / highest:.3f}, {found[:, n - 1].min() / highest:.3f}"
                for n in SHOWN
                if n <= options.evaluations
            ]
            print(f"{name:12s} {number:10s}  {'   '.join(shares)}", flush=True)


if __name__ == "__main__":
    main()
