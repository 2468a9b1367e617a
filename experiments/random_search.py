"""Hypervolume of the optimiser and of random search with the same number of evaluations, on the AWA surrogate.

The measure is that of the paper (section subsec:convergence): objectives scaled to [-1, 1] over their range, reference
point 1, noiseless machine. Prints one line per seed and the ratio of the means.
"""

from __future__ import annotations

import argparse

import numpy as np

from experiments.problems import awa, run


def main() -> None:
    """Run both with every seed."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=5, help="number of seeds")
    parser.add_argument(
        "--evaluations", type=int, default=60, help="number of evaluations of a run"
    )
    parser.add_argument("--preset", default="default", help="preset of the optimiser")
    options = parser.parse_args()

    benchmark = awa()
    shape = (options.evaluations, len(benchmark.problem.variables))
    scores = []
    print(f"7 objectives, {options.evaluations} evaluations, preset {options.preset}")
    print("seed  optimiser  random  ratio  seconds per suggestion (median)")
    for seed in range(options.seeds):
        tuned = run(benchmark, options.evaluations, seed, preset=options.preset)
        points = np.random.default_rng([seed, 12345]).uniform(-1.0, 1.0, shape)
        scores.append((tuned.hypervolumes[-1], benchmark.score(benchmark.objectives(points))))
        print(_line(f"{seed:4d}", *scores[-1]), f"{np.median(tuned.asks):.3f}", flush=True)
    print(_line("mean", *np.mean(scores, axis=0)))


def _line(label: str, tuned: float, random: float) -> str:
    return f"{label}  {tuned:9.2f}  {random:6.2f}  {tuned / random:5.2f} "


if __name__ == "__main__":
    main()
