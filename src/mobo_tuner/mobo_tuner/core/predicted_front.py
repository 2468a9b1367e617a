"""The Pareto front as the models predict it: non-dominated posterior means over the whole space.

Found by a small genetic search, which costs the models next to nothing: what survives of each
generation is what no other prediction dominates, thinned where it is crowded.
"""

from __future__ import annotations

import numpy as np
from scipy.stats import qmc

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

    Its points meet every constraint by their means, are more likely valid than not, and better than
    the reference point.

    Args:
        problem: of d variables and P objectives.
        models: of its quantities, up to date.
        known: set-points ``(n, d)`` from which the search starts, too.
        rng: of the random choices.
        size: most points of the front.

    Returns:
        Set-points ``(k, d)`` in [-1, 1], means and standard deviations ``(k, P)`` of the minimised
        objectives, k at most `size` and perhaps 0.
    """
    d = len(problem.variables)
    front = 2.0 * qmc.Sobol(d, rng=rng).random(_FIRST) - 1.0
    front = np.vstack([front, np.clip(known, -1.0, 1.0)])
    front, means = _survivors(problem, models, front, size)
    for step in np.geomspace(*_STEPS, GENERATIONS):
        if len(front) == 0:
            break
        children = _children(front, step, rng)
        front, means = _survivors(problem, models, np.vstack([front, children]), size)
    stddevs = np.empty_like(means)
    for column, model in enumerate(models.objectives):
        if len(front):
            stddevs[:, column] = model.predict(front)[1]
    return front, means, stddevs


def _survivors(problem: Problem, models: Models, x: Array, size: int) -> tuple[Array, Array]:
    """Those of x ``(m, d)`` that the front is made of, and their means."""
    means = np.column_stack([model.predict(x)[0] for model in models.objectives])
    good = is_below(means, problem.reference_point)
    for model, lower, upper in models.constraints:
        mean = model.predict(x)[0]
        good &= (lower <= mean) & (mean <= upper)
    good &= models.validity.predict_log_probability(x) >= _LEAST_VALIDITY
    x, means = x[good], means[good]
    if len(x) == 0:
        return x, means
    front = is_nondominated(means)
    x, means = x[front], means[front]
    kept = _spread(means, size)
    return x[kept], means[kept]


def _spread(points: Array, size: int) -> np.ndarray[tuple[int], np.dtype[np.intp]]:
    """Rows of `size` points that are far from each other, the best in each objective among them."""
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
    """Mixtures of pairs of parents, moved a little: ``(m, d)`` in [-1, 1]."""
    mothers, fathers = (parents[rng.integers(len(parents), size=_CHILDREN)] for _ in range(2))
    share = rng.uniform(-0.1, 1.1, size=(_CHILDREN, 1))
    mixed = mothers + share * (fathers - mothers) * (rng.random(mothers.shape) < 0.8)
    moved = rng.random(mothers.shape) < max(0.3, 1.0 / parents.shape[1])
    return np.asarray(np.clip(mixed + step * moved * rng.standard_normal(mixed.shape), -1.0, 1.0))
