"""Problems of the kinds that Xopt's and Badger's own tests have, in this project's words, beside Xopt's generators.

    python -m experiments.peer_tests --seeds 5

    discrete    Rosenbrock's function with one variable on a list of values; until 0.05 is found
    context     a sine whose phase a contextual variable sets, which swings slowly; until ten evaluations after the
                common ones are within 0.1 of the best there
    limits      the problem of Tanaka with its two constraints; until a hypervolume of 0.3 is found
    formula     an objective by a formula of readings, ranges around where the machine is; until 0.02 is found

Printed are the evaluations until then, the first five of which are the same for both, `--evaluations` where it was not
reached. Xopt (`experiments/requirements.txt`) runs with its defaults: expected improvement, and MOBO for two
objectives; it is told the ranges and the formula's result, which it does not compute. Without Xopt only this project's
runs are made.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from importlib.util import find_spec
from typing import Any

import numpy as np

from mobo_tuner.core import Optimizer, Problem
from mobo_tuner.core.hypervolume import hypervolume
from mobo_tuner.core.pareto import FloatArray

STARTS = 5
PERIOD = 12.0  # evaluations
Measured = Mapping[str, float]


@dataclass(frozen=True)
class Case:
    """A problem with its machine.

    Attributes:
        problem: Problem, resolved where the machine is.
        measure: Function from a set-point and the number of the evaluation to what is measured.
        reached: Function from all set-points and measurements to whether the target is reached.
    """

    problem: Problem
    measure: Callable[[Measured, int], dict[str, float]]
    reached: Callable[[Sequence[Measured]], bool]


def discrete() -> Case:
    """Return Rosenbrock's function with a variable on a list of values."""
    values = [-2.0, -1.25, -0.5, 0.25, 1.0, 1.75]
    problem = Problem.from_dict(
        {
            "variables": {"x0": {"choices": values}, "x1": {"min": -2.0, "max": 2.0}},
            "objectives": {"f": {}},
        }
    )

    def measure(at: Measured, _: int) -> dict[str, float]:
        return {"f": 100.0 * (at["x1"] - at["x0"] ** 2) ** 2 + (1.0 - at["x0"]) ** 2}

    return Case(problem, measure, lambda made: min(m["f"] for m in made) <= 0.05)


def context() -> Case:
    """Return a sine that is maximised at a phase which nobody sets."""
    problem = Problem.from_dict(
        {
            "variables": {"x1": {"min": 0.0, "max": 1.0}},
            "objectives": {"y": {"direction": "maximize"}},
            "context": {"x2": {}},
        }
    )

    def measure(at: Measured, index: int) -> dict[str, float]:
        phase = 0.25 + 0.2 * math.sin(2.0 * math.pi * index / PERIOD)
        return {"y": math.sin(2.0 * math.pi * (at["x1"] - phase)), "x2": phase}

    return Case(
        problem,
        measure,
        lambda made: sum(m["y"] >= 0.9 for m in made[STARTS:]) >= 10,
    )


def limits() -> Case:
    """Return the problem of Tanaka, whose front is in pieces."""
    problem = Problem.from_dict(
        {
            "variables": {name: {"min": 0.0, "max": math.pi} for name in ("x1", "x2")},
            "objectives": {name: {"reference": 1.4} for name in ("y1", "y2")},
            "constraints": {"c1": {"min": 0.0}, "c2": {"max": 0.5}},
        }
    )

    def measure(at: Measured, _: int) -> dict[str, float]:
        x1, x2 = at["x1"], at["x2"]
        return {
            "y1": x1,
            "y2": x2,
            "c1": x1**2 + x2**2 - 1.0 - 0.1 * math.cos(16.0 * math.atan2(x1, x2)),
            "c2": (x1 - 0.5) ** 2 + (x2 - 0.5) ** 2,
        }

    def reached(made: Sequence[Measured]) -> bool:
        front = [[m["y1"], m["y2"]] for m in made if problem.is_feasible(m)]
        values = np.array(front).reshape(-1, 2)
        return hypervolume(values, problem.reference_point) >= 0.3

    return Case(problem, measure, reached)


