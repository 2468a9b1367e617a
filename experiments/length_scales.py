"""Predictive density of models with few evaluations, for priors of the length-scales and prior means.

For each problem and number of evaluations, models of all objectives are trained on random set-points and evaluated at
200 others. Printed is the mean log density of the true values there, per objective and point, each objective in units
of its standard deviation. Higher is better; differences of 0.1 matter. The locations are those of the prior, in units
of the root of the number of variables; its standard deviation is the default.

    python -m experiments.length_scales --problems toy dtlz2 awa linear20
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence

import numpy as np

from experiments.problems import awa, dtlz2, toy
from mobo_tuner.core import kernels
from mobo_tuner.core.arrays import FloatArray
from mobo_tuner.core.gaussian_process import GaussianProcess, GaussianProcessSettings

Function = Callable[[FloatArray], FloatArray]
POINTS = 200
LEAST_STDDEV = 1e-3  # resolution of a measurement, in standard deviations of the objective


def distances(x: FloatArray) -> FloatArray:
    """Return the distances of `(n, d)` to two points on the diagonal, `(n, 2)`; all variables matter."""
    return np.stack([np.linalg.norm(x - c, axis=1) for c in (0.5, -0.5)], axis=1)


def few_of_many(x: FloatArray) -> FloatArray:
    """Return waves in three of the variables `(n, d)`, `(n, 2)`; the others do not matter."""
    return np.stack(
        [np.sin(x[:, :3] @ [3.0, 1.0, 0.5]), np.cos(x[:, :3] @ [0.5, -2.0, 1.0])], axis=1
    )


def _surrogate() -> tuple[int, Function]:
    return 6, awa().objectives


PROBLEMS: dict[str, Callable[[], tuple[int, Function]]] = {
    "toy": lambda: (2, toy().objectives),
    "dtlz2": lambda: (6, dtlz2().objectives),
    "awa": _surrogate,
    "distances20": lambda: (20, distances),
    "few_of_20": lambda: (20, few_of_many),
}


def log_density(function: Function, d: int, n: int, mean: str, seed: int) -> float:
    """Return the mean log density of other points under models of n random points."""
    rng = np.random.default_rng([seed, n])
    x = rng.uniform(-1.0, 1.0, (n + POINTS, d))
    y = function(x)
    spread = y.std(axis=0)
    settings = GaussianProcessSettings(mean=mean)
    densities = []
    for values, unit in zip(y.T, spread, strict=True):
        # A typical reference point: the worst value so far.
        model = GaussianProcess(settings, reference=float(values.max()))
        model.fit(x[:n], values[:n], rng=np.random.default_rng(seed))
        predicted, stddev = model.predict(x[n:])
        variance = (stddev / unit) ** 2 + LEAST_STDDEV**2
        excess = (values[n:] - predicted) / unit
        densities.append(-0.5 * (np.log(2.0 * np.pi * variance) + excess**2 / variance).mean())
    return float(np.mean(densities))


def row(
    function: Function, d: int, n: int, mean: str, locations: Sequence[float], seeds: int
) -> str:
    """Return the mean log density for each location, and the standard error of their differences."""
    found = np.empty((seeds, len(locations)))
    for j, location in enumerate(locations):
        logarithm = float(np.log(location) + 0.5 * np.log(d))
        kernels.typical_log_length_scale = lambda _, value=logarithm: value  # type: ignore[misc]
        found[:, j] = [log_density(function, d, n, mean, seed) for seed in range(seeds)]
    # The residual without the means of seeds and locations is the spread of the differences.
    left = found - found.mean(axis=1, keepdims=True) - found.mean(axis=0) + found.mean()
    error = left.std() * np.sqrt(2.0 / max(seeds - 1, 1))
    return " ".join(f"{value:8.3f}" for value in found.mean(axis=0)) + f"   +- {error:.3f}"


def main() -> None:
    """Print a row per problem, number of evaluations and prior mean."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--problems",
        nargs="+",
        choices=list(PROBLEMS),
        default=list(PROBLEMS),
        help="test problems",
    )
    parser.add_argument(
        "--evaluations", nargs="+", type=int, default=[8, 16, 32], help="numbers of evaluations"
    )
    parser.add_argument(
        "--locations",
        nargs="+",
        type=float,
        default=[0.5, 1.0, 1.4, 2.0, 4.0],
        help="locations of the prior",
    )
    parser.add_argument(
        "--means", nargs="+", default=["auto"], help="prior means: auto, data, reference"
    )
    parser.add_argument("--seeds", type=int, default=10, help="number of seeds")
    options = parser.parse_args()
    print(
        "problem        n  mean       "
        + " ".join(f"{location:8g}" for location in options.locations)
    )
    for name in options.problems:
        d, function = PROBLEMS[name]()
        for n in options.evaluations:
            for mean in options.means:
                line = row(function, d, n, mean, options.locations, options.seeds)
                print(f"{name:12s} {n:3d}  {mean:9s} {line}", flush=True)


if __name__ == "__main__":
    main()
