"""What each choice of the default strategy is worth: hypervolume against evaluations with one of them taken back.

    python -m experiments.ablations [PROBLEM ...] [--choices NAME ...] [--noise 0.05] [--seeds 4] [--workers 2]
    python -m experiments.ablations --choices "d / 2 + 2 starts" "2 d + 2 starts" --seeds 8 --evaluations 36

The problems are those on which choices may be based (see `experiments.peers.problems.HELD_OUT`). Printed are, for the
strategy as it is and with each choice taken back, mean and worst seed of the hypervolume of the noiseless values as a
share of the highest of all runs on the problem, and at the end the means of all problems.
"""

from __future__ import annotations

import argparse
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from typing import Any

import numpy as np

from experiments.beliefs import output_ranges
from experiments.peers.methods import output_names
from experiments.peers.problems import EVERY, HELD_OUT
from experiments.peers.race import hypervolumes, outputs
from mobo_tuner.core import Optimizer
from mobo_tuner.core.arrays import FloatArray

PRESENT = "default"
CHOICES: dict[str, dict[str, Any]] = {
    PRESENT: {},
    "d / 2 + 2 starts": {"starts": 0.5},
    "2 d + 2 starts": {"starts": 2.0},
    "each variable by itself": {"kernel": "matern52"},
    "smooth kernel": {"kernel": "rbf"},
    "mean of the data": {"mean": "data"},
    "mean at the reference": {"mean": "reference"},
    "no exploration": {"exploration": 0.0},
    "no logarithms": {"transform": "none"},
    "UCB-HVI": {"acquisition": "ucb_hvi"},
}
"""Settings of the optimiser; `starts` are those of the initial design per variable, beside two."""
SHOWN = (12, 20, 30, 36, 40, 60)  # evaluations
PROBLEMS = [
    *(
        "toy",
        "dtlz2_3",
        "kursawe",
        "dtlz7",
        "bnh",
        "srn",
        "tnk",
        "osy",
        "truss",
        "i_beam",
        "cantilever",
    ),
    *(
        "awa_2",
        "awa_3",
        "awa_7",
        "well_3_3",
        "well_4_2",
        "tails_2_2",
        "tails_5_2",
        "cliff_2_2",
        "cliff_4_3",
    ),
    *("steep_2_2", "steep_4_2", "ledge_2_2", "slender_4_2", "needle_3_2", "needle_4_2"),
]


def curve(name: str, choice: str, seed: int, noise: float, evaluations: int) -> FloatArray:
    """Return the hypervolume of the noiseless values after each evaluation `(n,)`.

    Args:
        name: Name of the problem.
        choice: Name in `CHOICES`.
        seed: Seed of the optimiser and of the noise.
        noise: Standard deviation of the noise, as a share of each output's range.
        evaluations: Number of evaluations n.
    """
    benchmark = EVERY[name]()
    problem, names = benchmark.problem, output_names(benchmark)
    ranges = output_ranges(benchmark)
    sigma = noise * np.array([ranges[output] for output in names])
    rng = np.random.default_rng([seed, 77])
    settings = dict(CHOICES[choice])
    if starts := settings.pop("starts", None):
        settings["initial_evaluations"] = int(starts * len(problem.variables)) + 2
    optimizer = Optimizer(problem, seed=seed, **settings)
    truth = []
    for _ in range(evaluations):
        setpoint = optimizer.ask()
        truth.append(outputs(benchmark, problem.normalize(setpoint)[None])[0])
        read = truth[-1] + sigma * rng.standard_normal(len(names))
        optimizer.tell(setpoint, dict(zip(names, map(float, read), strict=True)))
    return hypervolumes(benchmark, np.array(truth))


def main() -> None:
    """Compare the choices on the chosen problems."""
    parser = argparse.ArgumentParser(
        prog="python -m experiments.ablations",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    allowed = [name for name in EVERY if name not in HELD_OUT]
    parser.add_argument("problems", nargs="*", default=PROBLEMS, metavar="PROBLEM")
    parser.add_argument("--choices", nargs="+", choices=list(CHOICES), default=list(CHOICES))
    parser.add_argument("--noise", type=float, default=0.0, help="share of each output's range")
    parser.add_argument("--seeds", type=int, default=4)
    parser.add_argument("--evaluations", type=int, default=40)
    parser.add_argument("--workers", type=int, default=1)
    options = parser.parse_args()
    if unknown := [name for name in options.problems if name not in allowed]:
        parser.error(f"problem {unknown[0]!r}: allowed are {', '.join(allowed)}")
    choices = list(dict.fromkeys([PRESENT, *options.choices]))
    shown = [n for n in SHOWN if n <= options.evaluations]
    means: dict[str, list[FloatArray]] = {choice: [] for choice in choices}
    with ProcessPoolExecutor(options.workers, get_context("spawn")) as executor:
        running = {
            name: {
                choice: [
                    executor.submit(curve, name, choice, seed, options.noise, options.evaluations)
                    for seed in range(options.seeds)
                ]
                for choice in choices
            }
            for name in options.problems
        }
        for name, runs in running.items():
            curves = {
                choice: np.array([run.result() for run in started])
                for choice, started in runs.items()
            }
            highest = max(float(found.max()) for found in curves.values()) or 1.0
            for choice, found in curves.items():
                shares = found[:, np.array(shown) - 1] / highest
                means[choice].append(shares.mean(axis=0))
                columns = zip(shown, shares.mean(axis=0), shares.min(axis=0), strict=True)
                line = "   ".join(f"{n}: {mean:.3f}, {worst:.3f}" for n, mean, worst in columns)
                print(f"{name:12s} {choice:24s}  {line}", flush=True)
    for choice, found_means in means.items():
        pairs = zip(shown, np.mean(found_means, axis=0), strict=True)
        line = "   ".join(f"{n}: {mean:.3f}" for n, mean in pairs)
        print(f"{'all':12s} {choice:24s}  {line}")


if __name__ == "__main__":
    main()
