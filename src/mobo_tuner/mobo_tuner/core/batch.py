"""Batches: several set-points that are worth measuring together, pending until they are told.

.. [Ginsbourger2010] D. Ginsbourger, R. Le Riche, L. Carraro, "Kriging is well-suited to parallelize
   optimization", Computational Intelligence in Expensive Optimization Problems, Springer 2010.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import reduce

import numpy as np

from mobo_tuner.core.archive import Archive
from mobo_tuner.core.problem import Array, Problem
from mobo_tuner.core.resolution import SAME
from mobo_tuner.core.suggestion import Suggester, Suggestion

_FEW = 16  # pending set-points that are expected one after the other


class Pending:
    """Set-points that were suggested and neither told nor cancelled yet, in the order of asking.

    Suggestions take them into account: each is made as if all of them had read what the models predict
    (the "Kriging believer" of [Ginsbourger2010]_).

    Args:
        setpoints: Set-points that are pending from the start, in physical units.
    """

    def __init__(self, setpoints: list[dict[str, float]] | None = None) -> None:
        self._setpoints = [dict(setpoint) for setpoint in setpoints or []]

    @property
    def setpoints(self) -> list[dict[str, float]]:
        """The set-points, in physical units."""
        return [dict(setpoint) for setpoint in self._setpoints]

    def remove(self, setpoint: Mapping[str, float], problem: Problem) -> bool:
        """Remove a set-point; return whether it was pending."""
        if setpoint in self._setpoints:
            self._setpoints.remove(dict(setpoint))
            return True
        if not self._setpoints:
            return False
        pending = np.array([_place(each, problem) for each in self._setpoints])
        distances = np.abs(pending - _place(setpoint, problem)).max(axis=1)
        nearest = int(distances.argmin())
        if distances[nearest] > SAME:
            return False
        del self._setpoints[nearest]
        return True

    def next(self, archive: Archive, suggester: Suggester) -> Suggestion:
        """Return a single suggestion beside what is pending; it does not become pending itself."""
        return suggester.next(self._expected(archive))

    def extend(self, archive: Archive, suggester: Suggester, count: int) -> list[Suggestion]:
        """Suggest set-points that are worth measuring together, and let them be pending.

        They are chosen one by one, each as if those before it were told.
        """
        archive = self._expected(archive)
        batch: list[Suggestion] = []
        while len(batch) < count:
            if batch:
                archive = archive.expecting(batch[-1].setpoint)
            batch.append(suggester.next(archive))
        self._setpoints += [dict(suggestion.setpoint) for suggestion in batch]
        return batch

    def _expected(self, archive: Archive) -> Archive:
        """Return the archive as if all pending set-points had read what the models predict.

        A prediction that is learned does not change the others. So they can be learned at once, which
        differs from one after the other in rounding errors only and takes far less time for many.
        """
        if len(self._setpoints) > _FEW:
            return archive.expecting(*self._setpoints)
        return reduce(Archive.expecting, self._setpoints, archive)


def _place(setpoint: Mapping[str, float], problem: Problem) -> Array:
    """Return a set-point and its distance from the highest fidelity, normalised ``(d + f,)``."""
    place = problem.normalize(setpoint)
    fidelity = problem.fidelity
    return np.append(place, fidelity.lack(fidelity.of(setpoint))) if fidelity else place
