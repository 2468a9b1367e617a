"""The problem as parameters of a node: what is unset, and that a dump can be loaded."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from functools import partial
from typing import Any

import pytest
from rclpy.context import Context
from rclpy.node import Node
from rclpy.parameter import Parameter

from mobo_tuner.core import Problem, ProblemError
from mobo_tuner.core.problem import SECTIONS
from mobo_tuner.tuner.problem_parameters import QUANTITY_PARAMETERS, ProblemParameters

GIVEN: dict[str, Any] = {
    "variables.x.min": 0.0,
    "variables.x.max": 1.0,
    "objectives.f.reference": 2.0,
    "objectives.f.truncation": [0.5, 2.0],
    "constraints.g.max": 3.0,
}


OBJECTIVE = {"objectives.f.reference": 2.0}
Start = Callable[[dict[str, Any]], Node]


@pytest.fixture
def start(context: Context) -> Iterator[Start]:
    """Make a node with parameters."""
    nodes: list[Node] = []

    def make(values: dict[str, Any]) -> Node:
        overrides = [Parameter(name, value=value) for name, value in values.items()]
        nodes.append(
            Node(
                f"tuner{len(nodes)}",
                context=context,
                automatically_declare_parameters_from_overrides=True,
                parameter_overrides=overrides,
            )
        )
        return nodes[-1]

    yield make
    for node in nodes:
        node.destroy_node()


def test_what_is_dumped_makes_the_same_problem(start: Start) -> None:
    first = start(GIVEN)
    problem = ProblemParameters(first).problem
    declared: Mapping[str, Any] = first.get_parameters_by_prefix("")
    dump = {
        name: "null" if parameter.value is None else parameter.value
        for name, parameter in declared.items()
        if name.split(".")[0] in ("variables", "objectives", "constraints")
    }
    assert dump["constraints.g.min"] == "null"
    assert ProblemParameters(start(dump)).problem == problem


def test_null_unsets_what_is_optional(start: Start) -> None:
    parameters = ProblemParameters(start(GIVEN))
    free = {name: value for name, value in GIVEN.items() if "truncation" not in name}
    without = ProblemParameters(start(free)).problem
    assert parameters.problem != without
    parameters.accept({"objectives.f.truncation": "null"})
    assert parameters.problem == without
    parameters.accept({"objectives.f.truncation": [0.5, 2.0]})
    assert parameters.problem.objectives[0].truncation == (0.5, 2.0)
    for name, value in (("variables.x.min", "null"), ("objectives.f.truncation", None)):
        with pytest.raises(ProblemError, match=name.split(".")[-1]):
            parameters.with_changes({name: value})
    assert isinstance(parameters.problem, Problem)


def test_unsetting_all_of_a_quantity_does_not_remove_it(start: Start) -> None:
    parameters = ProblemParameters(start(GIVEN))
    parameters.accept({"objectives.f.truncation": "null", "objectives.f.reference": "null"})
    assert [objective.name for objective in parameters.problem.objectives] == ["f"]
    with pytest.raises(ProblemError, match=r"constraints\.g"):
        parameters.with_changes({"constraints.g.max": "null"})


@pytest.mark.parametrize("section", SECTIONS)
def test_the_table_of_parameters_is_what_a_problem_accepts(section: str) -> None:
    problem: dict[str, Any] = {
        "variables": {"VARIABLE": {"min": 0.0, "max": 1.0}},
        "objectives": {"f": {"reference": 1.0}},
    }
    problem.setdefault(section, {})["q"] = {"unknown": 1.0}
    with pytest.raises(ProblemError) as error:
        Problem.from_dict(problem)
    accepted = str(error.value).split("allowed are ")[1].split(", ")
    documented = [p.leaf for p in QUANTITY_PARAMETERS if p.section == section]
    assert sorted(documented) == sorted(accepted)


def test_what_was_resolved_holds_after_changes(start: Start) -> None:
    parameters = ProblemParameters(start({"variables.x.around": "10 %", **OBJECTIVE}))
    assert parameters.open_variables == ("x",)
    for present, bounds in ((0.5, (0.4, 0.6)), (0.95, (0.85, 1.0))):
        parameters.resolve(
            partial(Problem.resolved, present={"x": present}, limits={"x": (0.0, 1.0)})
        )
        [x] = parameters.problem.variables
        assert (x.minimum, x.maximum) == pytest.approx(bounds)
    parameters.accept({"variables.x.min": 0.9})
    [x] = parameters.problem.variables
    assert (x.minimum, x.maximum) == pytest.approx((0.9, 1.0))
    assert parameters.open_variables == ("x",)  # for the next run
