"""Number of failed evaluations on the toy problem if half of the input space fails.

Every run starts from 5 random points and makes 25 suggestions.

    python -m experiments.failures --seeds 10
"""

from __future__ import annotations

import argparse

import numpy as np

from experiments.paper.toy import INITIAL, START
from experiments.problems import run, toy

SUGGESTIONS = 25


def main() -> None:
    """Print the number of failed suggestions of every run."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--preset", default="default", help="preset of the optimiser")
    parser.add_argument("--seeds", type=int, default=10, help="number of seeds")
    options = parser.parse_args()
    failing, counts = toy(failing=True), []
    for seed in range(options.seeds):
        outcome = run(failing, INITIAL + SUGGESTIONS, seed, preset=options.preset, **START)
        counts.append(int((~outcome.optimizer.dataset.valid[INITIAL:]).sum()))
    print(
        f"x1 > 0 fails: failures among {SUGGESTIONS} suggestions, {options.seeds} seeds: "
        f"median {np.median(counts):g}, all {counts}"
    )


if __name__ == "__main__":
    main()
