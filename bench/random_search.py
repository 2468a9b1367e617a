"""Hypervolume of the optimiser against random search with as many evaluations, on the AWA surrogate.

The measure is the paper's ([Roussel2021], section subsec:convergence): objectives scaled to [-1, 1] over their range in
the data, reference point 1, noiseless machine. Prints one line a seed and the ratio of the means.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

import numpy as np

from awa_sim_node.surrogate import Surrogate
from awa_sim_node.surrogate.metadata import output_ranges
from mobo_tuner.core import Optimizer, Problem
from mobo_tuner.core.hypervolume import hypervolume

CONFIG = Path(__file__).resolve().parent.parent / "config" / "awa.yaml"


def main() -> None:
    """Run both on every seed."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--evaluations", type=int, default=60)
    parser.add_argument("--preset", default="default")
    arguments = parser.parse_args()

    problem = Problem.from_yaml(CONFIG)
    surrogate = Surrogate.load()
    names = problem.objective_names
    low, high = np.array([output_ranges()[name] for name in names]).T

    def score(objectives: np.ndarray) -> float:
        return hypervolume(2.0 * (objectives - low) / (high - low) - 1.0, np.ones(len(names)))

    print(
        f"{len(names)} objectives, {arguments.evaluations} evaluations, preset {arguments.preset}"
    )
    print("seed  optimiser  random  ratio  seconds per suggestion (median)")
    scores = []
    for seed in range(arguments.seeds):
        optimizer = Optimizer(problem, preset=arguments.preset, seed=seed)
        seconds = []
        for _ in range(arguments.evaluations):
            started = time.perf_counter()
            setpoint = optimizer.ask()
            seconds.append(time.perf_counter() - started)
            optimizer.tell(setpoint, surrogate.predict(setpoint))
        tuned = np.array([[e.values[n] for n in names] for e in optimizer.dataset.evaluations])

        rng = np.random.default_rng([seed, 12345])
        points = rng.uniform(-1.0, 1.0, (arguments.evaluations, len(problem.variables)))
        predictions = [surrogate.predict(problem.denormalize(x)) for x in points]
        random = np.array([[p[n] for n in names] for p in predictions])
        scores.append((score(tuned), score(random)))
        print(
            f"{seed:4d}  {scores[-1][0]:9.2f}  {scores[-1][1]:6.2f}  {scores[-1][0] / scores[-1][1]:5.2f}"
            f"  {np.median(seconds):.3f}",
            flush=True,
        )
    tuned_mean, random_mean = np.mean(scores, axis=0)
    print(f"mean  {tuned_mean:9.2f}  {random_mean:6.2f}  {tuned_mean / random_mean:5.2f}")


if __name__ == "__main__":
    main()
