"""What a run believes of its evaluations: readings where they can be trusted, else the models' means."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from mobo_tuner.core.dataset import BoolArray, Dataset
from mobo_tuner.core.models import Models
from mobo_tuner.core.pareto import count_nondominated, is_below, is_nondominated
from mobo_tuner.core.problem import Array, Problem
from mobo_tuner.core.resolution import places

_DRAWS = 64
_WIDE = 4.0  # standard deviations


@dataclass(frozen=True)
class Belief:
    """The minimised objectives and the feasibility of n evaluations.

    Attributes:
        problem: Problem of P objectives.
        objectives: Believed values ``(n, P)``; NaN for failed and withdrawn evaluations and for what
            was never measured anywhere.
        stddevs: Their standard deviations ``(n, P)``; 0 for a trusted reading.
        predicted: Which of them were not measured, or are suspected ``(n, P)``.
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


def probability_nondominated(
    data: Dataset, models: Models, belief: Belief, rng: np.random.Generator
) -> Array:
    """Return the probability ``(n,)`` that each evaluation is non-dominated, by draws of the models.

    0 for an evaluation that is not believed to be feasible. Its standard error is at most 0.06.

    Args:
        data: Evaluations.
        models: Models that know all of `data`.
        belief: What they believe.
        rng: Random number generator.
    """
    probability = np.zeros(len(data))
    spread = _WIDE * belief.stddevs
    rows = np.flatnonzero(belief.feasible & np.isfinite(belief.objectives).all(axis=1))
    # What is worse than another one's worst by its best cannot matter.
    worst = (belief.objectives + spread)[rows]
    best = (belief.objectives - spread)[rows]
    worst = worst[is_nondominated(worst)]
    hopeless = np.any(np.all(worst < best[:, None], axis=2), axis=1)
    rows = rows[~hopeless]
    place = places(data.inputs[rows])
    draws = np.empty((_DRAWS, place.max(initial=-1) + 1, belief.objectives.shape[1]))
    for column, model in enumerate(models.objectives):
        # A set-point that was measured again is one point; what was read there counts, if anything does.
        order = np.argsort(belief.stddevs[rows, column], kind="stable")
        at = rows[order[np.unique(place[order], return_index=True)[1]]]
        draws[:, :, column] = belief.objectives[at, column]
        doubted = np.flatnonzero(belief.stddevs[at, column] > 0.0)
        if len(doubted):
            normals = rng.standard_normal((_DRAWS, len(doubted)))
            draws[:, doubted, column] = model.sample(data.inputs[at[doubted]], normals)
    probability[rows] = (count_nondominated(draws) / _DRAWS)[place]
    return probability


def is_certain(data: Dataset, models: Models) -> bool:
    """Return whether every reading counts as it is and none is missing, so that no model is needed."""
    incomplete = (data.valid & ~data.complete).any()
    return not (incomplete or models.has_suspects) and models.trusts_readings(data)


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
    for column, name in enumerate(problem.objective_names):
        readings[models.suspects(name), column] = np.nan
    for column, model in enumerate(models.objectives):
        if model.n:
            mean, stddev = model.predict(inputs[valid])
            objectives[valid, column], stddevs[valid, column] = mean, stddev
    trusted = np.isfinite(readings)
    if not models.trusts_readings(data):
        trusted &= np.isnan(objectives)
    objectives[trusted], stddevs[trusted] = readings[trusted], 0.0
    required = [data.column(name) for name in problem.required_diagnostics]
    feasible = valid & data.highest & np.isfinite(required).any(axis=0)
    signs = {o.name: o.sign for o in problem.objectives}
    for name, model, lower, upper in models.limited:
        values = data.column(name) * signs.get(name, 1.0)
        values[models.suspects(name)] = np.nan
        unknown = valid & (np.isnan(values) | (not models.trusts_readings(data)))
        if unknown.any() and model.n:
            values[unknown] = model.predict(inputs[unknown])[0]
        feasible &= (lower <= values) & (values <= upper)
    return Belief(problem, objectives, stddevs, np.isnan(readings), feasible)
