"""The optimiser in the loops of optimas and Xopt, on the first problem of Zitzler, Deb and Thiele.

    python -m experiments.other_loops optimas|xopt [--evaluations 24]

needs optimas 0.10.1 or Xopt 3.2.2 in the environment, beside what the optimiser needs. It prints how many
evaluations were learned, and the hypervolume, of which 2/3 can be had.
"""

from __future__ import annotations

import argparse
import math
import tempfile
from typing import Any

from gest_api.vocs import VOCS

from mobo_tuner.core import Optimizer
from mobo_tuner.offline import MoboGenerator


def problem() -> VOCS:
    """Return the problem with two variables."""
    return VOCS(
        variables={"x": [0.0, 1.0], "y": [0.0, 1.0]}, objectives={"f": "MINIMIZE", "g": "MINIMIZE"}
    )


def objectives(point: Any) -> dict[str, float]:
    """Return both objectives of a point."""
    h = 1.0 + 9.0 * point["y"]
    return {"f": float(point["x"]), "g": float(h * (1.0 - math.sqrt(point["x"] / h)))}


def by_optimas(generator: MoboGenerator, evaluations: int) -> Optimizer:
    """Let optimas run it with three workers, which do not wait for each other."""
    from optimas.evaluators import FunctionEvaluator
    from optimas.explorations import Exploration
    from optimas.generators import ExternalGenerator

    def evaluate(inputs: Any, outputs: Any) -> None:
        for name, value in objectives(inputs).items():
            outputs[name] = value

    with tempfile.TemporaryDirectory() as folder:
        Exploration(
            generator=ExternalGenerator(ext_gen=generator, vocs=generator.vocs),
            evaluator=FunctionEvaluator(function=evaluate),
            max_evals=evaluations,
            sim_workers=3,
            run_async=True,
            exploration_dir_path=folder,
        ).run()
    return generator.optimizer


def by_xopt(generator: MoboGenerator, evaluations: int) -> Optimizer:
    """Let Xopt run it, after three random points of its own."""
    from xopt import Evaluator, Xopt

    loop = Xopt(generator=generator, evaluator=Evaluator(function=objectives))
    loop.random_evaluate(3)
    while len(loop.data) < evaluations:
        loop.step()
    optimizer: Optimizer = loop.generator.optimizer  # of a copy, which it has made
    return optimizer


def main() -> None:
    """Run one of the loops."""
    parser = argparse.ArgumentParser(prog="python -m experiments.other_loops")
    parser.add_argument("loop", choices=("optimas", "xopt"))
    parser.add_argument("--evaluations", type=int, default=24)
    options = parser.parse_args()
    generator = MoboGenerator(problem(), references={"f": 1.0, "g": 1.0}, seed=1)
    run = by_optimas if options.loop == "optimas" else by_xopt
    optimizer = run(generator, options.evaluations)
    print(f"{len(optimizer.dataset)} evaluations, hypervolume {optimizer.hypervolume:.4f}")


if __name__ == "__main__":
    main()
