"""The definition of a variable; what is refused is in test_problem_definition.py."""

from __future__ import annotations

from typing import Any

import pytest

from mobo_tuner.core.problem import Problem, ProblemError
from tests.core.problem_mapping import MAPPING


def test_a_variable_has_a_grid_choices_a_scale_or_one_value() -> None:
    variables = {
        "step": {"min": 0.25, "max": 1.05, "step": 0.1},
        "narrow": {"min": -1.0, "max": 4.0, "choices": [5.0, 2.0, -3.0, 0.5]},
        "choices": {"choices": [3.0, 1.0, 2.0, 1.0]},
        "fixed": {"fixed": 20.0, "unit": "A"},
        "log": {"min": 0.01, "max": 100.0, "scale": "log"},
    }
    problem = Problem.from_dict({"variables": variables, "objectives": {"f": {"reference": 1.0}}})
    step, narrow, choices, fixed, log = problem.variables
    assert step.values is not None
    assert step.values.tolist() == [0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 1.0]
    assert narrow.values is not None
    assert narrow.values.tolist() == [0.5, 2.0]
    assert (choices.minimum, choices.maximum, choices.choices) == (1.0, 3.0, (1.0, 2.0, 3.0))
    assert (fixed.fixed, fixed.denormalize(-1.0), fixed.denormalize(1.0)) == (20.0, 20.0, 20.0)
    assert [log.denormalize(x) for x in (-1.0, -0.5, 0.0, 1.0)] == pytest.approx(
        [0.01, 0.1, 1.0, 100.0]
    )
    assert log.normalize(10.0) == pytest.approx(0.5)
    assert Problem.from_dict(problem.to_dict()) == problem


def test_choices_without_an_order_have_names() -> None:
    variables: dict[str, Any] = {
        "target": {"choices": ["foil", "mesh", "none"], "values": [3, 1, 2], "fixed": "mesh"},
        "screen": {"choices": ["in", "out"]},
    }
    problem = Problem.from_dict({**MAPPING, "variables": variables})
    assert Problem.from_dict(problem.to_dict()) == problem
    target, screen = problem.variables
    assert target.choices == (1.0, 2.0, 3.0)
    assert target.choice_names == ("mesh", "none", "foil")
    assert target.fixed == 1.0
    assert screen.choices == (0.0, 1.0)
    assert problem.chosen({"target": 3.0, "screen": 0.0}) == {"target": "foil", "screen": "in"}
    for section in ("limits", "derived"):
        entry = {"target": 1.0, "max": 2.0} if section == "limits" else {"formula": "target + 1"}
        with pytest.raises(ProblemError, match="whose choices are names"):
            Problem.from_dict({**MAPPING, "variables": variables, section: {"s": entry}})
