"""Exploration: where to measure when the models have nothing to say, or nothing new.

Space is filled: the next set-point is the one farthest from all evaluations and from the bounds.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.distance import cdist

from mobo_tuner.core.domain import SMALL, Domain, sobol
from mobo_tuner.core.problem import Array
from mobo_tuner.core.resolution import SAME, Taken

_POINTS = 1024
_TO_IMAGE = 2.0  # what lies beyond a bound is the mirror image of what lies inside


def explore(
    inputs: Array,
    taken: Taken,
    rng: np.random.Generator,
    log_weight: Callable[[Array], Array] | None = None,
    domain: Domain | None = None,
) -> Array:
    """Return the quasi-random point that is farthest from all inputs, shape ``(d,)``.

    A bound is a mirror: a point counts as twice as far from its own image as from the bound. Without
    it the corners come first, of which there are many and which stand for little of the space.

    Args:
        inputs: Normalised inputs of the evaluations ``(n, d)``.
        taken: What must not be proposed, unless there is nothing else.
        rng: Random number generator.
        log_weight: Logarithm of a weight of the distance at points ``(m, d)``, shape ``(m,)``.
        domain: Points that may be proposed; None for all of the box. The ends of a grid are no mirrors.
    """
    d = inputs.shape[1]
    if domain is None or domain.is_box:
        points: Array = 2.0 * sobol(d, _POINTS, rng) - 1.0
        nearest = _TO_IMAGE * (1.0 - np.abs(points)).min(axis=1)
    else:
        points = domain.draw(max(_POINTS, SMALL), rng)
        fresh = ~taken.contains(points)
        if not fresh.any():  # every point was measured: again where that was done least often
            times = (cdist(points, inputs) <= SAME).sum(axis=1)
            fresh = times == times.min()
        points = points[fresh]
        free = ~domain.discrete
        nearest = _TO_IMAGE * (1.0 - np.abs(points[:, free])).min(axis=1, initial=1.0)
    if len(inputs):
        distances = cdist(points, inputs) if domain is None else domain.distances(points, inputs)
        nearest = np.minimum(nearest, distances.min(axis=1))
    with np.errstate(divide="ignore"):
        score = np.log(nearest)
    if log_weight is not None:
        weight = log_weight(points)
        score += np.where(np.isnan(weight), -np.inf, weight)
    free = ~taken.contains(points)
    if free.any():
        score[~free] = -np.inf
    return np.asarray(points[score.argmax()])


def spread_out(
    inputs: Array, rows: NDArray[np.intp], preferred: Sequence[NDArray[np.intp]], count: int
) -> NDArray[np.intp]:
    """Return `count` of some rows of the inputs ``(n, d)``, far from each other, in their order.

    Args:
        inputs: Inputs ``(n, d)``.
        rows: Rows to choose from, more than `count`.
        preferred: Rows to choose first, each kind filling at most 40 % of the places.
        count: Number of rows.
    """
    chosen: list[int] = []
    nearest = np.full(len(inputs), np.inf)

    def choose(among: NDArray[np.intp], places: int) -> None:
        for _ in range(min(places, len(among))):
            row = int(among[nearest[among].argmax()])
            if nearest[row] <= 0.0:
                return
            chosen.append(row)
            np.minimum(nearest, np.square(inputs - inputs[row]).sum(axis=1), out=nearest)
            nearest[row] = -1.0

    for kind in preferred:
        choose(kind, 2 * count // 5)
    choose(rows, count - len(chosen))
    return np.array(sorted(chosen), dtype=np.intp)
