"""What incomplete, noisy and wrong data cost: each part plays a fault of a machine and prints figures against targets.

    partly   2/3 of the outputs are measured each time, against two thirds as many whole evaluations
    chance   evaluations fail by chance, against the same run without the failed ones
    wild     one reading in 60 is wrong by 1, 10 or 1e6 times the output's range, against none
    noise    every reading has noise of 2, 5 or 10 % of the output's range, its size told or not

The true hypervolume is that of the noiseless values at the set-points of the reported front; the reported one is what
the optimiser says. Finished runs are kept in experiments/.cache and belong to the sources of the core.

    python -m experiments.beliefs --parts partly chance wild noise [--quick]
"""

from __future__ import annotations

import argparse
import hashlib
import json
import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from experiments.problems import Benchmark, awa, cached, dtlz2, toy
from experiments.run_cache import core_digest
from mobo_tuner.core import Optimizer, Problem
from mobo_tuner.core.arrays import FloatArray
from mobo_tuner.core.pareto import is_nondominated

Outputs = dict[str, Any]
Fault = Callable[[int, dict[str, float], np.random.Generator], Outputs | None]
"""Makes of the true outputs of evaluation i what is told; None tells nothing at all."""


def valley() -> Benchmark:
    """Two curved valleys in three variables, steep at the edges; one constraint."""

    def objectives(x: FloatArray) -> FloatArray:
        a, b, c = 1.5 * x.T
        first = np.log1p(np.square(a - b * b) * 4.0 + np.square(1.0 - b) + np.square(c - 0.3))
        second = np.log1p(np.square(a + 0.6) + np.square(b + 0.4) * 2.0 + np.square(c + 0.4))
        return np.stack([first, second], axis=1)

    problem = Problem.from_dict(
        {
            "variables": {name: {"min": -1.5, "max": 1.5} for name in "abc"},
            "objectives": {"f": {"reference": 2.0}, "g": {"reference": 2.0}},
            "constraints": {"h": {"max": 0.8}},
        }
    )
    return Benchmark(problem, objectives, 1.0, {"h": lambda x: np.hypot(x[:, 0], 1.2 * x[:, 2])})


def beam() -> Benchmark:
    """Beam size, emittance and energy spread of the AWA surrogate."""
    whole = awa()
    names = ("sigma_x", "eps_x", "dE")
    columns = [whole.problem.objective_names.index(name) for name in names]
    kept = tuple(whole.problem.objectives[column] for column in columns)
    problem = replace(whole.problem, objectives=kept)
    return Benchmark(problem, lambda x: whole.objectives(x)[:, columns])


BENCHMARKS: dict[str, Callable[[], Benchmark]] = {
    "toy": toy,
    "valley": valley,
    "dtlz2": lambda: dtlz2(2, 4),
    "beam": beam,
}


@dataclass(frozen=True)
class Played:
    """What a run came to, in hypervolume.

    Attributes:
        reported: Hypervolume that the optimiser reports.
        measured: Hypervolume of the readings as they are.
        true: Hypervolume of the noiseless values at the reported front.
        visited: Hypervolume of the noiseless values at all set-points.
        failed: Number of failed evaluations.
    """

    reported: float
    measured: float
    true: float
    visited: float
    failed: int


