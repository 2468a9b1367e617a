"""The predicted Pareto front: non-dominated posterior means over the whole space.

It is found by a small genetic search, which needs little time. The predictions that no other one
dominates survive each generation, except for some in crowded regions.
"""

from __future__ import annotations

import numpy as np

from mobo_tuner.core.domain import sobol
from mobo_tuner.core.models import Models
from mobo_tuner.core.pareto import is_below, is_nondominated
from mobo_tuner.core.problem import Array, Problem

GENERATIONS = 30
_FIRST = 2048  # quasi-random points, a power of two
_CHILDREN = 512
_STEPS = (0.3, 0.003)  # standard deviation of mutations in the first and the last generation
_LEAST_VALIDITY = np.log(0.5)


def predict_front(
    problem: Problem, models: Models, known: Array, rng: np.random.Generator, size: int
) -> tuple[Array, Array, Array]:
    """Search for the predicted front.

    The predicted means of its points meet every constraint and are better than the reference point;
    each point is at least half as likely to be valid as the best one known.

    Args:
        problem: Problem with d variables and P objectives.
        models: Trained models of its quantities.
        known: Additional normalised set-points from which the search starts ``(n, d)``.
        rng: Random number generator.
        size: Highest number of points.

    Returns:
        The set-points ``(k, d)`` in [-1, 1], and the means and standard deviations ``(k, P)`` of the
        minimised objectives; k is at most `size` and may be 0.
    """
    d = len(problem.variables)
    front = 2.0 * sobol(d, _FIRST, rng) - 1.0
    front = np.vstack([front, np.clip(known, -1.0, 1.0)])
    if not problem.domain.is_box:
        front = problem.domain.nearest(front)
    front, means = _survivors(problem, models, front, size)
    for step in np.geomspace(*_STEPS, GENERATIONS):
        if len(front) == 0:
            break
        children = _children(front, step, rng)
        if not problem.domain.is_box:
            children = problem.domain.nearest(children)
        front, means = _survivors(problem, models, np.vstack([front, children]), size)
    stddevs = np.empty_like(means)
    for column, model in enumerate(models.objectives):
        if len(front):
            stddevs[:, column] = model.predict(front)[1]
    return front, means, stddevs


def _survivors(problem: Problem, models: Models, x: Array, size: int) -> tuple[Array, Array]:
    """Return the rows of x ``(m, d)`` that are on the front, and their means."""
    means = np.column_stack([model.predict(x)[0] for model in models.objectives])
    good = is_below(means, problem.reference_point)
    for model, lower, upper in models.constraints:
        mean = model.predict(x)[0]
        good &= (lower <= mean) & (mean <= upper)
    good &= models.validity.log_weight(x) >= _LEAST_VALIDITY
    x, means = x[good], means[good]
    if len(x) == 0:
        return x, means
    front = is_nondominated(means)
    x, means = x[front], means[front]
    kept = _spread(means, size)
    return x[kept], means[kept]


def _spread(points: Array, size: int) -> np.ndarray[tuple[int], np.dtype[np.intp]]:
    """Return `size` rows of points that are far from each other, with the best in each objective."""
    if len(points) <= size:
        return np.arange(len(points))
    low, high = points.min(axis=0), points.max(axis=0)
    scaled = (points - low) / np.where(high > low, high - low, 1.0)
    kept = list(dict.fromkeys(int(row) for row in scaled.argmin(axis=0)))[:size]
    nearest = np.min([np.square(scaled - scaled[row]).sum(axis=1) for row in kept], axis=0)
    while len(kept) < size:
        row = int(nearest.argmax())
        kept.append(row)
        nearest = np.minimum(nearest, np.square(scaled - scaled[row]).sum(axis=1))
    return np.array(kept)


def _children(parents: Array, step: float, rng: np.random.Generator) -> Array:
    """Return mixtures of pairs of parents with small random changes, ``(m, d)`` in [-1, 1]."""
    mothers, fathers = (parents[rng.integers(len(parents), size=_CHILDREN)] for _ in range(2))
    share = rng.uniform(-0.1, 1.1, size=(_CHILDREN, 1))
    mixed = mothers + share * (fathers - mothers) * (rng.random(mothers.shape) < 0.8)
    moved = rng.random(mothers.shape) < max(0.3, 1.0 / parents.shape[1])
    return np.asarray(np.clip(mixed + step * moved * rng.standard_normal(mixed.shape), -1.0, 1.0))
