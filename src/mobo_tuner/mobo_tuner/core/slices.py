"""Slices through a set-point: what the models say along each variable, all others as they are."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from mobo_tuner.core.optimizer import Optimizer
from mobo_tuner.core.problem import Array


class Slice(NamedTuple):
    """The models along one variable, at m values of it.

    Attributes:
        values: Values of the variable, in its unit ``(m,)``.
        means: Means of each output, in its unit and sense, by its name ``(m,)``.
        stddevs: Standard deviations of these, without the noise of a reading ``(m,)``.
        acquisition: Logarithm of the acquisition function ``(m,)``; NaN where it is unknown.
    """

    values: Array
    means: Mapping[str, Array]
    stddevs: Mapping[str, Array]
    acquisition: Array


def slices(
    optimizer: Optimizer, setpoint: Mapping[str, float], points: int = 61
) -> dict[str, Slice]:
    """Return the slices through a set-point, by the name of the variable; fixed variables have none.

    Args:
        optimizer: Optimiser whose models are asked; its later suggestions are unaffected.
        setpoint: Every variable, in its unit.
        points: Number of values of each variable.

    Raises:
        ProblemError: If the set-point does not fit the problem.
    """
    problem = optimizer.problem
    here = problem.normalize(setpoint)
    signs = {objective.name: objective.sign for objective in problem.objectives}
    models = {name: m for name, m in optimizer.models.by_output.items() if m.n}
    found = {}
    for column, variable in enumerate(problem.variables):
        if variable.fixed is not None:
            continue
        along = np.linspace(-1.0, 1.0, points)
        if variable.choice_names and variable.places is not None:  # there is nothing in between
            along = variable.places
        x = np.repeat(here[None], len(along), axis=0)
        x[:, column] = along
        predicted = {name: model.predict(x) for name, model in models.items()}
        found[variable.name] = Slice(
            values=problem.columns(x)[variable.name],
            means={name: signs.get(name, 1.0) * mean for name, (mean, _) in predicted.items()},
            stddevs={name: stddev for name, (_, stddev) in predicted.items()},
            acquisition=optimizer.log_acquisition(x),
        )
    return found