def play(
    name: str, label: str, seed: int, evaluations: int, fault: Fault, told: bool = True
) -> Played:
    """Return the outcome of a run, from the cache where it was played before.

    Args:
        name: Benchmark.
        label: Name of the fault, by which the run is kept.
        seed: Seed of the optimiser and of the fault.
        evaluations: Number of evaluations.
        fault: What the machine does to the outputs.
        told: Whether failed evaluations are told.
    """
    belongs = [name, label, seed, evaluations, told, core_digest()]
    digest = hashlib.sha256(json.dumps(belongs).encode()).hexdigest()[:12]
    path = cached(f"belief-{name}-{digest}.json")
    if path.exists():
        return Played(**json.loads(path.read_text(encoding="utf-8")))
    benchmark = BENCHMARKS[name]()
    optimizer = Optimizer(benchmark.problem, seed=seed)
    rng = np.random.default_rng([seed, 12])
    for i in range(evaluations):
        setpoint = optimizer.ask()
        outputs = fault(i, benchmark.measure(setpoint), rng)
        if outputs is not None:
            optimizer.tell(setpoint, outputs)
        elif told:
            optimizer.tell(setpoint, {}, failed=True)
    data = optimizer.dataset
    front = [point["index"] for point in optimizer.pareto_front()]
    played = Played(
        float(optimizer.hypervolume),
        float(optimizer.hypervolume_measured),
        true_hypervolume(benchmark, data.inputs[front]),
        true_hypervolume(benchmark, data.inputs[data.valid]),
        int(data.failed.sum()),
    )
    path.write_text(json.dumps(vars(played)), encoding="utf-8")
    return played


def true_hypervolume(benchmark: Benchmark, inputs: FloatArray) -> float:
    """Return the hypervolume of the noiseless values at feasible set-points `(n, d)`."""
    if len(inputs) == 0:
        return 0.0
    good = np.ones(len(inputs), dtype=bool)
    for constraint in benchmark.problem.constraints:
        assert benchmark.others is not None
        values = benchmark.others[constraint.name](inputs)
        good &= (constraint.minimum <= values) & (values <= constraint.maximum)
    objectives = benchmark.objectives(inputs)[good]
    front = objectives[is_nondominated(objectives)] if len(objectives) else objectives
    return benchmark.score(front) * benchmark.unit


def output_ranges(benchmark: Benchmark) -> dict[str, float]:
    """Return the range of every output over the space, without the worst twentieth."""
    rng = np.random.default_rng(0)
    inputs = rng.uniform(-1.0, 1.0, (2000, len(benchmark.problem.variables)))
    columns = dict(
        zip(benchmark.problem.objective_names, benchmark.objectives(inputs).T, strict=True)
    )
    columns |= {name: other(inputs) for name, other in (benchmark.others or {}).items()}
    return {
        name: float(np.quantile(values, 0.95) - values.min()) for name, values in columns.items()
    }


def whole(_: int, outputs: Outputs, __: np.random.Generator) -> Outputs:
    """Return the outputs as they are."""
    return outputs


def partly(options: argparse.Namespace) -> None:
    """Print the share of the true hypervolume of as many whole evaluations."""
    print("partly measured: true hypervolume of 60 evaluations / of 40 whole ones; target >= 1")

    def some(_: int, outputs: Outputs, rng: np.random.Generator) -> Outputs:
        count = 2.0 * len(outputs) / 3.0
        kept = int(count) + int(rng.random() < count % 1.0)
        return {str(name): outputs[name] for name in rng.permutation(list(outputs))[:kept]}

    for name in options.problems:
        rows = [
            (play(name, "some", s, 60, some), play(name, "whole", s, 40, whole))
            for s in range(options.seeds)
        ]
        ratios = [part.true / full.true for part, full in rows]
        errors = [part.reported / part.true - 1.0 for part, _ in rows]
        print(f"  {name:8s} {_spread(ratios)}   reported / true - 1: {_spread(errors)}", flush=True)


def chance(options: argparse.Namespace) -> None:
    """Print the share of the hypervolume of the run to which failures were not told."""
    print("failures by chance: true hypervolume / with the failures withheld; target >= 0.97")
    for name in options.problems:
        for p in (0.2, 0.5, 0.75):

            def fails(
                _: int, outputs: Outputs, rng: np.random.Generator, p: float = p
            ) -> Outputs | None:
                return outputs if rng.random() >= p else None

            pairs = [
                [play(name, f"chance {p}", s, 40, fails, told) for told in (True, False)]
                for s in range(options.seeds)
            ]
            means = np.mean([[told.true, withheld.true] for told, withheld in pairs], axis=0)
            print(
                f"  {name:8s} p = {p:4g}   of the means {means[0] / means[1]:.3f}   "
                f"least {min(told.true for told, _ in pairs):.3g} of {means[1]:.3g}",
                flush=True,
            )


