"""From the core's words to messages and back."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping

from builtin_interfaces.msg import Time

from mobo_msgs_py import msg
from mobo_msgs_py.srv import DescribeMachine
from mobo_tuner.core.dataset import Evaluation
from mobo_tuner.core.problem import Constraint, Objective, Observable, Problem, Variable


def seconds(stamp: Time) -> float:
    """A stamp as seconds since the epoch."""
    return stamp.sec + 1e-9 * stamp.nanosec


def named_values(
    values: Mapping[str, float],
    units: Mapping[str, str],
    stddevs: Mapping[str, float] | None = None,
) -> list[msg.NamedValue]:
    """Named values in the order of `values`; an unknown standard deviation is NaN."""
    return [
        msg.NamedValue(
            name=name,
            value=float(value),
            stddev=float((stddevs or {}).get(name, math.nan)),
            unit=units.get(name, ""),
        )
        for name, value in values.items()
    ]


def values_of(named: Iterable[msg.NamedValue]) -> dict[str, float]:
    """Values by name."""
    return {item.name: item.value for item in named}


def measurements_of(named: Iterable[msg.NamedValue]) -> dict[str, tuple[float, float]]:
    """Pairs (mean, standard deviation) by name, as `Optimizer.tell` takes them."""
    return {item.name: (item.value, item.stddev) for item in named}


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
    """The Pareto front as `Optimizer.pareto_front` gives it."""
    units = problem_units(problem)
    return msg.ParetoFront(
        stamp=stamp,
        run_id=run_id,
        points=[
            msg.ParetoPoint(
                index=point["index"],
                setpoint=named_values(point["setpoint"], units),
                objectives=named_values(point["objectives"], units),
            )
            for point in front
        ],
        reference_point=named_values({o.name: o.reference for o in problem.objectives}, units),
        hypervolume=hypervolume,
    )
