"""What operators can change while a run is active, with its value of now."""

from __future__ import annotations

import math
from typing import NamedTuple

from mobo_tuner.core.problem import Problem


class Setting(NamedTuple):
    """A parameter of the tuner that can be changed while a run is active.

    Attributes:
        name: Name of the parameter.
        label: Name for people, with the unit.
        value: Value of now; NaN = none.
    """

    name: str
    label: str
    value: float


def settings_of(problem: Problem, budget: int) -> list[Setting]:
    """Return the budget, and the bounds, references, goals and limits of a problem.

    Args:
        problem: Problem of now.
        budget: Number of evaluations after which the run ends.
    """
    settings = [Setting("evaluations", "budget of evaluations", budget)]
    for v in problem.variables:
        if v.choice_names or v.fixed is not None:  # what has no order has no bounds
            continue
        name = labelled(v.name, v.unit)
        settings.append(Setting(f"variables.{v.name}.min", f"{name}, lower bound", v.minimum))
        settings.append(Setting(f"variables.{v.name}.max", f"{name}, upper bound", v.maximum))
    for o in problem.objectives:
        name = labelled(o.name, o.unit)
        settings.append(
            Setting(f"objectives.{o.name}.reference", f"{name}, reference", o.reference)
        )
        if o.goal is not None or o.truncation is None:
            goal = math.nan if o.goal is None else o.goal
            settings.append(Setting(f"objectives.{o.name}.goal", f"{name}, good enough", goal))
    for c in problem.constraints:
        for leaf, limit, word in (("min", c.minimum, "least"), ("max", c.maximum, "greatest")):
            if math.isfinite(limit):
                text = f"{labelled(c.name, c.unit)}, {word} feasible value"
                settings.append(Setting(f"constraints.{c.name}.{leaf}", text, limit))
    return settings


def setting_value(name: str, value: float) -> float | int:
    """Return a value of the type that the parameter has."""
    return int(value) if name == "evaluations" and value == int(value) else float(value)


def labelled(name: str, unit: str) -> str:
    """Return the name of a quantity with its unit in brackets."""
    return f"{name} [{unit}]" if unit else name
