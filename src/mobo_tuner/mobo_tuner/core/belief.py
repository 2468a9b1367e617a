"""What a run believes of its evaluations: readings where they can be trusted, else the models' means."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from mobo_tuner.core.dataset import BoolArray, Dataset
from mobo_tuner.core.models import Models
from mobo_tuner.core.pareto import is_below, is_nondominated
from mobo_tuner.core.problem import Array, Problem


@dataclass(frozen=True)
class Belief:
    """The minimised objectives and the feasibility of n evaluations.

    Attributes:
        problem: Problem of P objectives.
        objectives: Believed values ``(n, P)``; NaN for failed and withdrawn evaluations and for what
            was never measured anywhere.
        stddevs: Their standard deviations ``(n, P)``; 0 for a trusted reading.
        predicted: Which of them were not measured ``(n, P)``.
        feasible: Which evaluations are believed to meet every constraint ``(n,)``.
    """

    problem: Problem
    objectives: Array
    stddevs: Array
    predicted: BoolArray
    feasible: BoolArray

    def front_rows(self) -> NDArray[np.intp]:
        """Return the evaluations on the front: feasible, below the reference point, non-dominated."""
        return self._front_rows

    @cached_property
    def _front_rows(self) -> NDArray[np.intp]:
        below = is_below(self.objectives, self.problem.reference_point)
        rows = np.flatnonzero(self.feasible & below)
        return rows[is_nondominated(self.objectives[rows])] if len(rows) else rows


def is_certain(data: Dataset) -> bool:
    """Return whether every reading counts as it is and none is missing, so that no model is needed."""
    return bool((data.complete | ~data.valid).all())


def measured(data: Dataset) -> Belief:
    """Return the belief that takes every reading as it is; an incomplete evaluation is infeasible."""
    objectives = data.objectives
    missing = np.isnan(objectives)
    stddevs = np.where(missing, np.nan, 0.0)
    return Belief(data.problem, objectives, stddevs, missing, data.feasible)


def believe(data: Dataset, models: Models) -> Belief:
    """Return the belief of models that know all of `data`."""
    problem, inputs, valid = data.problem, data.inputs, data.valid
    objectives = np.full((len(data), len(problem.objectives)), np.nan)
    stddevs = np.full_like(objectives, np.nan)
    readings = data.objectives
    for column, model in enumerate(models.objectives):
        if model.n:
            mean, stddev = model.predict(inputs[valid])
            objectives[valid, column], stddevs[valid, column] = mean, stddev
    trusted = np.isfinite(readings)
    objectives[trusted], stddevs[trusted] = readings[trusted], 0.0
    required = [data.column(name) for name in problem.required_diagnostics]
    feasible = valid & np.isfinite(required).any(axis=0)
    signs = {o.name: o.sign for o in problem.objectives}
    for name, model, lower, upper in models.limited:
        values = data.column(name) * signs.get(name, 1.0)
        unknown = valid & np.isnan(values)
        if unknown.any() and model.n:
            values[unknown] = model.predict(inputs[unknown])[0]
        feasible &= (lower <= values) & (values <= upper)
    return Belief(problem, objectives, stddevs, np.isnan(readings), feasible)
