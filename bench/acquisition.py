"""Time and memory of the hypervolume engine: improvement and its expectation, with gradients.

Prints one row per front: number of boxes, memory, time to build, time to add a point, time per
candidate. With `--compile`, also the time from import to the first results in a new process, with
an empty and with a filled cache of compiled code.

    python -m bench.acquisition --objectives 7 --points 500
"""

from __future__ import annotations

import argparse
import os
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable

import numpy as np

from mobo_tuner.core.arrays import FloatArray
from mobo_tuner.core.hypervolume import BoxDecomposition
from mobo_tuner.core.pareto import is_nondominated

FIRST_ANSWERS = """
import numpy as np
from mobo_tuner.core.hypervolume import BoxDecomposition
front = BoxDecomposition(np.ones(3), [[0.5, 0.5, 0.5]])
front.expected_improvement_with_gradient([[0.4, 0.4, 0.4]], [[0.1, 0.1, 0.1]])
front.expected_improvement([[0.4, 0.4, 0.4]], [[0.1, 0.1, 0.1]])
"""


def on_sphere(rng: np.random.Generator, n: int, n_objectives: int) -> FloatArray:
    """Return random points of the unit sphere with no negative component, `(n, P)`."""
    points = np.abs(rng.standard_normal((n, n_objectives)))
    points /= np.linalg.norm(points, axis=1, keepdims=True)
    return points


def concave(rng: np.random.Generator, n: int, n_objectives: int) -> FloatArray:
    """Return a slightly rough front that bulges away from the ideal point: the worst case."""
    return 2.0 * on_sphere(rng, n, n_objectives) * (1.0 + 0.05 * rng.random((n, 1))) - 1.0


def convex(rng: np.random.Generator, n: int, n_objectives: int) -> FloatArray:
    """Return a front that bulges towards the ideal point."""
    return 1.0 - 2.0 * on_sphere(rng, n, n_objectives)


def smooth(rng: np.random.Generator, n: int, n_objectives: int) -> FloatArray:
    """Return squared distances to P points of a six-dimensional box; the Pareto set is their hull."""
    centers = np.random.default_rng(1).uniform(-1.0, 1.0, (n_objectives, 6))
    inputs = rng.dirichlet(np.ones(n_objectives), n) @ centers
    distances = ((inputs[:, None, :] - centers) ** 2).sum(axis=2)
    largest = ((centers[:, None, :] - centers) ** 2).sum(axis=2).max(axis=0)
    points: FloatArray = 2.0 * distances / largest - 1.0
    return points


FRONTS = {"smooth": smooth, "convex": convex, "concave": concave}


def sample_front(name: str, n: int, n_objectives: int, seed: int) -> FloatArray:
    """Draw n mutually non-dominated points in [-1, 1]^P, all below 1."""
    rng = np.random.default_rng(seed)
    points = np.empty((0, n_objectives))
    while len(points) < n:
        drawn = FRONTS[name](rng, 2 * n, n_objectives)
        points = np.vstack([points, drawn[(drawn < 1.0).all(axis=1)]])
        points = points[is_nondominated(points)]
    return points[:n]


def shortest(function: Callable[[], object], repeats: int) -> float:
    """Return the shortest of several CPU times [s]."""
    times = []
    for _ in range(repeats):
        start = time.process_time()
        function()
        times.append(time.process_time() - start)
    return min(times)


def measure(name: str, options: argparse.Namespace) -> list[str]:
    """Return one row of the table."""
    n, n_objectives, m = options.points, options.objectives, options.candidates
    points = sample_front(name, n + m, n_objectives, options.seed)
    rng = np.random.default_rng(options.seed)
    front, others = points[:n], points[n:]
    candidates = others - 0.1 * rng.random(others.shape) * rng.random((m, 1))
    stddev = np.full_like(candidates, options.stddev)
    reference = np.ones(n_objectives)

    start = time.process_time()
    boxes = BoxDecomposition(reference, front)
    build = time.process_time() - start
    adding = BoxDecomposition(reference, front)
    times = []
    for point in candidates[:20]:
        start = time.process_time()
        adding.add(point)
        times.append(time.process_time() - start)

    functions: list[Callable[[], object]] = [
        lambda: boxes.improvement(candidates),
        lambda: boxes.improvement_with_gradient(candidates),
        lambda: boxes.expected_improvement(candidates, stddev),
        lambda: boxes.expected_improvement_with_gradient(candidates, stddev),
    ]
    each = [1e3 * shortest(function, options.repeats) / m for function in functions]
    return [
        name,
        f"{boxes.n_boxes}",
        f"{boxes.nbytes / 2**20:.1f}",
        f"{build:.2f}",
        f"{1e3 * float(np.median(times)):.2f}",
        *(f"{value:.3f}" for value in each),
    ]


def first_answers(cache: str) -> float:
    """Return the time that a new process needs to import the engine and use it once [s].

    Args:
        cache: Folder of the compiled code.
    """
    start = time.perf_counter()
    subprocess.run(
        [sys.executable, "-c", FIRST_ANSWERS],
        check=True,
        timeout=300.0,
        env=os.environ | {"NUMBA_CACHE_DIR": cache},
    )
    return time.perf_counter() - start


def main() -> None:
    """Parse the command line and print the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--objectives", type=int, default=7, help="number of objectives")
    parser.add_argument("--points", type=int, default=500, help="number of points in the front")
    parser.add_argument("--candidates", type=int, default=64, help="number of candidates per call")
    parser.add_argument(
        "--stddev", type=float, default=0.03, help="standard deviation of every prediction"
    )
    parser.add_argument(
        "--fronts",
        nargs="+",
        choices=list(FRONTS),
        default=list(FRONTS),
        help="shapes of the front",
    )
    parser.add_argument(
        "--repeats", type=int, default=5, help="number of timings, of which the shortest counts"
    )
    parser.add_argument("--seed", type=int, default=0, help="seed of the points")
    parser.add_argument("--compile", action="store_true", help="measure compilation as well")
    options = parser.parse_args()

    warm = BoxDecomposition(np.ones(2), [[0.0, 0.0]])
    warm.expected_improvement_with_gradient([[0.0, 0.0]], [[1.0, 1.0]])
    warm.expected_improvement([[0.0, 0.0]], [[1.0, 1.0]])

    print(
        f"P = {options.objectives}, n = {options.points}, stddev = {options.stddev}; "
        "CPU time per candidate [ms]"
    )
    header = ["front", "boxes", "MiB", "build s", "add ms", "HVI", "+ grad", "EHVI", "+ grad"]
    layout = "{:<8} {:>8} {:>7} {:>8} {:>7} {:>8} {:>8} {:>8} {:>8}"
    print(layout.format(*header))
    for name in options.fronts:
        print(layout.format(*measure(name, options)), flush=True)
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**10
    print(f"largest memory of the process: {peak:.0f} MiB")
    if options.compile:
        with tempfile.TemporaryDirectory() as cache:
            cold, warmed = first_answers(cache), first_answers(cache)
        print(f"import and first results: {cold:.1f} s, with a filled cache {warmed:.1f} s")


if __name__ == "__main__":
    main()
