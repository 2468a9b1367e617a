"""The problem: its quantities, the scaling, and where its open bounds are."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mobo_tuner.core import Optimizer
from mobo_tuner.core.problem import Problem, ProblemError
from tests.core.problem_mapping import MAPPING, changed


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


def open_problem(**entry: Any) -> Problem:
    return Problem.from_dict({**MAPPING, "variables": {**MAPPING["variables"], "K1": entry}})


@pytest.mark.parametrize(
    ("entry", "present", "bounds"),
    [
        ({"around": 20.0}, 450.0, (430.0, 470.0)),
        ({"around": "10 %"}, 450.0, (425.0, 475.0)),  # of 350 to 600
        ({"around": "10%", "max": 460.0}, 450.0, (425.0, 460.0)),
        ({"around": 20.0}, 355.0, (350.0, 375.0)),  # the machine's limit is a wall
        ({"around": 20.0}, 349.9, (350.0, 370.0)),
        ({"around": 20.0, "min": 345.0, "step": 5.0}, 450.0, (430.0, 470.0)),
    ],
)
def test_bounds_around_where_the_machine_is(
    entry: dict[str, Any], present: float, bounds: tuple[float, float]
) -> None:
    problem = open_problem(**entry)
    assert problem.open_variables == ("K1",)
    assert Problem.from_dict(problem.to_dict()) == problem
    resolved = problem.resolved({"K1": present, "phi": 1.0}, LIMITS)
    k1, phi = resolved.variables
    assert (k1.minimum, k1.maximum) == pytest.approx(bounds)
    assert phi == problem.variables[1]
    assert resolved.open_variables == ()
    assert problem.resolved_as(resolved) == resolved == Problem.from_dict(resolved.to_dict())


def test_a_share_of_the_range_works_where_the_machine_is_at_zero() -> None:
    problem = Problem.from_dict(changed("variables.phi", {"around": "25 %"}))
    phi = problem.resolved({"phi": 0.0}, {"phi": (-20.0, 20.0)}).variables[1]
    assert (phi.minimum, phi.maximum) == (-10.0, 10.0)


@pytest.mark.parametrize(
    ("entry", "present", "fixed"),
    [
        ({}, 452.3, 452.3),
        ({"step": 0.5}, 452.3, 452.5),
        ({"step": 1e-5}, 452.300003, 452.3),  # too fine for a range, but there is none
        ({"step": 40.0}, 600.0, 600.0),
        ({"step": 42.0}, 599.0, 588.0),  # the nearest multiple is beyond the machine's limit
        ({"choices": [400.0, 450.0]}, 452.3, 450.0),
    ],
)
def test_a_variable_is_fixed_where_the_machine_is(
    entry: dict[str, Any], present: float, fixed: float
) -> None:
    problem = open_problem(fixed="present", **entry)
    k1 = problem.resolved({"K1": present}, LIMITS).variables[0]
    assert (k1.fixed, k1.at_present) == (fixed, False)


def test_an_open_problem_needs_to_know_where_the_machine_is() -> None:
    problem = open_problem(around=20.0)
    with pytest.raises(ProblemError, match="bounds of K1 depend on where the machine is"):
        Optimizer(problem)
    for present, limits in (({}, LIMITS), ({"K1": math.nan}, LIMITS), ({"K1": 450.0}, {})):
        with pytest.raises(ProblemError, match="'K1'"):
            problem.resolved(present, limits)
    with pytest.raises(ProblemError, match=r"variables\.K1\.min"):  # nothing is left
        open_problem(around=20.0, min=500.0).resolved({"K1": 400.0}, LIMITS)
