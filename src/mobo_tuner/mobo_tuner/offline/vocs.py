"""A problem as the VOCS of gest-api, which Xopt, libEnsemble and optimas read, and back."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from gest_api.vocs import (
    VOCS,
    BaseConstraint,
    BaseObjective,
    BaseVariable,
    BoundsConstraint,
    ContextualVariable,
    ContinuousVariable,
    DiscreteVariable,
    GreaterThanConstraint,
    LessThanConstraint,
    MaximizeObjective,
    MinimizeObjective,
)

from mobo_tuner.core import Problem, ProblemError
from mobo_tuner.core.values import describe

_DIRECTIONS = {MinimizeObjective: "minimize", MaximizeObjective: "maximize"}


def problem_of(vocs: VOCS, references: Mapping[str, float] = {}) -> Problem:
    """Return the problem that a VOCS defines.

    Args:
        vocs: Variables, objectives, constraints and observables. Constants are no part of a problem, nor are
            observables that are not a number each, such as texts.
        references: Reference point by objective, which a VOCS lacks; those left out are inferred from
            what is measured.

    Raises:
        ProblemError: If it is no VOCS or has something that a problem cannot have, a reference is not of
            one of its objectives, or a constant has the name of something else.
    """
    if not isinstance(vocs, VOCS):
        raise ProblemError(f"vocs must be a VOCS or a Problem, not {describe(vocs)}")
    if not isinstance(references, Mapping):
        raise ProblemError(f"references must be a mapping of names, not {describe(references)}")
    for name in references:
        if name not in vocs.objectives:
            raise ProblemError(
                f"a reference is given for '{name}'; allowed are {', '.join(vocs.objective_names)}"
            )
    others = {*vocs.variables, *vocs.objectives, *vocs.constraints, *vocs.observables}
    for name in vocs.constants:
        if name in others:  # in a point it would stand in the place of the other
            raise ProblemError(
                f"'{name}' is a constant and something else: a name can stand for one quantity only"
            )
    return Problem.from_dict(
        {
            "variables": {n: _variable(n, v) for n, v in vocs.variables.items()},
            "objectives": {
                name: _objective(name, objective)
                | ({"reference": references[name]} if name in references else {})
                for name, objective in vocs.objectives.items()
            },
            "constraints": {n: _constraint(n, c) for n, c in vocs.constraints.items()},
            "observables": {
                name: {}
                for name, observable in vocs.observables.items()
                if name not in vocs.objectives
                and name not in vocs.constraints
                and np.dtype(observable.dtype).kind in "fiu"  # None is a float
            },
        }
    )


def vocs_of(problem: Problem) -> VOCS:
    """Return the VOCS of a problem.

    It lacks what a VOCS cannot say: units, costs, the reference point, the truncation box, scales,
    formulas and limits between variables. A fixed variable becomes a constant, one of the fidelity a
    variable, and what a derived quantity is made of an observable.
    """
    variables: dict[str, Any] = {}
    constants = {}
    fidelities = problem.fidelity.variables if problem.fidelity else ()
    for variable in (*problem.variables, *fidelities):
        values = variable.values
        if variable.fixed is not None:
            constants[variable.name] = variable.fixed
        elif values is not None:
            variables[variable.name] = set(values.tolist())
        else:
            variables[variable.name] = [variable.minimum, variable.maximum]
    constraints: dict[str, list[Any]] = {}
    for constraint in problem.constraints:
        if math.isinf(constraint.minimum):
            constraints[constraint.name] = ["LESS_THAN", constraint.maximum]
        elif math.isinf(constraint.maximum):
            constraints[constraint.name] = ["GREATER_THAN", constraint.minimum]
        else:
            constraints[constraint.name] = ["BOUNDS", constraint.minimum, constraint.maximum]
    return VOCS(
        variables=variables,
        objectives={o.name: o.direction.upper() for o in problem.objectives},
        constraints=constraints,
        constants=constants,
        observables=[n for n in measured_names(problem) if n not in problem.required_diagnostics],
    )


def measured_names(problem: Problem) -> tuple[str, ...]:
    """Return the names of all that may be measured, those of derived quantities included."""
    observables = (o.name for o in problem.observables)
    required = (*problem.required_diagnostics, *problem.measured_diagnostics)
    return tuple(dict.fromkeys([*required, *observables]))


def _variable(name: str, variable: BaseVariable) -> dict[str, Any]:
    if isinstance(variable, DiscreteVariable):
        return {"choices": sorted(variable.values, key=lambda v: (isinstance(v, str), v))}
    if isinstance(variable, ContinuousVariable) and not isinstance(variable, ContextualVariable):
        return {"min": variable.domain[0], "max": variable.domain[1]}
    raise ProblemError(
        f"variable '{name}' is a {type(variable).__name__}; continuous and discrete ones are allowed"
    )


def _objective(name: str, objective: BaseObjective) -> dict[str, Any]:
    direction = _DIRECTIONS.get(type(objective))
    if direction is None:
        raise ProblemError(
            f"objective '{name}' is a {type(objective).__name__}; it can be minimised or maximised"
        )
    return {"direction": direction}


def _constraint(name: str, constraint: BaseConstraint) -> dict[str, Any]:
    if isinstance(constraint, LessThanConstraint):
        return {"max": constraint.value}
    if isinstance(constraint, GreaterThanConstraint):
        return {"min": constraint.value}
    if isinstance(constraint, BoundsConstraint):
        return {"min": constraint.range[0], "max": constraint.range[1]}
    raise ProblemError(
        f"constraint '{name}' is a {type(constraint).__name__}; less than, greater than and bounds "
        "are allowed"
    )
