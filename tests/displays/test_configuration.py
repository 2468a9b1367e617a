"""What `mobo.py check` says of a parameter file."""

from __future__ import annotations

from typing import Any

import pytest

from mobo_tuner.core.problem import Problem
from mobo_tuner.displays.configuration import Configuration, explanation
from mobo_tuner.machine.description import MachineDescription, VariableLimits
from mobo_tuner.tuner.parameters import check_tuner

MACHINE = MachineDescription(
    "injector", {"K1": VariableLimits(0.0, 900.0, "A")}, {"dE": "MeV"}, 12.0
)
PROBLEM = {
    "variables": {"K1": {"min": 400.0, "max": 550.0, "unit": "A"}},
    "objectives": {
        "dE": {"reference": 0.5, "truncation": [0.0, 0.52], "unit": "MeV"},
        "charge": {"direction": "maximize", "reference": 1.0},
    },
    "constraints": {
        "transmission": {"min": 0.98, "critical": True},
        "halo": {"max": 0.1, "unit": "mm"},
        "energy": {"min": 10.0, "max": 12.0},
    },
    "observables": {"temperature": {"unit": "K"}},
    "context": {"hall": {"min": 18.0, "max": 30.0, "unit": "degC"}, "flow": {}},
}


def explained(problem: dict[str, Any] = PROBLEM, **changes: Any) -> str:
    tuner = check_tuner(changes.pop("tuner", {}))
    facts: dict[str, Any] = {"section": "awa_sim", "machine": MACHINE, "program": ""} | changes
    return "\n".join(
        explanation(Configuration("my.yaml", Problem.from_dict(problem), tuner, **facts))
    )


@pytest.mark.parametrize(
    "words",
    [
        ("my.yaml",),
        ("injector", "awa_sim"),
        ("K1", "400 to 550 A"),
        ("dE", "minimize", "0.5 MeV", "0 to 0.52 MeV"),
        ("charge", "maximize", "1"),
        ("transmission", "at least 0.98", "critical"),
        ("halo", "at most 0.1 mm"),
        ("energy", "10 to 12"),
        ("temperature [K]",),
        ("hall", "expected from 18 to 30 degC"),
        ("flow", "range that is measured"),
        ("preset default", "ehvi"),
        ("60 evaluations",),
        ("ends early", "never"),
        ("on_end: hold",),
        ("on_abort: hold",),
        ("on_violation: hold",),
        ("12 min", "12 s"),  # 60 evaluations of 12 s
    ],
)
def test_each_fact_stands_in_a_line_of_its_own(words: tuple[str, ...]) -> None:
    assert any(all(word in line for word in words) for line in explained().splitlines())


def test_the_ends_and_the_budget_are_those_of_the_tuner() -> None:
    text = explained(tuner={"on_abort": "best", "evaluations": 7, "initial_evaluations": 3})
    assert "on_abort: best" in text
    assert "7 evaluations, the first 3" in text


@pytest.mark.parametrize(
    ("name", "value", "words"),
    [
        ("hypervolume_goal", 3.5, "hypervolume of 3.5"),
        ("stop_after", 300.0, "5 min"),
        ("stop_without_gain", 7, "7 evaluations"),
        ("stop_below_expected_gain", 0.5, "0.5 %"),
    ],
)
def test_what_ends_a_run_early_is_told(name: str, value: float, words: str) -> None:
    [line] = [line for line in explained(tuner={name: value}).splitlines() if "ends early" in line]
    assert words in line


def test_a_run_takes_no_longer_than_its_time() -> None:
    [line] = [
        line for line in explained(tuner={"stop_after": 120.0}).splitlines() if line[2:6] == "time"
    ]
    assert "2 min" in line
    assert "10 evaluations" in line


@pytest.mark.parametrize("event", ["on_end", "on_abort", "on_violation", "on_client_lost"])
@pytest.mark.parametrize("policy", ["hold", "restore", "restore_anyway", "best"])
def test_every_fallback_is_explained(event: str, policy: str) -> None:
    assert f"({event}: {policy})" in explained(tuner={event: policy})


def test_grids_choices_and_limits_are_explained() -> None:
    variables = {
        "K1": {"min": 400.0, "max": 550.0, "unit": "A", "step": 0.4},
        "filter": {"choices": [1.0, 2.0, 5.0]},
        "K2": {"fixed": 20.0, "unit": "A"},
        "gain": {"min": 0.1, "max": 10.0, "scale": "log"},
        "phase": {"around": "10 %"},
        "field": {"around": 2.5, "unit": "T"},
        "angle": {"fixed": "present"},
    }
    limits = {"total": {"K1": 1.0, "K2": -2.0, "max": 500.0}}
    text = explained({**PROBLEM, "variables": variables, "limits": limits})
    for words in (
        "400 to 550 A, in steps of 0.4",
        "one of 1, 2, 5",
        "fixed at 20 A",
        "0.1 to 10, logarithmic",
        "10 % of its range around where the machine is",
        "2.5 T around where the machine is",
        "fixed where the machine is",
        "1 K1 + -2 K2 at most 500",
    ):
        assert words in text


def test_only_a_critical_constraint_can_be_violated() -> None:
    problem = {name: PROBLEM[name] for name in ("variables", "objectives")}
    text = explained(problem)
    assert "on_violation" not in text
    assert "constraints  none" in text
    assert "observables  none" in text


@pytest.mark.parametrize(
    ("program", "words"), [("python mine.py", "'python mine.py'"), ("", "there already")]
)
def test_a_machine_that_is_not_described_beforehand_is_asked_later(
    program: str, words: str
) -> None:
    text = explained(machine=None, section="", program=program)
    assert words in text
    assert "time         not known" in text


@pytest.mark.parametrize(
    ("seconds", "text"), [(0.01, "0.6 s"), (60.0, "60 min"), (600.0, "10.0 h"), (None, "not known")]
)
def test_the_time_is_told_in_a_fitting_unit(seconds: float | None, text: str) -> None:
    machine = MachineDescription("injector", MACHINE.variables, MACHINE.diagnostics, seconds)
    [line] = [line for line in explained(machine=machine).splitlines() if line[2:6] == "time"]
    assert text in line
