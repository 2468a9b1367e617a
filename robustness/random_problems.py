"""Draw random problems and check that every suggestion is inside bounds, on grids and within limits.

    python -m robustness.random_problems --problems 2000
    python -m robustness.random_problems --problems 100 --seed 7    # others, one of several parts of a campaign

Variables are continuous, on a grid, from a list, names without an order, logarithmic, fixed, or around where the
machine is, with linear limits between them and names as control systems have them; objectives may be derived by a
formula or have a goal, a constraint may have to be believed safe, suggestions may have to keep near to what was
measured, and a run may begin with evaluations from elsewhere. A problem of few set-points must try each before it
repeats one.
"""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Mapping
from typing import Any

import hypothesis
import numpy as np
from hypothesis import strategies as st

from mobo_tuner.core import Optimizer, Problem
from mobo_tuner.core.safety import DISTANCE, is_guarded, trust_distance, was_safe
from mobo_tuner.names import topic_token

CHEAP = {"screened": 32, "screened_nearby": 16, "far_starts": 4, "near_starts": 4, "finished": 2}
CHEAP |= {"steps": 3, "evaluations": 8}
AFTER_THE_DESIGN = 3  # evaluations
KINDS = ("continuous", "step", "choices", "names", "log", "log step", "fixed", "around", "present")

_numbers = st.floats(-1e3, 1e3, allow_nan=False).map(lambda value: round(value, 3))
_words = st.text("abcdefgh- ", min_size=1, max_size=12)
_names = st.from_regex(r"[A-Z][A-Z0-9_:./+-]{0,30}[0-9]", fullmatch=True)
_goals = st.floats(0.0, 2.9)
_widths = st.floats(1e-3, 1e3).map(lambda value: float(f"{value:.4g}"))


@st.composite
def variables(draw: st.DrawFn) -> dict[str, Any]:
    """Draw the definition of a variable."""
    kind = draw(st.sampled_from(KINDS))
    low, width = draw(_numbers), draw(_widths)
    if kind.startswith("log"):
        low = abs(low) + 0.01
    entry: dict[str, Any] = {"min": low, "max": low + width}
    if kind.startswith("log"):
        entry["scale"] = "log"
    if kind.endswith("step"):
        # At most as wide as the range, so that there is a multiple of it in between.
        entry["step"] = width / draw(st.sampled_from([1.0, 1.5, 2.0, 3.0, 7.7, 64.0, 1000.0]))
    if kind == "choices":
        return {"choices": draw(st.lists(_numbers, min_size=2, max_size=6, unique=True))}
    if kind == "names":
        names = draw(st.lists(_words, min_size=2, max_size=6, unique=True))
        values = draw(st.lists(_numbers, min_size=len(names), max_size=len(names), unique=True))
        return {"choices": names, "values": values}
    if kind == "around":
        around = draw(st.sampled_from([width, "10 %", "0.5%", "100 %"]))
        walls = {"min": -2e3} if draw(st.booleans()) else {}
        return {"around": around, **walls}
    if kind == "present":
        return {"fixed": "present", **({"step": width} if draw(st.booleans()) else {})}
    if kind == "fixed":
        return {"fixed": low} if draw(st.booleans()) else entry | {"fixed": low + width / 2}
    return entry


@st.composite
def problems(draw: st.DrawFn) -> Problem:
    """Draw a problem, whose limits leave at least one set-point."""
    names = draw(st.lists(_names, min_size=4, max_size=4, unique_by=topic_token))
    entries = {name: draw(variables()) for name in names[: draw(st.integers(1, 4))]}
    objectives: dict[str, dict[str, float]] = {
        f"f{i}": {"reference": 3.0} | ({"goal": draw(_goals)} if draw(st.booleans()) else {})
        for i in range(draw(st.integers(1, 2)))
    }
    free = Problem.from_dict({"variables": entries, "objectives": objectives})
    # A machine that is somewhere; what depends on it becomes what it is in a run.
    limits_of_machine = dict.fromkeys(entries, (-3000.0, 3000.0))
    present = {name: draw(st.one_of(_numbers, st.sampled_from([0.0, 3e3]))) for name in entries}
    free = free.resolved(present, limits_of_machine)
    entries = free.to_dict()["variables"]
    limits: dict[str, dict[str, float]] = {}
    places = st.floats(-1.0, 1.0)
    allowed = {v.name: v.denormalize(draw(places)) for v in free.variables}
    linear = [v for v in free.variables if v.scale == "linear" and not v.choice_names]
    for i in range(draw(st.integers(0, 2)) if linear else 0):
        chosen = draw(st.lists(st.sampled_from(linear), min_size=1, max_size=3, unique=True))
        weights = {v.name: draw(st.sampled_from([-2.0, -1.0, 0.3, 1.0])) for v in chosen}
        value = math.fsum(weights[name] * allowed[name] for name in weights)
        extent = math.fsum(abs(weights[v.name]) * (v.maximum - v.minimum) for v in chosen)
        ends = {"max": value + draw(st.floats(1e-3, 0.5)) * extent}
        if draw(st.booleans()):
            ends["min"] = value - draw(st.floats(1e-3, 0.5)) * extent
        limits[f"sum{i}"] = weights | ends
    mapping: dict[str, Any] = {"variables": entries, "objectives": objectives, "limits": limits}
    first = free.variables[0]
    if draw(st.booleans()) and not first.choice_names:
        x0 = f"`{first.name}`"
        formula = f"sqrt(f0 + 1) + {draw(_widths)} * abs({x0}) / (1 + abs({x0}))"
        mapping["derived"] = {"q": {"formula": formula}}
        mapping["objectives"] = {**objectives, "q": {"reference": 2e3}}
    if draw(st.booleans()):
        safe = {"safe": draw(st.sampled_from([0.5, 0.95, 0.999]))} if draw(st.booleans()) else {}
        mapping["constraints"] = {"g": {"max": draw(st.floats(0.2, 1.0)), **safe}}
    return Problem.from_dict(mapping)


