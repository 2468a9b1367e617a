"""Set-points that show whether readings can be trusted, instead of what is better."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.distance import cdist

from mobo_tuner.core.archive import Archive
from mobo_tuner.core.constraints import violation
from mobo_tuner.core.dataset import BoolArray, Dataset
from mobo_tuner.core.problem import Array
from mobo_tuner.core.settings import OptimizerSettings

# A suspected reading that is better than believed is confirmed 1 % of every variable's range beside it.
_STEP = 0.02
_MOST_LOOKS = 2  # beside a suspected reading


def confirmation(archive: Archive, settings: OptimizerSettings) -> Array | None:
    """Return a set-point that shows whether a reading is right, shape ``(d,)``; None if there is no need.

    It is beside a suspected reading, or where one was measured before.

    Args:
        archive: Evaluations and models, which are up to date.
        settings: Settings of the optimiser.
    """
    beside = _beside_suspected(archive)
    if beside is not None:
        return beside
    repeats = settings.training != "adam" and archive.models.should_repeat(archive.dataset)
    return _repetition(archive) if repeats else None


def _beside_suspected(archive: Archive) -> Array | None:
    """Return a point beside a suspected reading that is better than believed, shape ``(d,)``.

    What is worse than believed shows by itself if it is right: the search comes there again. None
    if there is no such reading, or if each was looked at already.
    """
    if not archive.models.has_suspects:
        return None
    data, inputs, belief = archive.dataset, archive.dataset.inputs, archive.belief
    better = (data.objectives < belief.objectives).any(axis=1)
    better |= data.feasible & ~belief.feasible
    if not belief.feasible.any():
        better |= _nearer_limits(archive)
    suspected = {index for index, _ in archive.suspected}
    for index in sorted(suspected):
        if not better[index]:
            continue
        distances = np.abs(inputs[index + 1 :] - inputs[index]).max(axis=1)
        looks = distances[data.valid[index + 1 :]] <= 2.0 * _STEP
        looked = index + 1 + np.flatnonzero(data.valid[index + 1 :])[looks]
        if len(looked) < _MOST_LOOKS and _is_open(data, looked, suspected):
            inward = np.where(inputs[index] > 0.0, -1.0, 1.0)
            step = _STEP * (1.0 + 0.5 * len(looked))
            beside = np.asarray(inputs[index] + step * inward)
            domain = archive.problem.domain
            return beside if domain.is_box else domain.nearest(beside[None])[0]
    return None


def _is_open(data: Dataset, looked: NDArray[np.intp], suspected: set[int]) -> bool:
    """Return whether evaluations beside a suspected reading have left open whether it is right.

    They were suspected, too, as they are where an instrument failed for a while; by now it reads right elsewhere.
    """
    if len(looked) == 0:
        return True
    later = set(np.flatnonzero(data.valid[looked[-1] + 1 :]) + looked[-1] + 1)
    return suspected.issuperset(looked) and bool(later - suspected)


def _nearer_limits(archive: Archive) -> BoolArray:
    """Return which evaluations have a suspected reading that lacks less of a constraint than believed ``(n,)``."""
    nearer = np.zeros(len(archive.dataset), dtype=bool)
    signs = {o.name: o.sign for o in archive.problem.objectives}
    for name, model, lower, upper in archive.models.limited:
        rows = archive.models.suspects(name)
        if len(rows):
            readings = archive.dataset.column(name)[rows] * signs.get(name, 1.0)
            believed = model.predict(archive.dataset.inputs[rows])[0]
            nearer[rows] |= violation(readings, lower, upper) < violation(believed, lower, upper)
    return nearer


def _repetition(archive: Archive) -> Array | None:
    """Return a set-point to measure again ``(d,)``, which shows whether the machine is noisy.

    It is the one of the front that is farthest from all others, of all if none is on it: whatever there
    is of luck in its reading, no other reading shows it.
    """
    data = archive.dataset
    rows = archive.belief.front_rows()
    if len(rows) == 0:
        rows = np.flatnonzero(data.valid)
    rows = rows[archive.problem.domain.contains(data.targets[rows])]  # bounds may have changed
    if len(rows) == 0:
        return None
    distances = cdist(data.inputs[rows], data.inputs)
    distances[np.arange(len(rows)), rows] = np.inf
    return np.asarray(data.targets[rows[distances.min(axis=1).argmax()]])
