"""What drift costs: a machine whose optimum moves, jumps or whose outputs are rescaled, against what is said of it.

    steady   does not change, which shows what the setting costs
    moving   the optimum moves by 43 % of a variable's range (30 A of K2's 70 A) from the first evaluation to the last
    jump     the same at once, after half of the evaluations
    scaled   the outputs grow by 10 % from the first evaluation to the last

Printed at the last evaluation, as mean and least or greatest of the seeds: the hypervolume that is reported over the
true one of the reported front now; the share of promised objectives within two standard deviations of the true values
now; the true hypervolume of the reported front over that of a fresh run of 50 evaluations of the machine as it is now;
CPU time. Finished runs are kept in experiments/.cache and belong to the sources of the core; `--json` writes the rows.

    python -m experiments.drift --problems toy beam --kinds moving jump scaled --settings none auto on
"""

from __future__ import annotations

import argparse
import hashlib
import json
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from experiments.beliefs import BENCHMARKS, output_ranges, true_hypervolume
from experiments.problems import Benchmark, cached
from experiments.run_cache import core_digest
from mobo_tuner.core import Optimizer
from mobo_tuner.core.arrays import FloatArray

KINDS = ("steady", "moving", "jump", "scaled")
FRESH = 50
_TRAVEL = 2.0 * 30.0 / 70.0  # of a normalised variable, which spans 2
_GROWTH = 0.1

MOVED = {"toy": "x1", "valley": "a", "dtlz2": "x1", "beam": "K2"}
"""Variable whose optimum moves, by the name of the benchmark."""


@dataclass(frozen=True)
class Outcome:
    """What a run came to.

    Attributes:
        reported: Hypervolume that the optimiser reports.
        true: Hypervolume of the true values now at the reported front.
        fresh: The same of a fresh run of the machine as it is now.
        covered: Share of promised objectives within two standard deviations of the true values now.
        seconds: CPU time of all suggestions and of what was learned [s].
    """

    reported: float
    true: float
    fresh: float
    covered: float
    seconds: float


def at(benchmark: Benchmark, name: str, kind: str, share: float) -> Benchmark:
    """Return the machine as it is after a share of the evaluations, from 0 to 1."""
    variable = benchmark.problem.variable_names.index(MOVED[name])
    shift = np.zeros(len(benchmark.problem.variables))
    if kind in ("moving", "jump"):
        shift[variable] = _TRAVEL * ((share if kind == "moving" else float(share >= 0.5)) - 0.5)
    scale = 1.0 + _GROWTH * share if kind == "scaled" else 1.0

    def objectives(x: FloatArray) -> FloatArray:
        return scale * benchmark.objectives(x - shift)

    return Benchmark(benchmark.problem, objectives, benchmark.unit)


def play(
    name: str, kind: str, setting: str, noise: float, seed: int, evaluations: int
) -> tuple[Optimizer, float]:
    """Return the optimiser at the end of a run, and its CPU time [s].

    Args:
        name: Benchmark.
        kind: How the machine changes; `fresh KIND` for the machine as it is at the end of that.
        setting: Setting `drift` of the optimiser.
        noise: Standard deviation of a reading, as a share of the output's range.
        seed: Seed of optimiser and noise.
        evaluations: Number of evaluations.
    """
    benchmark = BENCHMARKS[name]()
    stddevs = {n: noise * r for n, r in output_ranges(benchmark).items()} if noise else {}
    rng = np.random.default_rng([seed, 13])
    optimizer = Optimizer(benchmark.problem, seed=seed, drift=setting)
    begin = time.process_time()
    for i in range(evaluations):
        share = 1.0 if kind.startswith("fresh") else i / (evaluations - 1)
        setpoint = optimizer.ask()
        outputs = at(benchmark, name, kind.removeprefix("fresh "), share).measure(setpoint)
        optimizer.tell(
            setpoint, {n: v + stddevs.get(n, 0.0) * rng.normal() for n, v in outputs.items()}
        )
    return optimizer, time.process_time() - begin