def formula() -> Case:
    """Return an orbit whose distance from the axis a formula gives, with ranges around where the machine is."""
    corrector = {"around": "10 %", "unit": "A"}
    problem = Problem.from_dict(
        {
            "variables": {
                "corrector:x": corrector,
                "corrector:y": corrector,
                "quad": {"around": 0.5},
            },
            "derived": {"distance": {"formula": "sqrt(`bpm:x` ** 2 + `bpm:y` ** 2)"}},
            "objectives": {"distance": {}},
        }
    )
    present = {"corrector:x": 0.0, "corrector:y": 3.0, "quad": 1.0}
    machine = {"corrector:x": (-5.0, 5.0), "corrector:y": (-5.0, 5.0), "quad": (0.0, 4.0)}

    def measure(at: Measured, _: int) -> dict[str, float]:
        x, y, quad = (at[name] for name in present)
        return {"bpm:x": (x - 0.6) * quad + 0.2 * y - 0.7, "bpm:y": (y - 2.5) / quad + 0.1 * x}

    def reached(made: Sequence[Measured]) -> bool:
        return min(math.hypot(m["bpm:x"], m["bpm:y"]) for m in made) <= 0.02

    return Case(problem.resolved(present, machine), measure, reached)


CASES = {"discrete": discrete, "context": context, "limits": limits, "formula": formula}


def begin(case: Case, seed: int) -> list[dict[str, float]]:
    """Return the set-points with which both begin."""
    x = np.random.default_rng(seed).uniform(-1.0, 1.0, (STARTS, len(case.problem.variables)))
    return [case.problem.denormalize(row) for row in x]


def ours(case: Case, seed: int, most: int) -> int:
    """Return the evaluations that this project needs."""
    optimizer = Optimizer(case.problem, seed=seed, initial_evaluations=STARTS)
    starts = begin(case, seed)
    made: list[Measured] = []
    while len(made) < most and not (made and case.reached(made)):
        setpoint = starts[len(made)] if len(made) < STARTS else optimizer.ask()
        made.append(case.measure(setpoint, len(made)))
        optimizer.tell(setpoint, dict(made[-1]))
    return len(made)


def xopt(case: Case, seed: int, most: int) -> int:
    """Return the evaluations that Xopt needs."""
    import pandas as pd
    import torch
    from xopt.generators.bayesian import ExpectedImprovementGenerator
    from xopt.generators.bayesian.mobo import MOBOGenerator
    from xopt.vocs import VOCS, ContextualVariable

    torch.manual_seed(seed)
    problem = case.problem
    variables: dict[str, Any] = {
        v.name: set(v.choices) if v.choices else [v.minimum, v.maximum] for v in problem.variables
    }
    vocs = VOCS(
        variables=variables | {c.name: ContextualVariable() for c in problem.context},
        objectives={o.name: f"{o.direction.upper()}" for o in problem.objectives},
        constraints={
            c.name: ["GREATER_THAN", c.minimum]
            if math.isfinite(c.minimum)
            else ["LESS_THAN", c.maximum]
            for c in problem.constraints
        },
    )
    generator = (
        ExpectedImprovementGenerator(vocs=vocs)
        if len(problem.objectives) == 1
        else MOBOGenerator(
            vocs=vocs, reference_point={o.name: o.reference for o in problem.objectives}
        )
    )
    starts = begin(case, seed)
    made: list[Measured] = []
    names = [*variables, *(c.name for c in problem.context), *problem.required_diagnostics]
    while len(made) < most and not (made and case.reached(made)):
        asked = starts[len(made)] if len(made) < STARTS else generator.generate(1)[0]
        setpoint = {v.name: float(asked[v.name]) for v in problem.variables}
        made.append(case.measure(setpoint, len(made)))
        told = {n: (r, math.nan) for n, r in made[-1].items()}
        derived = {n: result.value for n, result in problem.derive(setpoint, told).items()}
        row = {**setpoint, **made[-1], **derived}
        generator.add_data(pd.DataFrame([{name: row[name] for name in names}]))
    return len(made)


def main() -> None:
    """Print the evaluations of both, case by case, and their medians."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("--cases", nargs="+", choices=CASES, default=[*CASES])
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--evaluations", type=int, default=50, help="at most")
    options = parser.parse_args()
    methods = {"ours": ours} | ({"xopt": xopt} if find_spec("xopt") else {})
    for name in options.cases:
        for who, method in methods.items():
            counts: FloatArray = np.array(
                [method(CASES[name](), seed, options.evaluations) for seed in range(options.seeds)],
                dtype=float,
            )
            shown = " ".join(f"{count:.0f}" for count in counts)
            print(f"{name:9} {who:5} median {np.median(counts):g}, of {shown}", flush=True)


if __name__ == "__main__":
    main()