def measure(problem: Problem, setpoint: Mapping[str, float]) -> dict[str, float]:
    """Return smooth objectives of a set-point, of which one fails near a corner."""
    x = problem.normalize(setpoint)
    values = [float(((x - 0.3) ** 2).mean()), float(((x + 0.4) ** 2).mean())]
    measured = dict(zip(("f0", "f1"), values, strict=True))
    if x.sum() > 0.9 * len(x):
        measured = dict.fromkeys(measured, math.nan)
    return {**measured, "g": float(np.abs(x).mean())}


def check(problem: Problem, setpoint: Mapping[str, float]) -> None:
    """Check a set-point.

    Raises:
        AssertionError: If it is outside bounds or limits, or off a grid.
    """
    for variable in problem.variables:
        value = setpoint[variable.name]
        assert variable.minimum <= value <= variable.maximum, (variable, value)
        assert variable.is_allowed(value), (variable, value)
        assert variable.values is None or value in variable.values, (variable, value)
    for limit in problem.limits:
        assert limit.is_met(setpoint), (limit, setpoint)


def check_problem(problem: Problem, seed: int, proximal: bool) -> None:
    """Tune a problem for a few evaluations.

    Raises:
        AssertionError: If a suggestion is not allowed, or comes again before all were made.
    """
    assert Problem.from_dict(problem.to_dict()) == problem
    trust = 0.1 if seed % 3 == 0 else 0.0
    optimizer = Optimizer(
        problem,
        seed=seed,
        maximizer_settings=CHEAP,
        initial_evaluations=4,
        proximal="costs" if proximal else None,
        trust_distance=trust,
    )
    if is_guarded(problem, optimizer.settings):
        check_guarded(optimizer)
        return
    if seed % 4 == 1:
        warm_start(optimizer, seed)
    distinct = len(problem.domain.points()) if problem.domain.size <= 1000 else math.inf
    asked: list[tuple[float, ...]] = []
    while len(asked) < 4 + AFTER_THE_DESIGN:
        setpoint = optimizer.ask()
        check(problem, setpoint)
        asked.append(tuple(setpoint.values()))
        if seed % 4 != 1:  # evaluations from elsewhere are among the set-points that were tried
            assert len(set(asked)) == min(len(asked), distinct), asked
        optimizer.tell(setpoint, measure(problem, setpoint))
    for point in optimizer.predicted_front(8):
        check(problem, point["setpoint"])


def warm_start(optimizer: Optimizer, seed: int) -> None:
    """Tell evaluations from elsewhere: inside the bounds, but on grids only where there is no order."""
    problem, rng = optimizer.problem, np.random.default_rng(seed)
    for x in rng.uniform(-1.0, 1.0, (5, len(problem.variables))):
        old = {name: float(column[0]) for name, column in problem.columns(x[None]).items()}
        old |= {v.name: v.choices[0] for v in problem.variables if v.choice_names}
        optimizer.tell(old, measure(problem, old))


def check_guarded(optimizer: Optimizer) -> None:
    """Tune for a few evaluations from a point on that is safe.

    Raises:
        AssertionError: If a suggestion is not allowed, or far from everything that was safe.
    """
    problem = optimizer.problem
    domain = problem.domain
    start = problem.denormalize(domain.nearest(np.zeros((1, len(problem.variables))))[0])
    optimizer.tell(start, {"f0": 1.0, "f1": 1.0, "g": 0.0})
    first = optimizer.settings.trust_distance or DISTANCE
    for _ in range(4 + AFTER_THE_DESIGN):
        safe = was_safe(optimizer.dataset)
        setpoint = optimizer.ask()
        check(problem, setpoint)
        x = problem.normalize(setpoint)[None]
        distances = domain.distances(x, optimizer.dataset.inputs[safe], "chebyshev")
        assert distances.min() <= trust_distance(safe, first) * (1.0 + 1e-6), setpoint
        optimizer.tell(setpoint, measure(problem, setpoint))


def search(count: int, seed: int | None = None) -> None:
    """Check random problems, always the same ones without a seed.

    Raises:
        AssertionError: If one is wrong; it is printed.
    """

    @hypothesis.settings(
        max_examples=count,
        deadline=None,
        derandomize=seed is None,
        database=None,
        phases=[hypothesis.Phase.generate],  # to shrink a failure takes minutes
        suppress_health_check=list(hypothesis.HealthCheck),
    )
    @hypothesis.given(problems(), st.integers(0, 1000), st.booleans())
    def look(problem: Problem, choice: int, proximal: bool) -> None:
        check_problem(problem, choice, proximal)

    if seed is not None:
        look = hypothesis.seed(seed)(look)
    look()


def main() -> int:
    """Check as many problems as the command line says; return the exit status."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("--problems", type=int, default=2000)
    parser.add_argument("--seed", type=int, help="of the problems; default: always the same ones")
    options = parser.parse_args()
    count = options.problems
    try:
        search(count, options.seed)
    except AssertionError as error:
        print(error, file=sys.stderr)
        return 1
    print(f"{count} problems: every suggestion was inside bounds, on grids and within limits")
    return 0


if __name__ == "__main__":
    sys.exit(main())
