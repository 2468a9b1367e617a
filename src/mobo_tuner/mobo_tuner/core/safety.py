"""Suggestions for a machine that must not lose its beam: near what was measured, and believed safe.

The set of points that are believed safe at a given probability grows from a first, safe evaluation, as in safe Bayesian
optimisation [Sui2015]_. Candidates are drawn within a trust distance of evaluations that were safe; the
distance grows with each safe evaluation and shrinks after any other one. Another choice of a variable without an order
is half a range away, whichever it is: it is tried once the trust distance has grown to that.

.. [Sui2015] Y. Sui, A. Gotovos, J. Burdick, A. Krause, "Safe exploration for optimization with Gaussian processes",
   Proceedings of Machine Learning Research 37, 997-1005 (2015).
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from mobo_tuner.core.archive import Archive
from mobo_tuner.core.constraints import log_probability_between
from mobo_tuner.core.dataset import BoolArray, Dataset
from mobo_tuner.core.domain import CHANGED, sobol
from mobo_tuner.core.gaussian_process import GaussianProcess
from mobo_tuner.core.merit import Merit
from mobo_tuner.core.problem import Array, Problem, ProblemError
from mobo_tuner.core.settings import OptimizerSettings

DISTANCE = 0.05
"""First trust distance, as a share of each variable's range, if only constraints are to be safe."""
# Factors of the trust distance after an evaluation that was safe, and one that was not.
_GROWTH, _SHRINKAGE = 1.1, 0.5
# Factor of standard deviations, which few evaluations underestimate: `_WIDER` after many, and more by so much times
# the number of coefficients of a linear function over that of the evaluations.
_WIDER, _WIDER_AT_FIRST = 2.5, 6.0
_CANDIDATES = 2048
_REFINEMENTS = 3  # rounds of candidates nearer and nearer to the best one
_EXPANDING = 3  # one in so many suggestions is where the safety of a safe point is known least


def is_guarded(problem: Problem, settings: OptimizerSettings) -> bool:
    """Return whether suggestions keep near to what was measured."""
    return settings.trust_distance > 0.0 or any(c.safe for c in problem.constraints)


def was_safe(data: Dataset) -> BoolArray:
    """Return which evaluations were measured and met every constraint that must be safe ``(n,)``."""
    safe = data.valid.copy()
    for constraint in data.problem.constraints:
        if constraint.safe:
            readings = data.column(constraint.name)
            safe &= (constraint.minimum <= readings) & (readings <= constraint.maximum)
    return safe


def trust_distance(safe: BoolArray, first: float) -> float:
    """Return the trust distance after some evaluations, where a variable spans 2.

    Args:
        safe: Which of them were safe, in their order.
        first: First trust distance, as a share of a variable's range.
    """
    distance = 2.0 * first
    for each in safe:
        distance = min(distance * _GROWTH, 2.0) if each else max(distance * _SHRINKAGE, 0.2 * first)
    return distance


class SafeSearch:
    """One search for a set-point that is near and safe.

    Args:
        archive: Evaluations and models; the models are updated.
        settings: Settings of the optimiser.
        seed: Seed of every random choice.

    Raises:
        ProblemError: If no evaluation was safe, from which the search could begin.
    """

    def __init__(self, archive: Archive, settings: OptimizerSettings, seed: int) -> None:
        self._archive, self._settings, self._seed = archive, settings, seed
        self._problem, self._data = archive.problem, archive.dataset
        measured = len(self._data) - archive.expected  # no prediction makes a place safe
        safe = was_safe(self._data)[:measured]
        if not safe.any():
            raise ProblemError(
                "no evaluation to begin from: with trust_distance, or constraints that must be safe, the first "
                "one is told, valid and safe, before any is asked for"
            )
        self._centers = self._data.inputs[:measured][safe]
        self._distance = trust_distance(safe, settings.trust_distance or DISTANCE)
        self._rng = np.random.default_rng([seed, 6, len(self._data)])

    def candidate(self) -> Array:
        """Return the best point ``(d,)`` that is near and believed safe."""
        self._archive.update()
        told = len(self._data)
        acquisition = None
        if told >= self._archive.initial_evaluations:
            merit = Merit(self._archive, self._settings, self._seed)
            acquisition = merit.acquisition_function()
        if acquisition is not None and told % _EXPANDING:
            return self._best(acquisition.log_value)
        if acquisition is not None and any(c.safe for c in self._problem.constraints):
            return self._best(self._ignorance)
        return self._best(self._novelty)

    def _best(self, score: Callable[[Array], Array]) -> Array:
        """Return the point with the largest score among near and safe ones."""
        points = self._near(self._centers, self._distance, _CANDIDATES)
        best, value = self._centers[-1], -math.inf
        reach = self._distance
        for _ in range(_REFINEMENTS + 1):
            allowed = points[self._is_safe(points)]
            if len(allowed):
                scores = np.nan_to_num(score(allowed), nan=-math.inf, neginf=-math.inf)
                row = int(scores.argmax())
                if scores[row] > value:
                    best, value = allowed[row], float(scores[row])
            reach *= 0.25
            points = self._near(best[None], reach, _CANDIDATES // 8)
        return np.asarray(best)

    def _near(self, centers: Array, reach: float, count: int) -> Array:
        """Return points of the domain near some, and within the trust distance of a safe evaluation."""
        d, domain = centers.shape[1], self._problem.domain
        chosen = centers[self._rng.integers(len(centers), size=count)]
        steps = 2.0 * sobol(d, count, self._rng) - 1.0
        moved = np.clip(chosen + reach * steps, -1.0, 1.0)
        # Every choice without an order is as far from every other one.
        unordered = domain.unordered
        moved[:, unordered] = (steps if reach >= CHANGED else chosen)[:, unordered]
        points = domain.nearest(moved)
        distances = domain.distances(points, self._centers, "chebyshev").min(axis=1)
        return np.asarray(points[distances <= self._distance * (1.0 + 1e-9)])

    def _is_safe(self, points: Array) -> BoolArray:
        """Return which points ``(m, d)`` are believed to meet every constraint that must be safe."""
        safe = np.ones(len(points), dtype=bool)
        told, coefficients = len(self._data), points.shape[1] + 1
        wider = _WIDER + _WIDER_AT_FIRST * coefficients / told
        for model, lower, upper, probability in self._guards():
            mean, stddev = model.predict(points)
            believed = log_probability_between(mean, wider * stddev, lower, upper)[0]
            safe &= believed >= math.log(probability)
        return safe

    def _ignorance(self, points: Array) -> Array:
        """Return how little is known of the safety of points ``(m, d)``, in units of the spread, ``(m,)``."""
        ignorance = np.zeros(len(points))
        for model, *_ in self._guards():
            ignorance = np.maximum(ignorance, model.predict(points)[1] / (model.spread or 1.0))
        return ignorance

    def _novelty(self, points: Array) -> Array:
        """Return the distances of points ``(m, d)`` from all evaluations ``(m,)``."""
        distances = self._problem.domain.distances(points, self._data.inputs)
        return np.asarray(distances.min(axis=1))

    def _guards(self) -> list[tuple[GaussianProcess, float, float, float]]:
        """Return model, limits and least probability of each constraint that must be safe."""
        safe = {c.name: c.safe for c in self._problem.constraints if c.safe}
        return [
            (model, lower, upper, safe[name])
            for name, model, lower, upper in self._archive.models.limited
            if name in safe and model.n
        ]
