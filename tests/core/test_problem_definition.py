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
from mobo_tuner.names import topic_token
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
        ("variables.K 1", {"min": 0, "max": 1}, "'K 1' in 'variables' is not a valid name"),
        ("variables.K1:", {"min": 0, "max": 1}, "'K1:' in 'variables' is not a valid name"),
        ("variables." + "K" * 201, {"min": 0, "max": 1}, "in 'variables' is not a valid name"),
        ("limits", {"a.b": {"K1": 1.0, "max": 450.0}}, "'a.b' in 'limits' is not a valid name"),
        ("observables", {"B:X": {}, "B.X": {}}, "'B.X' and 'B:X' would share the topic plot/B_X"),
        ("variables.K1", {"choices": ["a", "b"], "min": 0}, "K1.min is given, but its choices are"),
        ("variables.K1", {"choices": ["a", True]}, "K1.choices has names and a truth value"),
        ("variables.K1", {"choices": ["a", "a"]}, "at least two different names are allowed"),
        ("variables.K1", {"choices": ["a", "present"]}, "two different names are allowed"),
        ("variables.K1", {"choices": ["a", "b"], "values": [1, 1]}, "2 different numbers"),
        ("variables.K1", {"choices": ["a", "b"], "fixed": "c"}, "is 'c'; allowed are a, b"),
        ("variables.K1.values", [1, 2], "variables.K1.values is given without choices"),
        ("variables.K1", {"choices": [1, 2], "values": [1, 2]}, "but its choices are numbers"),
        ("objectives.eps_x", {"reference": 3.0, "goal": 4.0}, "goal is 4, which must be less"),
        ("objectives.energy.goal", 15.0, "energy has a goal and a truncation box"),
        ("variables.eps_x", {"min": 0, "max": 1}, "'eps_x' is a variable and an objective"),
        (
            "constraints.K1",
            {"max": 500},
            "'K1' is a variable and an .*, constraint .* its min and max",
        ),
        ("objectives.energy.reference", ..., "objectives.energy.reference is missing"),
        ("objectives.eps_x.direction", "down", "'minimize' and 'maximize' are allowed"),
        ("objectives.energy.reference", 9.0, "outside its truncation box \\[10, 20\\]"),
        ("objectives.energy.truncation", [20, 10], "upside down"),
        (
            "objectives.energy.reference",
            20.0,
            "energy.reference is 20, the best end of its truncation",
        ),
        (
            "objectives.eps_x",
            {"reference": 0.0, "truncation": [0.0, 3.0]},
            "eps_x.reference is 0, the best end of its truncation box \\[0, 3\\]",
        ),
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


def test_names_are_those_of_the_laboratory() -> None:
    longest = "P" * 200
    mapping = {
        "variables": {"LI20:QUAD:Q1:BCTRL": {"min": 0.0, "max": 1.0}, "18ID:m-1": {"fixed": 2.0}},
        "objectives": {"beam.sigma/x": {"reference": 3.0}, longest: {}},
        "derived": {"a.b": {"formula": "`beam.sigma/x` / `LI20:QUAD:Q1:BCTRL` + `18ID:m-1` * pi"}},
        "constraints": {"a.b": {"max": 9.0}},
        "limits": {"sum": {"LI20:QUAD:Q1:BCTRL": 1.0, "max": 0.5}},
    }
    problem = Problem.from_dict(mapping)
    assert Problem.from_dict(problem.to_dict()) == problem
    assert problem.derived[0].names == ("beam.sigma/x", "LI20:QUAD:Q1:BCTRL", "18ID:m-1")
    where = {"LI20:QUAD:Q1:BCTRL": 0.5, "18ID:m-1": 2.0}
    derived = problem.derive(where, {"beam.sigma/x": (1.0, 0.1)})
    assert derived["a.b"].value == pytest.approx(2.0 + 2.0 * math.pi)
    assert derived["a.b"].stddev == pytest.approx(0.2)
    assert not problem.limits[0].is_met({**where, "LI20:QUAD:Q1:BCTRL": 0.6})
    tokens = [topic_token(name) for name in (longest, longest + "x", "K1", "18ID:m-1", "K__1")]
    assert tokens[2:] == ["K1", "n18ID_m_1", "K_1"]
    assert len({*tokens}) == 5
    assert all(len(token) <= 100 for token in tokens)


def test_a_goal_is_a_side_of_the_truncation_box() -> None:
    objectives = {
        "eps_x": {"reference": 50.0, "goal": 20.0},
        "energy": {"direction": "maximize", "reference": 10.0, "goal": 16.0},
        "dE": {"goal": 0.1},
    }
    problem = Problem.from_dict({**MAPPING, "objectives": objectives})
    assert Problem.from_dict(problem.to_dict()) == problem
    assert [o.truncation for o in problem.objectives] == [
        (20.0, 50.0),
        (10.0, 16.0),
        (0.1, math.inf),
    ]
    assert problem.truncation_lower.tolist() == [20.0, -16.0, 0.1]
    # All readings are better than the goal: the reference is still worse than it.
    readings = np.array([[30.0, -12.0, 0.02], [25.0, -13.0, 0.04]])
    every = np.ones(2, dtype=bool)
    third = problem.with_references(readings, every, every, 2).objectives[2]
    assert third.truncation == (0.1, third.reference)
    assert third.reference == pytest.approx(0.102)
