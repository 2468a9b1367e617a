"""The problem: its quantities, the scaling, and which machine suits it."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mobo_tuner.core.problem import Problem, ProblemError
from tests.core.problem_mapping import MAPPING


def test_a_problem_keeps_what_it_was_given() -> None:
    problem = Problem.from_dict(MAPPING)
    assert problem.variable_names == ("K1", "phi")
    assert problem.objective_names == ("eps_x", "energy")
    assert problem.variables[0].cost == 2.0
    assert problem.variables[1].unit == ""
    assert problem.constraints[0].minimum == -math.inf
    assert [c.critical for c in problem.constraints] == [True, False]
    assert problem.required_diagnostics == ("eps_x", "energy", "dE", "transmission")
    assert Problem.from_dict(problem.to_dict()) == problem


def test_a_maximised_objective_is_turned_round() -> None:
    problem = Problem.from_dict(MAPPING)
    np.testing.assert_array_equal(problem.reference_point, [150.0, -12.0])
    np.testing.assert_array_equal(problem.truncation_lower, [-math.inf, -20.0])


@given(st.lists(st.floats(-1.0, 1.0), min_size=2, max_size=2))
def test_scaling_there_and_back_stays_inside_the_bounds(x: list[float]) -> None:
    problem = Problem.from_dict(MAPPING)
    setpoint = problem.denormalize(np.array(x))
    assert 400.0 <= setpoint["K1"] <= 550.0
    assert -10.0 <= setpoint["phi"] <= 0.0
    np.testing.assert_allclose(problem.normalize(setpoint), x, atol=1e-12)


@pytest.mark.parametrize(
    ("setpoint", "sentence"),
    [
        ({"K1": 450.0}, "lacks the variable 'phi'"),
        ({"K1": 450.0, "phi": -1.0, "K9": 1.0}, "'K9' is unknown in the set-point"),
        ({"K1": math.inf, "phi": -1.0}, "set-point K1 must be a finite number"),
    ],
)
def test_a_bad_setpoint_is_refused(setpoint: dict[str, float], sentence: str) -> None:
    with pytest.raises(ProblemError, match=sentence):
        Problem.from_dict(MAPPING).normalize(setpoint)


LIMITS = {"K1": (350.0, 600.0), "phi": (-20.0, 20.0)}
DIAGNOSTICS = dict.fromkeys(["eps_x", "energy", "dE", "transmission", "charge"], "")


@pytest.mark.parametrize(
    ("limits", "diagnostics", "units", "sentence"),
    [
        ({"phi": (-20, 20)}, DIAGNOSTICS, {}, "variable 'K1' is not one of the machine's"),
        (LIMITS | {"K1": (410, 600)}, DIAGNOSTICS, {}, "variables.K1.min is 400 A, outside the"),
        (LIMITS | {"phi": (-20, -5)}, DIAGNOSTICS, {}, "variables.phi.max is 0, outside the"),
        (LIMITS | {"G1": (0, 1)}, DIAGNOSTICS, {}, "'G1' is missing from 'variables'"),
        (LIMITS, {"eps_x": ""}, {}, "objective 'energy' is not measured"),
        (LIMITS, dict.fromkeys(["eps_x", "energy"], ""), {}, "constraint 'dE' is not measured"),
        (LIMITS, DIAGNOSTICS, {"K1": "mA"}, "the unit of the variable 'K1' is 'A', but"),
        (LIMITS, DIAGNOSTICS | {"eps_x": "m rad"}, {}, "the unit of the objective 'eps_x'"),
    ],
)
def test_a_machine_that_cannot_play_the_problem_is_refused(
    limits: dict[str, tuple[float, float]],
    diagnostics: dict[str, str],
    units: dict[str, str],
    sentence: str,
) -> None:
    problem = Problem.from_dict(MAPPING)
    problem.check_machine(LIMITS, DIAGNOSTICS, {})
    with pytest.raises(ProblemError, match=sentence):
        problem.check_machine(limits, diagnostics, units)
