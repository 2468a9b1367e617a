"""Step length and hypervolume with and without proximal biasing, on the toy problem and on the AWA surrogate.

Runs on the toy problem start from 5 random points, runs on the AWA surrogate from the preset's initial design; both
runs of a seed start from the same points. The step length is the Euclidean distance between consecutive suggested
set-points, with a range of 2 for every variable. All runs are kept in experiments/.cache, also unfinished ones: an
interrupted benchmark continues where it stopped.

    python -m experiments.proximal --problems toy awa
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from typing import Any

import numpy as np

from experiments.problems import Benchmark, Run, awa, toy
from experiments.run_cache import cached_run
from experiments.toy import START

PROBLEMS: dict[str, tuple[Callable[[], Benchmark], dict[str, Any]]] = {
    "toy": (toy, START),
    "awa": (awa, {}),
}


def mean_step(outcome: Run) -> float:
    """Return the mean length of the steps between suggested set-points."""
    inputs = outcome.optimizer.dataset.inputs[: len(outcome.hypervolumes)]
    first = outcome.optimizer.initial_evaluations - 1
    return float(np.linalg.norm(np.diff(inputs[first:], axis=0), axis=1).mean())


def compare(name: str, options: argparse.Namespace) -> None:
    """Print a line per seed and the ratios of the means."""
    make, settings = PROBLEMS[name]
    benchmark, n = make(), options.evaluations
    print(f"{name}, precision {options.precision:g}, {n} evaluations, preset {options.preset}")
    print("seed  step without, with  ratio  hypervolume without, with  ratio")
    lengths, volumes = [], []
    for seed in range(options.seeds):
        pair = [
            cached_run(
                name, benchmark, n, seed, preset=options.preset, **settings, proximal=precision
            )
            for precision in (None, options.precision)
        ]
        lengths.append([mean_step(outcome) for outcome in pair])
        volumes.append([outcome.hypervolumes[-1] for outcome in pair])
        print(_line(f"{seed:4d}", lengths[-1], volumes[-1]), flush=True)
    print(_line("mean", np.mean(lengths, axis=0), np.mean(volumes, axis=0)))


def _line(label: str, step: list[float], volume: list[float]) -> str:
    return (
        f"{label}      {step[0]:.3f}   {step[1]:.3f}  {step[1] / step[0]:.3f}"
        f"         {volume[0]:8.4f} {volume[1]:8.4f}  {volume[1] / volume[0]:.4f}"
    )


def main() -> None:
    """Compare on every selected problem."""
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
        "--precision", type=float, default=4.0, help="precision in normalised variables"
    )
    parser.add_argument("--seeds", type=int, default=10, help="number of seeds")
    parser.add_argument(
        "--evaluations", type=int, default=300, help="number of evaluations of a run"
    )
    parser.add_argument("--preset", default="default", help="preset of the optimiser")
    options = parser.parse_args()
    for name in options.problems:
        compare(name, options)


if __name__ == "__main__":
    main()
