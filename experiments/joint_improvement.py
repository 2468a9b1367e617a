"""What the Kriging believer's batches lack: the expected hypervolume improvement of a whole batch, by Monte Carlo.

    python -m experiments.joint_improvement [--problems toy dtlz2_3 awa] [--sizes 4 8] [--seeds 3]

After a number of evaluations without noise, `Optimizer.ask(q)` chooses a batch as if each of its set-points had read
what the models predict. A second batch is chosen greedily by the joint improvement itself (qEHVI): the next set-point
is the one that raises the mean improvement of the batch most, over draws of the joint posterior at all candidates.
These are the believer's batch, points around it, around the front and all over the box, and then points around the
batch that was found. Both are judged by the same further draws. Printed: joint expected improvement of the believer's
batch over that of the greedy one, with the standard error of the draws, and the CPU time of both choices [s].
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable

import numpy as np
from scipy.stats import qmc

from experiments.problems import Benchmark, awa, dtlz2, run, toy
from mobo_tuner.core import Optimizer
from mobo_tuner.core.arrays import FloatArray
from mobo_tuner.core.hypervolume import BoxDecomposition

PROBLEMS: dict[str, Callable[[], Benchmark]] = {"toy": toy, "dtlz2_3": dtlz2, "awa": awa}
_CHOOSING, _JUDGING = 64, 1024  # draws
_EVERYWHERE, _AROUND = 256, 48  # candidates


def draws(optimizer: Optimizer, x: FloatArray, count: int, seed: int) -> FloatArray:
    """Return draws `(s, m, P)` of the joint posterior of the objectives at x `(m, d)`."""
    rng = np.random.default_rng([seed, count])
    models = optimizer.archive.extended_models.objectives
    return np.stack(
        [model.sample(x, rng.standard_normal((count, len(x)))) for model in models], axis=2
    )


def boxes(optimizer: Optimizer) -> BoxDecomposition:
    """Return the region that the front does not dominate."""
    front = optimizer.archive.belief
    return BoxDecomposition(optimizer.problem.reference_point, front.objectives[front.feasible])


def joint_improvement(optimizer: Optimizer, batch: FloatArray, seed: int) -> FloatArray:
    """Return the improvement by a batch `(q, d)` in each of many draws `(s,)`."""
    before = boxes(optimizer)
    gains = []
    for drawn in draws(optimizer, batch, _JUDGING, seed):
        useful = drawn[before.improvement(drawn) > 0.0]
        gains.append(sum(_added(optimizer, useful)))
    return np.array(gains)


def _added(optimizer: Optimizer, points: FloatArray) -> list[float]:
    """Return what each of some points `(k, P)` adds to the front and those before it."""
    if not len(points):
        return []
    grown = boxes(optimizer)
    return [grown.add(point) for point in points]


def greedy(optimizer: Optimizer, believed: FloatArray, seed: int) -> FloatArray:
    """Return a batch `(q, d)` that is chosen by its joint improvement."""
    rng = np.random.default_rng([seed, 1])
    d = believed.shape[1]
    spread = 2.0 * qmc.Sobol(d, seed=rng).random(_EVERYWHERE) - 1.0
    front = optimizer.dataset.inputs[optimizer.archive.belief.front_rows()]
    batch = believed
    for width in (0.2, 0.05):
        near = [
            origin + width * rng.standard_normal((_AROUND, d))
            for origin in (*batch, *rng.permutation(front)[: len(batch)])
        ]
        candidates = np.clip(np.vstack([batch, believed, spread, *near]), -1.0, 1.0)
        batch = _greedy_of(optimizer, np.unique(candidates, axis=0), len(believed), seed)
    return batch


def _greedy_of(optimizer: Optimizer, candidates: FloatArray, size: int, seed: int) -> FloatArray:
    """Return the greedy batch of some candidates `(m, d)`."""
    drawn = draws(optimizer, candidates, _CHOOSING, seed)
    grown = [boxes(optimizer) for _ in drawn]
    chosen: list[int] = []
    for _ in range(size):
        gains = np.mean([b.improvement(y) for b, y in zip(grown, drawn, strict=True)], axis=0)
        gains[chosen] = -np.inf
        chosen.append(int(gains.argmax()))
        for b, y in zip(grown, drawn, strict=True):
            b.add(y[chosen[-1]])
    return candidates[chosen]


def main() -> None:
    """Print a row for each problem, number of evaluations and size."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--problems", nargs="+", choices=PROBLEMS, default=list(PROBLEMS))
    parser.add_argument("--evaluations", type=int, nargs="+", default=[20, 40])
    parser.add_argument("--sizes", type=int, nargs="+", default=[4, 8])
    parser.add_argument("--seeds", type=int, default=3)
    options = parser.parse_args()
    print("problem   n  q  seed  believer/greedy  error   seconds: believer, greedy")
    for name in options.problems:
        benchmark = PROBLEMS[name]()
        for seed in range(options.seeds):
            for n in options.evaluations:
                optimizer = run(benchmark, n, seed).optimizer
                for size in options.sizes:
                    begin = time.process_time()
                    asked = optimizer.ask(size)
                    believed = np.array([benchmark.problem.normalize(p) for p in asked])
                    for point in asked:
                        optimizer.cancel(point)
                    between = time.process_time()
                    other = greedy(optimizer, believed, seed)
                    end = time.process_time()
                    mine, best = (joint_improvement(optimizer, b, seed) for b in (believed, other))
                    ratio = mine.mean() / best.mean()
                    error = np.std(mine - ratio * best) / np.sqrt(len(mine)) / best.mean()
                    print(
                        f"{name:8s} {n:3d} {size:2d} {seed:5d} {ratio:16.3f} {error:6.3f} "
                        f"{between - begin:10.2f} {end - between:6.2f}",
                        flush=True,
                    )


if __name__ == "__main__":
    main()
