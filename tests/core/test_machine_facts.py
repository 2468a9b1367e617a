"""What a machine says of itself, and which problems it suits."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest

from mobo_tuner.core.machine_facts import MachineFacts
from mobo_tuner.core.problem import Problem, ProblemError
from tests.core.problem_mapping import MAPPING, changed

LIMITS = {"K1": (350.0, 600.0), "phi": (-20.0, 20.0)}
DIAGNOSTICS = dict.fromkeys(["eps_x", "energy", "dE", "transmission", "charge"], "")
MACHINE = MachineFacts(LIMITS, DIAGNOSTICS)


@pytest.mark.parametrize(
    ("facts", "sentence"),
    [
        ({"limits": {"phi": (-20, 20)}}, "variable 'K1' is not one of the machine's"),
        ({"limits": LIMITS | {"K1": (410, 600)}}, "variables.K1.min is 400 A, outside the"),
        ({"limits": LIMITS | {"phi": (-20, -5)}}, "variables.phi.max is 0, outside the"),
        ({"limits": LIMITS | {"G1": (0, 1)}}, "'G1' is missing from 'variables'"),
        ({"diagnostics": {"eps_x": ""}}, "objective 'energy' is not measured"),
        (
            {"diagnostics": dict.fromkeys(["eps_x", "energy"], "")},
            "constraint 'dE' is not measured",
        ),
        ({"units": {"K1": "mA"}}, "the unit of the variable 'K1' is 'A', but"),
        ({"diagnostics": DIAGNOSTICS | {"eps_x": "m rad"}}, "the unit of the objective 'eps_x'"),
    ],
)
def test_a_machine_that_cannot_play_the_problem_is_refused(
    facts: dict[str, Any], sentence: str
) -> None:
    problem = Problem.from_dict(MAPPING)
    MACHINE.check(problem)
    with pytest.raises(ProblemError, match=sentence):
        replace(MACHINE, **facts).check(problem)


def test_a_variable_that_is_open_has_no_bounds_to_compare() -> None:
    MACHINE.check(Problem.from_dict(changed("variables.K1", {"around": 20.0})))


def test_a_machine_takes_for_a_choice_what_the_problem_says() -> None:
    def problem(**choices: Any) -> Problem:
        return Problem.from_dict(changed("variables.K1", choices))

    machine = replace(MACHINE, limits=LIMITS | {"K1": (0.0, 2.0)})
    selector = replace(machine, words={"K1": {"foil": 1.0, "mesh": 2.0, "none": 0.0}})
    for facts in (machine, selector):
        facts.check(problem(choices=["none", "mesh"], values=[0, 2]))
    for wrong in ({"choices": ["none", "mesh"]}, {"choices": ["none", "wire"], "values": [0, 2]}):
        with pytest.raises(ProblemError, match="machine takes foil = 1, mesh = 2, none = 0"):
            selector.check(problem(**wrong))
