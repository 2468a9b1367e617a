"""Number of evaluations that each preset needs to reach the hypervolume of a long NSGA-II run, on the AWA surrogate.

NSGA-II as in the paper: 20 individuals, crossover probability 0.8, mutation probability 0.05 (of each variable). The
hypervolume to reach includes all its evaluations, which favours NSGA-II; that of its last population is also shown. The
hypervolume of a front of more than 1000 points is estimated with random points in its box, with the standard error. The
result of random search with the same number of evaluations as the preset is also shown.

NSGA-II needs `experiments/requirements.txt`. All results, also of unfinished runs, are kept in experiments/.cache: an
interrupted benchmark continues where it stopped.
"""

from __future__ import annotations

import argparse
import json
import math

import numpy as np
from numba import njit

from experiments.problems import Benchmark, awa, cached, first_reaching, surrogate_digest
from experiments.run_cache import cached_run
from mobo_tuner.core.hypervolume import hypervolume
from mobo_tuner.core.pareto import FloatArray, is_nondominated

POPULATION = 20
MANY = 1000  # points of a front whose exact hypervolume would take minutes in seven objectives
SAMPLES = 1_000_000


def nsga2(benchmark: Benchmark, evaluations: int, seed: int) -> tuple[FloatArray, FloatArray]:
    """Return all objectives `(n, P)` evaluated by NSGA-II, in order, and those of its last population."""
    from pymoo.algorithms.moo.nsga2 import NSGA2
    from pymoo.core.problem import Problem as PymooProblem
    from pymoo.operators.crossover.sbx import SBX
    from pymoo.operators.mutation.pm import PM
    from pymoo.optimize import minimize

    d, n_objectives = len(benchmark.problem.variables), len(benchmark.problem.objectives)
    evaluated: list[FloatArray] = []

    class Adapter(PymooProblem):
        def __init__(self) -> None:
            super().__init__(n_var=d, n_obj=n_objectives, xl=-np.ones(d), xu=np.ones(d))

        def _evaluate(self, x: FloatArray, out: dict[str, FloatArray], *_: object) -> None:
            out["F"] = benchmark.objectives(x)
            evaluated.append(out["F"])

    algorithm = NSGA2(
        pop_size=POPULATION,
        crossover=SBX(prob=0.8, eta=15),
        mutation=PM(prob=1.0, prob_var=0.05, eta=20),
    )
    generations = math.ceil(evaluations / POPULATION)
    result = minimize(Adapter(), algorithm, ("n_gen", generations), seed=seed, copy_algorithm=False)
    return np.vstack(evaluated)[:evaluations], np.asarray(result.pop.get("F"))


def cached_nsga2(
    benchmark: Benchmark, evaluations: int, seed: int
) -> tuple[float, float, float, int]:
    """Return the results of NSGA-II, from the cache if they are there.

    Returns:
        The hypervolume of all evaluations, its standard error, the hypervolume of the last population, and the number
        of points in the front.
    """
    path = cached(f"nsga2-{surrogate_digest()}-{evaluations}-{seed}.npy")
    if not path.exists():
        evaluated, last = nsga2(benchmark, evaluations, seed)
        below = (evaluated < benchmark.problem.reference_point).all(axis=1)
        front = evaluated[below]
        front = front[is_nondominated(front)]
        value, error = any_hypervolume(benchmark, front, np.random.default_rng(seed))
        np.save(path, [value, error, benchmark.score(last), len(front)])
    value, error, last_value, points = np.load(path)
    return float(value), float(error), float(last_value), int(points)


def any_hypervolume(
    benchmark: Benchmark, front: FloatArray, rng: np.random.Generator
) -> tuple[float, float]:
    """Return the hypervolume of a front `(n, P)` and its standard error, 0 if it is exact."""
    reference = benchmark.problem.reference_point
    if len(front) <= MANY:
        return benchmark.score(front), 0.0
    ideal = front.min(axis=0)
    box = float(np.prod(reference - ideal)) / benchmark.unit
    # Large dominated volumes first, so that a dominating point is found quickly for most samples.
    order = np.argsort(-np.log(reference - front).sum(axis=1))
    samples = ideal + (reference - ideal) * rng.random((SAMPLES, len(ideal)))
    share = _dominated(front[order], samples) / SAMPLES
    return box * share, box * math.sqrt(share * (1.0 - share) / SAMPLES)


@njit(cache=True)
def _dominated(front: FloatArray, samples: FloatArray) -> int:
    """Return the number of samples that the front dominates."""
    count = 0
    for sample in samples:
        for point in front:
            worse = False
            for j in range(len(sample)):
                if point[j] > sample[j]:
                    worse = True
                    break
            if not worse:
                count += 1
                break
    return count


def random_search(benchmark: Benchmark, evaluations: int, seed: int) -> float:
    """Return the hypervolume of random set-points."""
    rng = np.random.default_rng([seed, 12345])
    x = rng.uniform(-1.0, 1.0, (evaluations, len(benchmark.problem.variables)))
    return hypervolume(benchmark.objectives(x), benchmark.problem.reference_point) / benchmark.unit


def _parsed(value: str) -> object:
    """Return the value of a JSON text, or the text itself if it is not JSON."""
    try:
        return json.loads(value)
    except ValueError:
        return value


def main() -> None:
    """Print a row per seed of NSGA-II and of each preset."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--presets", nargs="*", default=["default", "paper"], help="presets of the optimiser"
    )
    parser.add_argument("--seeds", nargs="+", type=int, default=[0, 1, 2], help="seeds")
    parser.add_argument(
        "--nsga2-evaluations", type=int, default=17_500, help="number of evaluations of NSGA-II"
    )
    parser.add_argument(
        "--cap", type=int, default=500, help="highest number of evaluations of a preset"
    )
    parser.add_argument(
        "--set", nargs="*", default=[], help="settings that override the preset, name=value"
    )
    options = parser.parse_args()

    benchmark = awa()
    print(f"hypervolume in [-1, 1]^7, of 128; surrogate {surrogate_digest()}")
    print("seed  NSGA-II  std.err.  points  last population")
    targets = []
    for seed in options.seeds:
        value, error, last, points = cached_nsga2(benchmark, options.nsga2_evaluations, seed)
        targets.append(value)
        print(f"{seed:4d}  {value:7.2f}  {error:8.2f}  {points:6d}  {last:15.2f}", flush=True)
    enough = float(np.mean(targets))
    print(f"mean  {enough:7.2f}: to be reached")

    print("preset   seed  evaluations  at 100  at 200  at the end  random  seconds an ask (median)")
    for preset in options.presets:
        for seed in options.seeds:
            settings = {
                name: _parsed(value) for name, value in (p.split("=", 1) for p in options.set)
            }
            outcome = cached_run(
                "awa", benchmark, options.cap, seed, enough=enough, preset=preset, **settings
            )
            curve = outcome.hypervolumes
            needed = first_reaching(curve, enough)
            at = [f"{curve[n - 1]:6.2f}" if n <= len(curve) else "     -" for n in (100, 200)]
            print(
                f"{preset:8s} {seed:4d}  {needed or f'> {options.cap}':>11}  {at[0]}  {at[1]}  {curve[-1]:10.2f}"
                f"  {random_search(benchmark, len(curve), seed):6.2f}  {np.median(outcome.asks):.3f}",
                flush=True,
            )


if __name__ == "__main__":
    main()
