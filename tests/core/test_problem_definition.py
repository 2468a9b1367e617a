"""The definition of a problem: what is accepted, and what is refused with one sentence."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from mobo_tuner.core.problem import Problem, ProblemError
from mobo_tuner.errors import FileError
from mobo_tuner.files import load_yaml
from tests.core.problem_mapping import MAPPING, changed


@pytest.mark.parametrize(
    ("path", "value", "sentence"),
    [
        ("variabels", {}, "'variabels' is unknown"),
        ("variables", ..., "'variables' is missing or empty"),
        ("objectives", {}, "'objectives' is missing or empty"),
        ("objectives", [1], "'objectives' must be a mapping"),
        ("variables.K1", 3, "'variables.K1' must be a mapping"),
        ("variables.K1.steps", 3, "'steps' is unknown in variables.K1"),
        ("variables.K1.step", 0.0, "variables.K1.step is 0"),
        ("variables.K1.step", 700.0, "no multiple of the step 700"),
        ("variables.K1.step", 1e-9, "variables.K1.step is 1e-09, too fine"),
        ("variables.K1.choices", [450.0], "variables.K1.choices is \\[450.0\\]"),
        ("variables.K1.choices", "on", "variables.K1.choices must be a list of numbers"),
        ("variables.K1.choices", [1.0, 2.0], "no of its choices in between"),
        ("variables.K1.scale", "cubic", "variables.K1.scale is 'cubic'"),
        ("variables.phi.scale", "log", "variables.phi.min is -10; with scale log"),
        ("variables.K1.fixed", 300.0, "variables.K1.fixed is 300; 400 to 550"),
        ("variables.K1.fixed", "now", "variables.K1.fixed must be a number"),
        ("variables.K1.around", 0.0, "variables.K1.around is 0"),
        ("variables.K1.around", "10", "variables.K1.around is '10'"),
        ("variables.K1.around", "0 %", "variables.K1.around is '0 %'"),
        ("variables.K1", {"around": 1.0, "fixed": 2.0}, "variables.K1 has around and fixed"),
        ("variables.K1", {"around": 1.0, "min": 2.0, "max": 1.0}, "variables.K1.min is 2"),
        ("limits", {"s": {"K1": 1.0}}, "limits.s needs 'min', 'max' or both"),
        ("limits", {"s": {"K2": 1.0, "max": 1.0}}, "'K2' is unknown in limits.s"),
        ("limits", {"s": {"max": 1.0}}, "limits.s has no variable"),
        ("limits", {"s": {"K1": 1.0, "max": 300.0}}, "meets limits.s"),
        ("limits", {"s": {"K1": "1", "max": 450.0}}, "limits.s.K1 must be a number"),
        ("variables.K1.min", ..., "variables.K1.min is missing"),
        ("variables.K1.min", "low", "variables.K1.min must be a number, not the text 'low'"),
        ("variables.K1.min", True, "variables.K1.min must be a number, not a truth value"),
        ("variables.K1.min", math.nan, "variables.K1.min must be a finite number"),
        ("variables.K1.max", 10**400, "variables.K1.max must be a finite number"),
        ("variables.K1.min", 550, "variables.K1.min is 550, which must be less than its max"),
        (
            "constraints.dE.critical",
            "yes",
            "constraints.dE.critical must be true or false, not the",
        ),
        ("variables.K1.cost", -1, "variables.K1.cost is -1"),
        ("variables.K1.unit", 7, "variables.K1.unit must be text"),
        ("variables.K 1", {"min": 0, "max": 1}, "'K 1' in 'variables' is no name"),
        ("variables.K__1", {"min": 0, "max": 1}, "'K__1' in 'variables' is no name"),
        ("variables.eps_x", {"min": 0, "max": 1}, "'eps_x' is a variable and an objective"),
        ("objectives.energy.reference", ..., "objectives.energy.reference is missing"),
        ("objectives.eps_x.direction", "down", "'minimize' and 'maximize' are allowed"),
        ("objectives.energy.reference", 9.0, "outside its truncation box \\[10, 20\\]"),
        ("objectives.energy.truncation", [20, 10], "upside down"),
        ("objectives.energy.truncation", [1, 2, 3], "must be two numbers"),
        ("objectives.energy.truncation", "ab", "must be two numbers"),
        ("constraints.dE", {}, "constraints.dE needs 'min', 'max' or both"),
        ("constraints.transmission.min", 1.2, "must be less than its max"),
        ("observables.charge.min", 1, "'min' is unknown in observables.charge"),
        ("context", {"K1": {}}, "context.K1 is also in 'variables'"),
        ("context", {"eps_x": {}}, "context.eps_x is also in 'objectives'"),
        ("context", {"dE": {}}, "context.dE is also in 'constraints'"),
        ("context", {"charge": {"unit": "pC"}}, "context.charge.unit is 'pC'"),
        ("context", {"hall": {"min": 1.0}}, "context.hall.max is missing"),
        (
            "context",
            {"hall": {"min": 1.0, "max": 1.0}},
            "context.hall.min is 1, which must be less",
        ),
        ("context", {"hall": {"scale": 1.0}}, "'scale' is unknown in context.hall"),
    ],
)
def test_a_bad_problem_is_refused_in_one_sentence(path: str, value: Any, sentence: str) -> None:
    with pytest.raises(ProblemError, match=sentence) as error:
        Problem.from_dict(changed(path, value))
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("a: [1", "is not valid YAML in line"),
        ("variables: {K1: {min: 1, max: 2}, K1: {min: 0, max: 1}}", "'K1' stands twice"),
        ("- 1", "must hold a mapping"),
        ("", "must hold a mapping"),
        ("/**: 3", "must hold 'ros__parameters'"),
        ("/**: {ros__parameters: 3}", "must be a mapping"),
        ("a: !!python/object/apply:os.getcwd []", "is not valid YAML"),
    ],
)
def test_a_bad_file_is_refused_in_one_sentence(tmp_path: Path, text: str, sentence: str) -> None:
    path = tmp_path / "bad.yaml"
    path.write_text(text)
    with pytest.raises(ProblemError, match=sentence):
        Problem.from_yaml(path)


def test_a_file_that_cannot_be_read_is_named(tmp_path: Path) -> None:
    with pytest.raises(FileError, match="absent\\.yaml' cannot be read: No such file"):
        load_yaml(tmp_path / "absent.yaml")
    with pytest.raises(ProblemError, match="absent\\.yaml' cannot be read: No such file"):
        Problem.from_yaml(tmp_path / "absent.yaml")
    (tmp_path / "binary.yaml").write_bytes(b"\xff\xfe\x00\xd8")
    with pytest.raises(FileError, match="not UTF-8"):
        load_yaml(tmp_path / "binary.yaml")


def test_a_ros_parameter_file_and_the_bare_mapping_give_the_same(tmp_path: Path) -> None:
    (tmp_path / "ros.yaml").write_text(
        yaml.safe_dump(
            {"/**": {"ros__parameters": MAPPING}, "tuner": {"ros__parameters": {}}}, sort_keys=False
        )
    )
    (tmp_path / "bare.yaml").write_text(yaml.safe_dump(MAPPING, sort_keys=False))
    ros = Problem.from_yaml(tmp_path / "ros.yaml")
    assert ros == Problem.from_yaml(str(tmp_path / "bare.yaml")) == Problem.from_dict(MAPPING)


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


def test_a_limit_is_met_to_rounding() -> None:
    limits = {"total": {"K1": 1.0, "phi": -2.0, "min": 410.0, "max": 500.0}}
    problem = Problem.from_dict({**MAPPING, "limits": limits})
    [limit] = problem.limits
    assert limit.is_met({"K1": 500.0, "phi": 0.0})
    assert limit.is_met({"K1": 500.0 + 1e-10, "phi": 0.0})
    assert not limit.is_met({"K1": 500.0, "phi": -0.001})
    assert not limit.is_met({"K1": 405.0, "phi": -1.0})
    assert Problem.from_dict(problem.to_dict()) == problem
    x = np.random.default_rng(0).uniform(-1.0, 1.0, (500, 2))
    inside = [limit.is_met(problem.denormalize(row)) for row in x]
    assert problem.domain.contains(x).tolist() == inside
    assert 50 < sum(inside) < 450