def wild(options: argparse.Namespace) -> None:
    """Print the share of the hypervolume of the run without the wild reading."""
    print("one wild reading in 60: true hypervolume / without it; target >= 0.98")
    for name in options.problems:
        benchmark = BENCHMARKS[name]()
        ranges = output_ranges(benchmark)
        clean = [play(name, "whole", s, 60, whole) for s in range(options.seeds)]
        for times in (1.0, 10.0, 1e6, -1.0, -10.0):
            ratios, errors = [], []
            for seed in range(options.seeds):
                output = list(ranges)[seed % len(ranges)]
                at = 3 + 5 * seed % 30

                def misread(
                    i: int,
                    outputs: Outputs,
                    _: np.random.Generator,
                    at: int = at,
                    output: str = output,
                    by: float = times * ranges[output],
                ) -> Outputs:
                    return outputs | ({output: outputs[output] + by} if i == at else {})

                played = play(name, f"wild {times:g}", seed, 60, misread)
                ratios.append(played.visited / clean[seed].visited)
                errors.append(played.reported / played.visited - 1.0)
            print(
                f"  {name:8s} {times:6g} ranges   {_spread(ratios)}   "
                f"reported / true - 1: {_spread(errors)}",
                flush=True,
            )


def noise(options: argparse.Namespace) -> None:
    """Print how far the reported hypervolume is from the true one, and what is found."""
    print(
        "noise, n = 40: reported / true - 1, target mean <= 3 %, most <= 10 %; measured / true - 1;"
    )
    print("true hypervolume of the front / noiseless run")
    for name in options.problems:
        benchmark = BENCHMARKS[name]()
        ranges = output_ranges(benchmark)
        clean = np.mean([play(name, "whole", s, 40, whole).true for s in range(options.seeds)])
        for share in options.noise:
            for given in (False, True):

                def noisy(
                    _: int,
                    outputs: Outputs,
                    rng: np.random.Generator,
                    share: float = share,
                    given: bool = given,
                    ranges: dict[str, float] = ranges,
                ) -> Outputs:
                    stddevs = {n: share * ranges[n] for n in outputs}
                    readings = {n: v + stddevs[n] * rng.normal() for n, v in outputs.items()}
                    return {n: (v, stddevs[n]) if given else v for n, v in readings.items()}

                label = f"noise {share} {'told' if given else 'learned'}"
                played = [play(name, label, s, 40, noisy) for s in range(options.seeds)]
                errors = [p.reported / p.true - 1.0 for p in played]
                lucky = [p.measured / p.true - 1.0 for p in played]
                print(
                    f"  {name:8s} {share:4.0%} {'told   ' if given else 'learned'}  "
                    f"|error| {np.mean(np.abs(errors)):6.3f}  most {np.max(np.abs(errors)):6.3f}  "
                    f"mean {np.mean(errors):+6.3f}   measured {np.mean(lucky):+6.3f}   "
                    f"true {np.mean([p.true for p in played]) / clean:.3f}  "
                    f"visited {np.mean([p.visited for p in played]) / clean:.3f}",
                    flush=True,
                )


def _spread(values: Iterable[float]) -> str:
    listed = np.array(list(values))
    if len(listed) == 0 or math.isnan(listed.mean()):
        return "none"
    return f"mean {listed.mean():+.3f}, least {listed.min():+.3f}, most {listed.max():+.3f}"


PARTS = {"partly": partly, "chance": chance, "wild": wild, "noise": noise}


def main() -> None:
    """Print the parts asked for."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--parts", nargs="+", choices=list(PARTS), default=list(PARTS))
    parser.add_argument("--problems", nargs="+", choices=list(BENCHMARKS), default=list(BENCHMARKS))
    parser.add_argument("--noise", nargs="+", type=float, default=[0.02, 0.05, 0.1])
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--quick", action="store_true", help="two seeds of the toy problem")
    options = parser.parse_args()
    if options.quick:
        options.seeds, options.problems = 2, ["toy"]
    for part in options.parts:
        PARTS[part](options)


if __name__ == "__main__":
    main()
