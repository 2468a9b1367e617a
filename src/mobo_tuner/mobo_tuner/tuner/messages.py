"""The problem, its evaluations and its front as messages."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping

from builtin_interfaces.msg import Time

from mobo_msgs_py import msg
from mobo_msgs_py.srv import DescribeMachine
from mobo_tuner.core.dataset import Evaluation
from mobo_tuner.core.problem import Constraint, Objective, Observable, Problem, Variable
from mobo_tuner.ros.conversions import named_values


def machine_facts(
    machine: DescribeMachine.Response,
) -> tuple[dict[str, tuple[float, float]], dict[str, str], dict[str, str]]:
    """What a machine says of itself, as `Problem.check_machine` takes it."""
    return (
        {v.name: (v.min, v.max) for v in machine.variables},
        {d.name: d.unit for d in machine.diagnostics},
        {v.name: v.unit for v in machine.variables},
    )


def problem_units(problem: Problem) -> dict[str, str]:
    """The unit of every quantity that the problem names."""
    quantities: tuple[Constraint | Observable | Objective | Variable, ...] = (
        *problem.constraints,
        *problem.observables,
        *problem.objectives,
        *problem.variables,
    )
    return {quantity.name: quantity.unit for quantity in quantities if quantity.unit}


def constraint_messages(problem: Problem, critical_only: bool = False) -> list[msg.Constraint]:
    """The problem's constraints, or the critical ones among them."""
    units = problem_units(problem)
    return [
        msg.Constraint(
            name=c.name,
            unit=units.get(c.name, ""),
            min=c.minimum,
            max=c.maximum,
            critical=c.critical,
        )
        for c in problem.constraints
        if c.critical or not critical_only
    ]


def problem_message(problem: Problem, run_id: str, stamp: Time) -> msg.Problem:
    """The problem of a run, as it is published."""
    return msg.Problem(
        stamp=stamp,
        run_id=run_id,
        variables=[
            msg.Variable(name=v.name, unit=v.unit, min=v.minimum, max=v.maximum, cost=v.cost)
            for v in problem.variables
        ],
        objectives=[
            msg.Objective(
                name=o.name,
                unit=o.unit,
                direction=(
                    msg.Objective.MINIMIZE if o.direction == "minimize" else msg.Objective.MAXIMIZE
                ),
                reference=o.reference,
                truncated=o.truncation is not None,
                truncation_min=o.truncation[0] if o.truncation else math.nan,
                truncation_max=o.truncation[1] if o.truncation else math.nan,
            )
            for o in problem.objectives
        ],
        constraints=constraint_messages(problem),
        observables=[msg.Observable(name=o.name, unit=o.unit) for o in problem.observables],
    )


def evaluation_message(
    problem: Problem, evaluation: Evaluation, run_id: str, stamp: Time
) -> msg.Evaluation:
    """An evaluation as the core knows it; what only the node knows stays at its default."""
    units = problem_units(problem)
    return msg.Evaluation(
        stamp=stamp,
        run_id=run_id,
        index=evaluation.index,
        setpoint=named_values(evaluation.setpoint, units),
        diagnostics=named_values(evaluation.values, units, evaluation.stddevs),
        objectives=[
            msg.NamedValue(
                name=o.name,
                value=evaluation.values.get(o.name, math.nan),
                stddev=evaluation.stddevs.get(o.name, math.nan),
                unit=o.unit,
            )
            for o in problem.objectives
        ],
        valid=evaluation.valid,
        feasible=evaluation.feasible,
    )


def front_message(
    problem: Problem, front: Iterable[Mapping], hypervolume: float, run_id: str, stamp: Time
) -> msg.ParetoFront:
    """The front as `Optimizer.pareto_front` or `predicted_front` gives it."""
    units = problem_units(problem)
    return msg.ParetoFront(
        stamp=stamp,
        run_id=run_id,
        points=[
            msg.ParetoPoint(
                index=point.get("index", 0),
                setpoint=named_values(point["setpoint"], units),
                objectives=named_values(point["objectives"], units, point.get("stddevs")),
            )
            for point in front
        ],
        reference_point=named_values({o.name: o.reference for o in problem.objectives}, units),
        hypervolume=hypervolume,
    )
