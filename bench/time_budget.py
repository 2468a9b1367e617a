"""Time of suggestions under a time budget, and of the first one after an import of many evaluations.

Evaluations at random set-points of four variables are told; then the first suggestion, trainings included, and some
more are timed, with each budget and without any.

    python -m bench.time_budget --evaluations 20 100 500 2000 3000 --budgets 0.1 0.5
"""

from __future__ import annotations

import argparse
import time

import numpy as np

from mobo_tuner.core import Optimizer, Problem

VARIABLES = 4


def measure(
    evaluations: int, objectives: int, budget: float | None, asks: int
) -> tuple[float, list[float]]:
    """Return the time to tell all evaluations and that of each suggestion [s]."""
    names = [f"x{k}" for k in range(VARIABLES)]
    problem = Problem.from_dict(
        {
            "variables": {name: {"min": -1.0, "max": 1.0} for name in names},
            "objectives": {f"f{j}": {"reference": 3.0} for j in range(objectives)},
        }
    )
    rng = np.random.default_rng(0)
    centres = rng.uniform(-1.0, 1.0, (objectives, VARIABLES))
    optimizer = Optimizer(problem, suggestion_seconds=budget)

    def tell(x: np.ndarray) -> None:
        distances = np.linalg.norm(centres - x, axis=1).tolist()
        outputs = {f"f{j}": value for j, value in enumerate(distances)}
        optimizer.tell(dict(zip(names, x.tolist(), strict=True)), outputs)

    begin = time.perf_counter()
    for x in rng.uniform(-1.0, 1.0, (evaluations, VARIABLES)):
        tell(x)
    told = time.perf_counter() - begin
    seconds = []
    for _ in range(asks):
        begin = time.perf_counter()
        setpoint = optimizer.ask()
        seconds.append(time.perf_counter() - begin)
        tell(np.array(list(setpoint.values())))
    return told, seconds


def main() -> None:
    """Print a row for each number of evaluations and each budget."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--evaluations", nargs="+", type=int, default=[20, 100, 300, 500, 2000])
    parser.add_argument("--budgets", nargs="+", type=float, default=[0.1, 0.5])
    parser.add_argument("--objectives", type=int, default=7)
    parser.add_argument("--asks", type=int, default=6, help="timed suggestions in a row")
    options = parser.parse_args()

    measure(20, options.objectives, None, 2)  # compiles
    print("told  budget  to tell all  first suggestion  median  longest of the others [s]")
    for evaluations in options.evaluations:
        for budget in (*options.budgets, None):
            told, seconds = measure(evaluations, options.objectives, budget, options.asks)
            label = "none" if budget is None else f"{budget:g}"
            others = seconds[1:] or [np.nan]
            print(
                f"{evaluations:4d}  {label:>6s}  {told:11.2f}  {seconds[0]:16.2f}  "
                f"{np.median(others):6.2f}  {max(others):6.2f}",
                flush=True,
            )


if __name__ == "__main__":
    main()
