"""The paper's toy problem: sample efficiency, failures, a constraint.

Every run starts from 5 random points, as in the paper. Prints one part after another, averaged over the seeds.

    python -m experiments.toy --parts share failures constraint
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from typing import Any

import numpy as np

from experiments.problems import Benchmark, Run, run, toy

START: dict[str, Any] = {"initial_evaluations": 5, "initial_design": "random"}


def share(options: argparse.Namespace) -> None:
    """Print the fraction of the true hypervolume, reference point 4.3."""
    at = [10, 15, 20, 25, 40, 60]
    print(f"fraction of the true hypervolume by number of evaluations, {options.seeds} seeds")
    print("                " + "".join(f"{n:8d}" for n in at))
    curves = np.array([_run(toy(), 60, s, options).hypervolumes for s in range(options.seeds)])
    rows: dict[str, Callable[..., Any]] = {"mean": np.mean, "std.dev.": np.std, "lowest": np.min}
    for name, function in rows.items():
        print(
            f"{options.preset:8s}{name:8s}"
            + "".join(f"{function(curves[:, n - 1]):8.4f}" for n in at)
        )


def failures(options: argparse.Namespace) -> None:
    """Print the number of failed evaluations if half of the input space fails."""
    failing = toy(failing=True)
    counts = []
    for seed in range(options.seeds):
        outcome = _run(failing, 30, seed, options)
        valid = outcome.optimizer.dataset.valid
        counts.append(int((~valid[5:]).sum()))
    print(
        f"x1 > 0 fails: failures among 25 suggestions, {options.seeds} seeds: "
        f"median {np.median(counts):g}, all {counts}"
    )


def constraint(options: argparse.Namespace) -> None:
    """Print the fraction of evaluations that violate x1 <= 0.5."""
    feasible = np.array(
        [
            _run(toy(constrained=True), 50, s, options).optimizer.dataset.feasible
            for s in range(options.constraint_seeds)
        ]
    )
    print(f"fraction that violates x1 <= 0.5, {options.constraint_seeds} seeds")
    print("evaluations   first 5" + "".join(f"  {i + 1:3d}-{i + 9:<3d}" for i in range(5, 50, 9)))
    parts = [feasible[:, :5], *(feasible[:, i : i + 9] for i in range(5, 50, 9))]
    print("violating   " + "".join(f"{1.0 - p.mean():9.3f}" for p in parts))
    so_far = 1.0 - feasible.cumsum(axis=1) / np.arange(1, 51)
    print(
        "of all so far"
        + "".join(f"  {n}: {so_far[:, n - 1].mean():.3f}" for n in (5, 10, 20, 30, 40, 50))
    )


def _run(
    benchmark: Benchmark,
    evaluations: int,
    seed: int,
    options: argparse.Namespace,
) -> Run:
    return run(benchmark, evaluations, seed, preset=options.preset, **START)


PARTS: dict[str, Callable[[argparse.Namespace], None]] = {
    "share": share,
    "failures": failures,
    "constraint": constraint,
}


def main() -> None:
    """Print the selected parts."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--parts", nargs="+", choices=list(PARTS), default=list(PARTS), help="parts to print"
    )
    parser.add_argument("--preset", default="default", help="preset of the optimiser")
    parser.add_argument("--seeds", type=int, default=10, help="number of seeds")
    parser.add_argument(
        "--constraint-seeds", type=int, default=25, help="number of seeds for the constraint"
    )
    options = parser.parse_args()
    for part in options.parts:
        PARTS[part](options)


if __name__ == "__main__":
    main()
