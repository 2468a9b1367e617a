"""The problem, the evaluations and the front of a run as messages."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from itertools import zip_longest

from builtin_interfaces.msg import Time
from std_msgs.msg import Header

from mobo_msgs_py import msg
from mobo_msgs_py.srv import DescribeMachine
from mobo_tuner.core.machine_facts import MachineFacts
from mobo_tuner.core.problem import Limit, Problem
from mobo_tuner.ros.conversions import named_values
from mobo_tuner.runs.records import SCALES, EvaluationRecord, MessageClasses, to_message

_CLASSES = MessageClasses(msg.Evaluation, msg.NamedValue, Header, Time)


def machine_facts(machine: DescribeMachine.Response) -> MachineFacts:
    """Return what a machine says of itself."""
    return MachineFacts(
        {v.name: (v.min, v.max) for v in machine.variables},
        {d.name: d.unit for d in machine.diagnostics},
        {v.name: v.unit for v in machine.variables},
        {
            v.name: {choice.name: choice.value for choice in v.choices}
            for v in machine.variables
            if any(choice.name for choice in v.choices)
        },
    )


def constraint_messages(problem: Problem, critical_only: bool = False) -> list[msg.Constraint]:
    """Return the constraints of a problem, or only the critical ones."""
    units = problem.units
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


def limit_messages(limits: Iterable[Limit]) -> list[msg.Limit]:
    """Return limits on sums of variables as messages."""
    return [
        msg.Limit(
            name=limit.name,
            coefficients=named_values(dict(limit.coefficients), {}),
            min=limit.minimum,
            max=limit.maximum,
        )
        for limit in limits
    ]


def problem_message(problem: Problem, run_id: str, stamp: Time) -> msg.Problem:
    """Return the problem of a run as its message."""
    return msg.Problem(
        header=Header(stamp=stamp),
        run_id=run_id,
        variables=[
            msg.Variable(
                name=v.name,
                unit=v.unit,
                min=v.minimum,
                max=v.maximum,
                cost=v.cost,
                step=v.step,
                choices=[
                    msg.NamedValue(name=name, value=value, unit=v.unit)
                    for value, name in zip_longest(v.choices, v.choice_names, fillvalue="")
                ],
                scale=SCALES.index(v.scale),
                fixed=v.fixed is not None,
                fixed_value=math.nan if v.fixed is None else v.fixed,
                approach=v.approach,
            )
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
                has_goal=o.goal is not None,
            )
            for o in problem.objectives
        ],
        constraints=constraint_messages(problem),
        observables=[msg.Observable(name=o.name, unit=o.unit) for o in problem.observables],
        limits=limit_messages(problem.limits),
        contexts=[
            msg.Context(name=c.name, unit=c.unit, min=c.minimum, max=c.maximum)
            for c in problem.context
        ],
    )


def evaluation_message(problem: Problem, record: EvaluationRecord, run_id: str) -> msg.Evaluation:
    """Return an evaluation of a run as its message."""
    return to_message(record, problem, run_id, _CLASSES)


def run_records_message(records: str, run_id: str, stamp: Time) -> msg.RunRecords:
    """Return how a run was set up and changed as its message."""
    return msg.RunRecords(header=Header(stamp=stamp), run_id=run_id, records=records)


def evaluated_point(problem: Problem, record: EvaluationRecord) -> msg.ParetoPoint:
    """Return an evaluation as a point, with the objectives that were measured."""
    measured = {
        name: record.diagnostics[name]
        for name in problem.objective_names
        if math.isfinite(record.diagnostics.get(name, (math.nan, math.nan))[0])
    }
    return msg.ParetoPoint(
        index=record.index,
        setpoint=named_values(record.setpoint, problem.units),
        objectives=named_values(
            {name: mean for name, (mean, _) in measured.items()},
            problem.units,
            {name: stddev for name, (_, stddev) in measured.items()},
        ),
    )


def front_message(
    problem: Problem,
    front: Iterable[Mapping],
    hypervolumes: tuple[float, float],
    run_id: str,
    stamp: Time,
) -> msg.ParetoFront:
    """Return a front, as `Optimizer.pareto_front` or `predicted_front` gives it, as its message.

    Args:
        problem: Problem of the run.
        front: Points of the front.
        hypervolumes: Hypervolume of the front and that of the complete readings as they are.
        run_id: Name of the run.
        stamp: Time of the front.
    """
    units = problem.units
    return msg.ParetoFront(
        header=Header(stamp=stamp),
        run_id=run_id,
        points=[
            msg.ParetoPoint(
                index=point.get("index", 0),
                setpoint=named_values(point["setpoint"], units),
                objectives=named_values(point["objectives"], units, point.get("stddevs")),
                predicted=point.get("predicted", ()),
            )
            for point in front
        ],
        reference_point=named_values({o.name: o.reference for o in problem.objectives}, units),
        hypervolume=hypervolumes[0],
        hypervolume_measured=hypervolumes[1],
    )
