"""What a model of the machine that is known before saves, and what a wrong one costs.

    python -m experiments.priors [--seeds 3] [--evaluations 60] [--priors none 35 30 hostile]

The machine is the surrogate of the injector at 40 nC, without noise, with six variables and seven objectives. The
models are the same surrogate at 35 nC and at 30 nC, and at 40 nC with its outputs given in another order, which is as
wrong as a model can be. Printed: hypervolumes, the evaluations that a run needs for the median hypervolume of the
runs without a model at the end, and the time of a suggestion. What is in the output file already is not computed again.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from awa_sim_node.surrogate import Surrogate
from experiments.problems import awa, first_reaching, run
from experiments.run_cache import core_digest
from mobo_tuner.core.problem import Array

PRIORS = ("none", "35", "30", "hostile")
MACHINE = 40.0  # charge [nC]
SHOWN = (10, 20, 30, 40, 60)
_TURN = 3  # places by which the hostile model's outputs are moved
_PATIENCE = 1.5  # evaluations of a run in units of those that it is compared by


@dataclass(frozen=True)
class Beam:
    """The surrogate of the injector at a charge.

    Attributes:
        outputs: Names of what it predicts.
        surrogate: Surrogate.
        charge: Charge [nC].
        turned: Places by which the outputs are moved.
    """

    outputs: tuple[str, ...]
    surrogate: Surrogate
    charge: float
    turned: int = 0

    def predict(self, columns: Mapping[str, Array]) -> Array:
        """Return the outputs ``(n, Q)``."""
        predicted = self.surrogate.predict({**columns, "charge": self.charge})
        values = np.column_stack([predicted[name] for name in self.outputs])
        return np.roll(values, self.turned, axis=1)


def model_of(prior: str) -> Beam | None:
    """Return the model of a name in `PRIORS`."""
    if prior == "none":
        return None
    names = awa().problem.objective_names
    hostile = prior == "hostile"
    charge = MACHINE if hostile else float(prior)
    return Beam(names, Surrogate.load(), charge, _TURN if hostile else 0)


def play(prior: str, seed: int, evaluations: int, initial: int) -> dict[str, list[float]]:
    """Return the hypervolume after each evaluation and the time of each suggestion [s]."""
    played = run(awa(), evaluations, seed, prior_means=model_of(prior), initial_evaluations=initial)
    return {
        "hypervolumes": [round(float(h), 3) for h in played.hypervolumes],
        "seconds": [round(float(s), 4) for s in played.asks],
        "cpu": [round(float(s), 4) for s in played.cpu],
    }


def main() -> None:
    """Compute what is missing and print a row for each prior."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--priors", nargs="+", choices=PRIORS, default=list(PRIORS))
    parser.add_argument("--evaluations", type=int, default=60)
    parser.add_argument("--initial", type=int, default=0, help="points of the initial design")
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--output", type=Path, default=Path("experiments/.cache/priors.json"))
    options = parser.parse_args()
    known = json.loads(options.output.read_text()) if options.output.exists() else {}
    runs: dict[str, list[dict[str, list[float]]]] = {}
    for seed in range(options.seeds):
        for prior in options.priors:
            length = options.evaluations
            if prior == "hostile":
                length = round(_PATIENCE * length)
            key = f"{core_digest()} {prior} {seed} {length} {options.initial}"
            if key not in known:
                known[key] = play(prior, seed, length, options.initial)
                options.output.parent.mkdir(exist_ok=True)
                options.output.write_text(json.dumps(known))
            runs.setdefault(prior, []).append(known[key])
    enough = None
    if "none" in runs:
        enough = float(np.median([r["hypervolumes"][-1] for r in runs["none"]]))
        print(f"hypervolume to reach: {enough:.1f}")
    print("prior    " + "".join(f"{n:>7d}" for n in SHOWN) + "   needed, median suggestion [s]")
    for prior, played in runs.items():
        curves = np.array([r["hypervolumes"] for r in played])
        means = [f"{curves[:, n - 1].mean():7.1f}" for n in SHOWN if n <= curves.shape[1]]
        needed = [first_reaching(curve, enough) for curve in curves] if enough else []
        late = [t for r in played for t in r["seconds"][options.evaluations // 2 :]]
        print(f"{prior:8s} {''.join(means)}   {needed}, {np.median(late):.3f}", flush=True)


if __name__ == "__main__":
    main()
