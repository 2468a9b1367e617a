"""The machine's resolution: which set-points it cannot tell from one that was measured.

A variable may have a grid (an integer, a stepper motor) or a dead band. Only where the machine ended
up says so: the set-point that was told in place of the one that was asked for, or the readback.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import reduce

import numpy as np
from numpy.typing import NDArray

from mobo_tuner.core.dataset import Dataset
from mobo_tuner.core.problem import Array

SAME = 1e-6
"""Largest difference in any variable between set-points that count as the same; variables span 2."""
_ROWS = 20  # the last evaluations, by which a grid is recognised: it may be new
_LEAST_ROWS = 4  # one less where the machine was seen to miss its target
_FINEST_GRID = 0.01
_ON_GRID = 1e-5
_BEYOND_EDGE = 1.001  # of a cell, whose edge the machine may round to either side
_FIRST_DEAD_BAND = 0.005  # half of it, where two evaluations ended up at the same place


def places(x: Array) -> NDArray[np.intp]:
    """Return the number of each point's place ``(n,)``, from 0 on in order, for points ``(n, d)``."""
    _, first, place = np.unique(np.round(x / SAME), axis=0, return_index=True, return_inverse=True)
    return np.asarray(np.argsort(np.argsort(first))[place.ravel()])


@dataclass(frozen=True)
class Taken:
    """Boxes of set-points that lead where the machine already was.

    Attributes:
        centers: Inputs and set-points of the evaluations ``(k, d)``.
        reach: Half the width of each box in each variable, ``(k, d)``.
    """

    centers: Array
    reach: Array

    def contains(self, x: Array) -> NDArray[np.bool_]:
        """Return which rows of x ``(m, d)`` lie in any of the boxes."""
        inside = [(np.abs(point - self.centers) <= self.reach).all(axis=1).any() for point in x]
        return np.array(inside, dtype=np.bool_)


def taken(data: Dataset) -> Taken:
    """Return the boxes around the evaluations of the highest fidelity after which nothing is expected there.

    They failed or have every output that was measured anywhere; or the place was measured again, and
    what is missing was not read then, either.
    """
    columns = [np.isfinite(data.column(name)) for name in data.problem.required_diagnostics]
    lacking = np.zeros(len(data), dtype=bool)
    for column in columns:
        lacking |= column.any() & ~column & ~data.failed
    rows = np.flatnonzero(data.highest & ~data.forgotten)
    _, place, counts = np.unique(
        np.round(data.inputs[rows] / SAME), axis=0, return_inverse=True, return_counts=True
    )
    done = rows[~lacking[rows] | (counts[place.ravel()] > 1)]
    inputs, targets = data.inputs[done], data.targets[done]
    if len(inputs) == 0:
        return Taken(inputs, inputs)
    # What the problem says of a grid is exact.
    steps = np.where(data.problem.domain.discrete, 0.0, grid_steps(inputs, targets))
    reach = np.maximum(0.5 * _BEYOND_EDGE * steps, SAME)
    places, place, counts = np.unique(
        np.round(inputs / SAME), axis=0, return_inverse=True, return_counts=True
    )
    reaches = np.repeat(reach[None], len(inputs), axis=0)
    if len(places) < len(inputs):
        missed = np.abs(targets - inputs)
        for row, count in zip(np.flatnonzero(counts > 1), counts[counts > 1], strict=True):
            rows = np.flatnonzero(place.ravel() == row)
            band = 2.0 * missed[rows].max(axis=0)
            if not band.any() and not steps.any():
                band = np.full(len(reach), _FIRST_DEAD_BAND * 2.0 ** min(count - 2, 8))
            reaches[rows] = np.maximum(reach, np.where(steps > 0.0, 0.0, band))
    sent = (targets != inputs).any(axis=1)
    return Taken(
        np.vstack([inputs, targets[sent]]),
        np.vstack([reaches, np.repeat(reach[None], np.count_nonzero(sent), axis=0)]),
    )


def grid_steps(inputs: Array, targets: Array) -> Array:
    """Return the step of each variable's grid ``(d,)``; 0 where it has none, or none is seen.

    Where the machine was last lies on a grid, and no target was farther than half a step away. Of
    the grids of which that is true, it is the finest: it rules out least.

    Args:
        inputs: Normalised inputs ``(n, d)``, in the order of the evaluations.
        targets: Normalised set-points ``(n, d)``.
    """
    steps = np.zeros(inputs.shape[1])
    inputs, targets = inputs[-_ROWS:], targets[-_ROWS:]
    for j in range(len(steps)):
        gaps = np.diff(np.unique(np.round(inputs[:, j] / SAME)) * SAME)
        missed = float(np.abs(targets[:, j] - inputs[:, j]).max())
        if len(gaps) == 0 or len(inputs) < _LEAST_ROWS - (missed > SAME and len(gaps) > 1):
            continue
        step = float(reduce(_common_divisor, gaps))
        if missed > SAME:
            step /= np.floor(step / (2.0 * missed) * _BEYOND_EDGE) or np.inf
        if step >= _FINEST_GRID:
            steps[j] = step
    return steps


def _common_divisor(a: float, b: float) -> float:
    """Return the largest step of which both are multiples, to rounding; 0 where there is none."""
    if a == 0.0:
        return 0.0
    while b > _ON_GRID:
        a, b = b, abs(a - b * round(a / b))
    return a if a >= _FINEST_GRID else 0.0


def readings_differ(data: Dataset) -> bool:
    """Return whether a required diagnostic read differently at one and the same place."""
    return any(differ for differ in _differences(data) if differ is not None)


def readings_agree(data: Dataset) -> bool:
    """Return whether every required diagnostic was measured again at some place, and read the same."""
    differences = _differences(data)
    return bool(differences) and all(differ is False for differ in differences)


def is_repeated(data: Dataset) -> bool:
    """Return whether a set-point was sent to the machine twice, be it that an evaluation failed there."""
    targets = np.round(np.hstack([data.targets, data.lacks]) / SAME)
    return len(np.unique(targets, axis=0)) < len(targets)


def _differences(data: Dataset) -> list[bool | None]:
    """Return whether each required diagnostic differs at one place; None if it was measured twice nowhere."""
    inputs = np.round(np.hstack([data.inputs, data.lacks]) / SAME)
    if len(np.unique(inputs, axis=0)) == len(inputs):
        return []
    differences: list[bool | None] = []
    for name in data.problem.required_diagnostics:
        values = data.column(name)
        rows = np.flatnonzero(np.isfinite(values))
        places, place = np.unique(inputs[rows], axis=0, return_inverse=True)
        if len(places) == len(rows) or len(rows) == 0:
            differences.append(None)
            continue
        least, most = np.full(len(places), np.inf), np.full(len(places), -np.inf)
        np.minimum.at(least, place.ravel(), values[rows])
        np.maximum.at(most, place.ravel(), values[rows])
        differences.append(bool(((most - least) > SAME * np.ptp(values[rows])).any()))
    return differences
