"""What a context is worth: a machine whose optimum moves with a temperature, with and without it among the inputs.

    moving    the optimum moves by 40 % of a variable's range as the temperature swings, once in 40 evaluations
    steady    the temperature swings in the same way, and nothing depends on it

Printed at the last evaluation, as means of the seeds: the mean absolute error of the objectives that are reported for
the front, as a share of their range; the error of the reported hypervolume against the true one of the reported front
now; the true hypervolume of the reported front.

    python -m experiments.context --problems toy valley beam --seeds 5
"""

from __future__ import annotations

import argparse
import math

import numpy as np

from experiments.beliefs import BENCHMARKS, output_ranges, true_hypervolume
from experiments.drift import MOVED
from experiments.problems import Benchmark
from mobo_tuner.core import Optimizer, Problem
from mobo_tuner.core.arrays import FloatArray

_TRAVEL = 0.4  # of a normalised variable, to either side
_PERIOD = 40.0  # evaluations


def at(benchmark: Benchmark, name: str, warmth: float) -> Benchmark:
    """Return the machine at a temperature, from -1 to 1."""
    shift = np.zeros(len(benchmark.problem.variables))
    shift[benchmark.problem.variable_names.index(MOVED[name])] = _TRAVEL * warmth

    def objectives(x: FloatArray) -> FloatArray:
        return benchmark.objectives(x - shift)

    return Benchmark(benchmark.problem, objectives, benchmark.unit, benchmark.others)


def play(name: str, moving: bool, known: bool, seed: int, evaluations: int) -> list[float]:
    """Return the error of the front, that of the hypervolume, and the true hypervolume after a run."""
    benchmark = BENCHMARKS[name]()
    definition = benchmark.problem.to_dict()
    if known:
        definition["context"] = {"temperature": {"unit": "C"}}
    optimizer = Optimizer(Problem.from_dict(definition), seed=seed)
    now = benchmark
    for i in range(evaluations):
        warmth = math.sin(2.0 * math.pi * i / _PERIOD + seed)
        now = at(benchmark, name, warmth if moving else 0.0)
        setpoint = optimizer.ask()
        optimizer.tell(setpoint, now.measure(setpoint) | {"temperature": 21.0 + 2.0 * warmth})
    front = optimizer.pareto_front(probability=False)
    inputs = optimizer.dataset.inputs[[point["index"] for point in front]]
    ranges = output_ranges(benchmark)
    reported = np.array([[p["objectives"][n] for n in now.problem.objective_names] for p in front])
    scales = [ranges[n] for n in now.problem.objective_names]
    error = np.mean(np.abs(reported - now.objectives(inputs)) / scales) if front else math.nan
    true = true_hypervolume(now, inputs)
    return [float(error), optimizer.hypervolume / true - 1.0 if true else math.nan, true]


def main() -> None:
    """Print a row for each problem, with and without the context."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--problems", nargs="+", choices=list(MOVED), default=["toy", "beam"])
    parser.add_argument("--evaluations", type=int, default=60)
    parser.add_argument("--seeds", type=int, default=5)
    options = parser.parse_args()
    print("problem kind    context  |error|  reported/true-1  true hypervolume")
    for name in options.problems:
        for moving in (True, False):
            for known in (False, True):
                runs = [
                    play(name, moving, known, seed, options.evaluations)
                    for seed in range(options.seeds)
                ]
                error, _, true = np.mean(runs, axis=0)
                volume = np.mean([abs(run[1]) for run in runs])
                print(
                    f"{name:7s} {'moving' if moving else 'steady'}  {'known' if known else '-':7s}  "
                    f"{error:.4f}   {volume:.4f}           {true:.4g}",
                    flush=True,
                )


if __name__ == "__main__":
    main()