def outcome(
    name: str, kind: str, setting: str, noise: float, seed: int, evaluations: int
) -> Outcome:
    """Return what a run came to, from the cache where it was played before."""
    belongs = [name, kind, setting, noise, seed, evaluations, core_digest()]
    digest = hashlib.sha256(json.dumps(belongs).encode()).hexdigest()[:12]
    path = cached(f"drift-{name}-{digest}.json")
    if path.exists():
        return Outcome(**json.loads(path.read_text(encoding="utf-8")))
    now = at(BENCHMARKS[name](), name, kind, 1.0)
    optimizer, seconds = play(name, kind, setting, noise, seed, evaluations)
    front = optimizer.pareto_front(probability=False)
    rows = [point["index"] for point in front]
    inputs = optimizer.dataset.inputs[rows]
    names = now.problem.objective_names
    promised = np.array([[p["objectives"][n] for n in names] for p in front])
    stddevs = np.array([[p["stddevs"][n] for n in names] for p in front])
    off = np.abs(promised - now.objectives(inputs)) if rows else np.empty((0, len(names)))
    # A reading without a standard deviation promises all its digits.
    within = off <= 2.0 * stddevs + 1e-6 * np.abs(promised) if rows else np.empty(0)
    found = Outcome(
        float(optimizer.hypervolume),
        true_hypervolume(now, inputs),
        _fresh(name, kind, noise, seed),
        float(np.mean(within)) if rows else float("nan"),
        seconds,
    )
    path.write_text(json.dumps(vars(found)), encoding="utf-8")
    return found


def _fresh(name: str, kind: str, noise: float, seed: int) -> float:
    """Return the true hypervolume of a fresh run's front."""
    belongs = [name, kind, noise, seed, FRESH, core_digest()]
    digest = hashlib.sha256(json.dumps(belongs).encode()).hexdigest()[:12]
    path = cached(f"drift-fresh-{name}-{digest}.json")
    if not path.exists():
        optimizer, _ = play(name, f"fresh {kind}", "none", noise, seed, FRESH)
        rows = [p["index"] for p in optimizer.pareto_front(probability=False)]
        now = at(BENCHMARKS[name](), name, kind, 1.0)
        true = true_hypervolume(now, optimizer.dataset.inputs[rows])
        path.write_text(json.dumps(true), encoding="utf-8")
    return float(json.loads(path.read_text(encoding="utf-8")))


def main() -> None:
    """Print a row for each problem, kind and setting."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--problems", nargs="+", choices=list(MOVED), default=["toy", "beam"])
    parser.add_argument("--kinds", nargs="+", choices=KINDS, default=list(KINDS))
    parser.add_argument("--settings", nargs="+", default=["none", "auto", "on"])
    parser.add_argument("--evaluations", type=int, default=200)
    parser.add_argument("--noise", type=float, default=0.0)
    parser.add_argument("--seeds", type=int, default=4)
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    rows = []
    print("problem kind     drift  reported/true-1 (mean, most)  covered  true/fresh (mean, least)")
    for name in options.problems:
        for kind in options.kinds:
            for setting in options.settings:
                arguments = (name, kind, setting, options.noise)
                runs = [outcome(*arguments, s, options.evaluations) for s in range(options.seeds)]
                errors = np.array([r.reported / r.true - 1.0 if r.true else np.inf for r in runs])
                ratios = np.array([r.true / r.fresh for r in runs])
                seconds = float(np.mean([r.seconds for r in runs]))
                print(
                    f"{name:7s} {kind:8s} {setting:5s}  {np.mean(np.abs(errors)):.3f} "
                    f"{np.abs(errors).max():.3f}   {np.mean([r.covered for r in runs]):.3f}   "
                    f"{ratios.mean():.3f} {ratios.min():.3f}   {seconds:.0f} s",
                    flush=True,
                )
                rows.append(
                    {"problem": name, "kind": kind, "drift": setting, "noise": options.noise}
                    | {"runs": [vars(r) for r in runs]}
                )
    if options.json:
        options.json.write_text(json.dumps(rows), encoding="utf-8")


if __name__ == "__main__":
    main()
