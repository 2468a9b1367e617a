"""Problems of the kinds that Xopt's and Badger's own tests have, in this project's words, beside Xopt's generators.

    python -m experiments.peer_tests --seeds 5

    discrete    Rosenbrock's function with one variable on a list of values; until 0.05 is found
    context     a sine whose phase a contextual variable sets, which swings slowly; until ten evaluations after the
                common ones are within 0.1 of the best there
    limits      the problem of Tanaka with its two constraints; until a hypervolume of 0.3 is found
    formula     an objective by a formula of readings, ranges around where the machine is; until 0.02 is found

Printed are the evaluations until then, the first five of which are the same for all, `--evaluations` where it was not
reached. Xopt (`experiments/requirements.txt`) runs with its defaults: expected improvement, and MOBO for two
objectives; it is told the ranges and the formula's result, which it does not compute. Badger (`badger-opt`, beside
Xopt) carries out the last case as a routine of its own, with its own formula and its own relative ranges, by Xopt's
expected improvement. A peer that is not installed is left out.
"""

from __future__ import annotations

import argparse
import json
import math
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from importlib.util import find_spec
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, ClassVar

import numpy as np

from mobo_tuner.core import Optimizer, Problem
from mobo_tuner.core.arrays import FloatArray
from mobo_tuner.core.hypervolume import hypervolume

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
        present: Where the machine is, if the ranges depend on that.
        machine: Ranges of the machine's variables, if so.
    """

    problem: Problem
    measure: Callable[[Measured, int], dict[str, float]]
    reached: Callable[[Sequence[Measured]], bool]
    present: Measured = field(default_factory=dict)
    machine: Mapping[str, tuple[float, float]] = field(default_factory=dict)


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

    return Case(problem.resolved(present, machine), measure, reached, present, machine)


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


def configure_badger(folder: str) -> None:
    """Let Badger look for plugins in an empty folder, which it needs although none is used."""
    from badger.settings import init_settings

    path = Path(folder, "config.yaml")
    path.write_text(json.dumps({"BADGER_PLUGIN_ROOT": {"value": folder, "is_path": True}}))
    init_settings(str(path))


def badger(case: Case, seed: int, most: int) -> int:
    """Return the evaluations that Badger needs for a case of derived objectives and relative ranges."""
    import pandas as pd
    import torch
    from badger.core import run_routine
    from badger.environment import BaseEnvironment
    from badger.errors import BadgerRunTerminated
    from badger.routine import Routine, calculate_variable_bounds
    from xopt.generators.bayesian import ExpectedImprovementGenerator
    from xopt.vocs import VOCS

    torch.manual_seed(seed)
    problem, state, made = case.problem, dict(case.present), list[Measured]()
    formulas = {derived.name: derived.formula for derived in problem.derived}

    class Machine(BaseEnvironment):
        name = "machine"
        variables: ClassVar = {name: list(bounds) for name, bounds in case.machine.items()}
        observables: ClassVar = sorted({i for derived in problem.derived for i in derived.names})

        def get_variables(self, variable_names: list[str]) -> dict[str, float]:
            return {name: state[name] for name in variable_names}

        def set_variables(self, variable_inputs: dict[str, float]) -> None:
            state.update(variable_inputs)
            made.append(case.measure(state, len(made)))

        def get_observables(self, observable_names: list[str]) -> dict[str, float]:
            return {name: made[-1][name] for name in observable_names}

    options = {
        v.name: {
            "limit_option_idx": 1,  # a ratio of the machine's range
            "ratio_full": (v.maximum - v.minimum) / (v_range[1] - v_range[0]),
        }
        for v in problem.variables
        for v_range in [case.machine[v.name]]
    }
    objectives = {formulas[o.name]: o.direction.upper() for o in problem.objectives}
    machine = Machine()
    free = VOCS(variables=machine.variables, objectives=objectives)
    vocs = VOCS(variables=calculate_variable_bounds(options, free, machine), objectives=objectives)
    routine = Routine(
        name=f"seed {seed}",
        environment=machine,
        generator=ExpectedImprovementGenerator(vocs=vocs),
        initial_points=pd.DataFrame(begin(case, seed)),
    )
    with suppress(BadgerRunTerminated):  # which is how a run of Badger ends
        run_routine(
            routine,
            active_callback=lambda: 2 * (len(made) >= most or case.reached(made)),
            generate_callback=lambda _: None,
            evaluate_callback=lambda _: None,
            states_callback=lambda _: None,
            verbose=0,
        )
    return len(made)


def main() -> None:
    """Print the evaluations of all, case by case, and their medians."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("--cases", nargs="+", choices=CASES, default=[*CASES])
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--evaluations", type=int, default=50, help="at most")
    options = parser.parse_args()
    methods = {"ours": ours} | {p.__name__: p for p in (xopt, badger) if find_spec(p.__name__)}
    with TemporaryDirectory() as folder:
        if badger in methods.values():
            configure_badger(folder)
        for name in options.cases:
            for who, method in methods.items():
                if method is badger and not CASES[name]().machine:
                    continue
                counts: FloatArray = np.array(
                    [
                        method(CASES[name](), seed, options.evaluations)
                        for seed in range(options.seeds)
                    ],
                    dtype=float,
                )
                shown = " ".join(f"{count:.0f}" for count in counts)
                print(f"{name:9} {who:6} median {np.median(counts):g}, of {shown}", flush=True)


if __name__ == "__main__":
    main()
