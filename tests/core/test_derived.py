"""Derived quantities: what is computed, what is refused, and where the results arrive."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mobo_tuner.core import Optimizer, Problem
from mobo_tuner.core.dataset import Dataset
from mobo_tuner.core.derived import DEEPEST, LONGEST, Derived
from mobo_tuner.core.machine_facts import MachineFacts
from mobo_tuner.core.problem import ProblemError

CONFIG = Path(__file__).parents[2] / "config"
READINGS = {"a": (4.0, 0.1), "b": (9.0, 0.2), "zero": (0.0, 0.1), "lost": (math.nan, math.nan)}
PROBLEM: dict[str, Any] = {
    "variables": {"x": {"min": 0.0, "max": 10.0}},
    "derived": {
        "eps_4d": {"formula": "sqrt(eps_x * eps_y)", "unit": "mm mrad"},
        "ratio": {"formula": "eps_x / eps_y"},
        "shift": {"formula": "abs(x - 5)"},
    },
    "objectives": {"eps_4d": {"reference": 100.0}, "shift": {"reference": 5.0}},
    "constraints": {"ratio": {"max": 2.0}},
    "observables": {"charge": {}},
}


@pytest.mark.parametrize(
    ("formula", "value"),
    [
        ("sqrt(a * b)", 6.0),
        ("-a + 2 * b ** 2 / 3 - b // a - b % a", -4.0 + 54.0 - 2.0 - 1.0),
        ("a if b > 3 and not a > b else zero", 4.0),
        ("(a < b) + (a <= 4) + (a != b) + (a == b)", 3.0),
        ("hypot(min(a, b), max(a, 3)) + log(b, 3) + pi * zero", math.hypot(4.0, 4.0) + 2.0),
    ],
)
def test_a_formula_is_arithmetic(formula: str, value: float) -> None:
    result = Derived("q", formula).of(READINGS)
    assert result.value == pytest.approx(value, rel=1e-12)
    assert result.reason == ""


@pytest.mark.parametrize(
    "formula",
    ["1 / zero", "sqrt(-a)", "(-a) ** 0.5", "exp(1000 * a)", "b ** b ** b ** b", "1e38 * b"],
)
def test_what_is_undefined_is_not_measured_and_says_where(formula: str) -> None:
    result = Derived("q", formula).of(READINGS)
    assert math.isnan(result.value)
    assert formula in result.reason
    assert "= " in result.reason
    assert "\n" not in result.reason


def test_what_needs_a_lost_reading_is_not_measured() -> None:
    result = Derived("q", "a if b > 3 else lost").of(READINGS)
    assert math.isnan(result.value)
    assert result.reason == ""
    assert math.isnan(Derived("q", "a + absent").of(READINGS).value)


@pytest.mark.parametrize(
    "formula",
    [
        "__import__('os').system('true')",
        "().__class__.__bases__[0].__subclasses__()",
        "a.real",
        "[a for a in (1, 2)]",
        "(lambda: a)()",
        "a := 3",
        "f'{a}'",
        "'text'",
        "True * a",
        "a << 3",
        "a in b",
        "sqrt(x=a)",
        "sqrt(a, b)",
        "mean(a)",
        "1e999 * a",
        "10 ** 400",
        "a; b",
        "import os",
        "",
        "a +",
        "-" * (DEEPEST + 2) + "a",
        "a" * (LONGEST + 1),
        7,
    ],
)
def test_what_is_not_arithmetic_is_refused_in_one_sentence(formula: Any) -> None:
    with pytest.raises(ProblemError, match=r"^derived\.q\.formula ") as error:
        Derived("q", formula)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("formula", ["sqrt(a * b)", "a ** 2 / b", "log(a) * sin(b / 9)", "a - a"])
def test_standard_deviations_are_propagated_as_by_monte_carlo(formula: str) -> None:
    rng = np.random.default_rng(3)
    readings = {"a": (4.0, 0.04), "b": (9.0, 0.03)}
    draws = {name: rng.normal(*reading, 4000) for name, reading in readings.items()}
    derived = Derived("q", formula)
    values = [
        derived.of({n: (float(d[i]), 0.0) for n, d in draws.items()}).value for i in range(4000)
    ]
    assert derived.of(readings).stddev == pytest.approx(np.std(values), rel=0.05, abs=1e-9)


def test_an_unknown_standard_deviation_makes_that_of_the_result_unknown() -> None:
    result = Derived("q", "a + b").of({"a": (1.0, math.nan), "b": (2.0, 0.1)})
    assert result.value == 3.0
    assert math.isnan(result.stddev)
    edge = Derived("q", "sqrt(zero)").of(READINGS)  # undefined on one side
    assert edge.stddev == pytest.approx(math.sqrt(1e-4) * 1e3)


@pytest.mark.parametrize(
    ("section", "entry", "sentence"),
    [
        ("derived", {"q": {"formula": "eps_4d + a"}, **PROBLEM["derived"]}, "derived itself"),
        ("derived", {"x": {"formula": "a"}}, "derived.x is called as a variable"),
        ("derived", {"q": {}}, "derived.q.formula is ''"),
        ("derived", {"q": {"formula": "a", "min": 1}}, "'min' is unknown in derived.q"),
        ("constraints", {"ratio": {"max": 2.0, "critical": True}}, "constraints.ratio.critical"),
        ("observables", {"eps_4d": {"unit": "m"}}, "derived.eps_4d.unit is 'mm mrad'"),
        ("objectives", {"shift": {}}, "at least one that is measured"),
    ],
)
def test_a_derived_quantity_that_cannot_be_is_refused(
    section: str, entry: dict[str, Any], sentence: str
) -> None:
    mapping = {**PROBLEM, section: entry}
    if "at least one" in sentence:
        del mapping["constraints"]
    with pytest.raises(ProblemError, match=sentence):
        Problem.from_dict(mapping)


def test_a_machine_measures_the_parts_and_not_the_result() -> None:
    problem = Problem.from_dict(PROBLEM)
    limits = {"x": (0.0, 10.0)}
    MachineFacts(limits, dict.fromkeys(("eps_x", "eps_y", "charge"), "")).check(problem)
    with pytest.raises(ProblemError, match=r"derived\.eps_4d\.formula uses 'eps_y'"):
        MachineFacts(limits, dict.fromkeys(("eps_x", "charge"), "")).check(problem)
    with pytest.raises(ProblemError, match=r"derived\.ratio is called as a diagnostic"):
        MachineFacts(limits, dict.fromkeys(("eps_x", "eps_y", "charge", "ratio"), "")).check(
            problem
        )
    assert problem.measured_diagnostics == ("eps_x", "eps_y")
    assert problem.units["eps_4d"] == problem.objectives[0].unit == "mm mrad"
    assert Problem.from_dict(problem.to_dict()) == problem


def test_the_optimiser_learns_the_result() -> None:
    data = Dataset(Problem.from_dict(PROBLEM))
    told = {"eps_x": (16.0, 1.0), "eps_y": (4.0, math.nan)}
    first = data.add({"x": 2.0}, told)
    assert first.values == {"eps_x": 16.0, "eps_y": 4.0, "eps_4d": 8.0, "ratio": 4.0, "shift": 3.0}
    assert (first.complete, first.feasible, first.valid) == (True, False, True)
    again = data.add({"x": 2.0}, {name: first.values[name] for name in first.values})
    assert again.values == first.values  # as a replay tells it
    old = data.add({"x": 2.0}, {"eps_4d": 9.0})  # without its parts, from an old table
    assert old.value("eps_4d") == 9.0
    undefined = data.add({"x": 2.0}, {"eps_x": -16.0, "eps_y": 4.0})
    assert (math.isnan(undefined.value("eps_4d")), undefined.value("ratio")) == (True, -4.0)
    assert data.add({"x": 2.0}, {"eps_x": math.nan}).failed  # that of x alone says nothing


def test_where_the_machine_was_counts() -> None:
    data = Dataset(Problem.from_dict(PROBLEM))
    told = {"eps_x": 16.0, "eps_y": 4.0}
    assert data.add({"x": 2.0}, told, {"x": 2.5}).value("shift") == 2.5


def test_a_withdrawn_part_withdraws_the_result() -> None:
    data = Dataset(Problem.from_dict(PROBLEM))
    data.add({"x": 2.0}, {"eps_x": 16.0, "eps_y": 4.0})
    data.forget(0, "eps_x")
    data.forget(0, "eps_y")
    assert math.isnan(data.evaluations[0].value("eps_4d"))
    data.unforget(0, "eps_x")
    assert math.isnan(data.evaluations[0].value("ratio"))
    data.unforget(0, "eps_y")
    assert data.evaluations[0].value("ratio") == 4.0
    assert data.withdrawn == []


def test_an_optimiser_tunes_what_is_derived_and_is_restored() -> None:
    problem = Problem.from_yaml(CONFIG / "derived.yaml")
    optimizer = Optimizer(problem, seed=1, initial_evaluations=3)
    for _ in range(4):
        x = optimizer.ask()
        u = problem.normalize(x)
        optimizer.tell(
            x,
            {
                "eps_x": 50.0 + 20.0 * float(u @ u),
                "eps_y": 60.0 + 10.0 * float(u[0]),
                "sigma_x": 2.0,
                "sigma_y": 3.0,
                "sigma_z": 1.0 - 0.5 * float(u[1]),
                "charge": 1.0,
                "transmission": 1.0,
            },
        )
    point = optimizer.pareto_front()[0]
    values = optimizer.dataset.evaluations[point["index"]].values
    expected = math.sqrt(values["eps_x"] * values["eps_y"])
    assert point["objectives"]["eps_4d"] == pytest.approx(expected)
    assert values["detuning"] == abs(point["setpoint"]["phi1"] - point["setpoint"]["phi2"])
    restored = Optimizer.from_state(optimizer.get_state())
    assert restored.ask() == optimizer.ask()
