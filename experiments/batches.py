"""What batches cost: hypervolume after as many evaluations one at a time, and in batches.

    python -m experiments.batches [--problem awa] [--sizes 1 8] [--evaluations 160] [--seeds 3]

The machine is the surrogate of the injector, or the paper's toy problem, without noise. What is in the
output file already is not computed again.
"""

from __future__ import annotations

import argparse
import json
import time
from pathlib import Path

import numpy as np

from experiments.problems import Benchmark, awa, toy
from mobo_tuner.core import Optimizer

PROBLEMS = {"awa": awa, "toy": toy}


def run(benchmark: Benchmark, seed: int, size: int, evaluations: int) -> dict[str, float]:
    """Tune in batches; return the hypervolume and the median time of a batch [s]."""
    optimizer, seconds = Optimizer(benchmark.problem, seed=seed), []
    while len(optimizer.dataset) < evaluations:
        started = time.perf_counter()
        batch = optimizer.ask(min(size, evaluations - len(optimizer.dataset)))
        seconds.append(time.perf_counter() - started)
        for setpoint in batch:
            optimizer.tell(setpoint, benchmark.measure(setpoint))
    volume = optimizer.hypervolume / benchmark.unit
    return {"hypervolume": volume, "median_seconds": float(np.median(seconds))}


def main() -> None:
    """Run what is missing, and print one line for each run."""
    parser = argparse.ArgumentParser(prog="python -m experiments.batches")
    parser.add_argument("--problem", choices=tuple(PROBLEMS), default="awa")
    parser.add_argument("--sizes", type=int, nargs="+", default=[1, 8])
    parser.add_argument("--evaluations", type=int, default=160)
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--out", type=Path, default=Path("batches.json"))
    options = parser.parse_args()
    benchmark = PROBLEMS[options.problem]()
    results = json.loads(options.out.read_text()) if options.out.exists() else {}
    for seed in range(options.seeds):
        for size in options.sizes:
            key = f"{options.problem} {options.evaluations} {size} {seed}"
            if key not in results:
                results[key] = run(benchmark, seed, size, options.evaluations)
                options.out.write_text(json.dumps(results))
            print(key, *(f"{value:.4g}" for value in results[key].values()), flush=True)


if __name__ == "__main__":
    main()
