"""The problem: what is accepted, what is refused and in which words, and the scaling."""

from __future__ import annotations

import copy
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from mobo_tuner.core.problem import Problem, ProblemError
from mobo_tuner.errors import FileError
from mobo_tuner.files import load_yaml

MAPPING: dict[str, Any] = {
    "variables": {
        "K1": {"min": 400.0, "max": 550, "unit": "A", "cost": 2.0},
        "phi": {"min": -10, "max": 0},
    },
    "objectives": {
        "eps_x": {"direction": "minimize", "reference": 150.0, "unit": "mm mrad"},
        "energy": {"direction": "maximize", "reference": 12.0, "truncation": [10.0, 20.0]},
    },
    "constraints": {
        "dE": {"max": 0.52, "critical": True},
        "transmission": {"min": 0.98, "max": 1.1},
    },
    "observables": {"charge": {"unit": "nC"}},
}


def changed(path: str, value: Any) -> dict[str, Any]:
    """The mapping with one value replaced, added, or removed where it is `...`."""
    mapping = copy.deepcopy(MAPPING)
    *parents, leaf = path.split(".")
    branch = mapping
    for key in parents:
        branch = branch[key]
    if value is ...:
        del branch[leaf]
    else:
        branch[leaf] = value
    return mapping


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


def test_a_ros_parameter_file_and_the_bare_mapping_give_the_same(tmp_path: Path) -> None:
    (tmp_path / "ros.yaml").write_text(
        yaml.safe_dump(
            {"/**": {"ros__parameters": MAPPING}, "tuner": {"ros__parameters": {}}}, sort_keys=False
        )
    )
    (tmp_path / "bare.yaml").write_text(yaml.safe_dump(MAPPING, sort_keys=False))
    ros = Problem.from_yaml(tmp_path / "ros.yaml")
    assert ros == Problem.from_yaml(str(tmp_path / "bare.yaml")) == Problem.from_dict(MAPPING)


@pytest.mark.parametrize(
    ("path", "value", "sentence"),
    [
        ("variabels", {}, "'variabels' is unknown"),
        ("variables", ..., "'variables' is missing or empty"),
        ("objectives", {}, "'objectives' is missing or empty"),
        ("objectives", [1], "'objectives' must be a mapping"),
        ("variables.K1", 3, "'variables.K1' must be a mapping"),
        ("variables.K1.step", 3, "'step' is unknown in variables.K1"),
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
