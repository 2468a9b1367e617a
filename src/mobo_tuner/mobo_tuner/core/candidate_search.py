"""The search for the next candidate: the maximum of the acquisition function, or exploration."""

from __future__ import annotations

import math
import time

import numpy as np
from numpy.typing import ArrayLike

from mobo_tuner.core.acquisition import AcquisitionFunction
from mobo_tuner.core.archive import Archive
from mobo_tuner.core.confirmation import confirmation
from mobo_tuner.core.exploration import explore
from mobo_tuner.core.initial_design import initial_design
from mobo_tuner.core.merit import Merit
from mobo_tuner.core.problem import Array
from mobo_tuner.core.resolution import SAME, Taken, taken
from mobo_tuner.core.settings import OptimizerSettings

# A failed set-point is not proposed again within 1 % of every variable's range.
FAILED_TOLERANCE = 0.02
# A set-point within 0.05 % of every variable's range of a measured one must promise something new.
_NEAR = 1e-3
_PATIENCE = 3  # valid evaluations in which the front should move
_MOST_MISSED = 1  # of these may miss a constraint if the front stands still for another reason


class CandidateSearch:
    """One search, over all that an archive knows.

    Args:
        archive: Evaluations and models; the models are updated.
        settings: Settings of the optimiser.
        seed: Seed of every random choice.
    """

    def __init__(self, archive: Archive, settings: OptimizerSettings, seed: int) -> None:
        self._archive = archive
        self._problem, self._data, self._models = archive.problem, archive.dataset, archive.models
        self._settings = settings
        self._seed = seed
        self._merit = Merit(archive, settings, seed)
        seconds = settings.suggestion_seconds
        self._deadline = math.inf if seconds is None else time.monotonic() + seconds

    def initial_point(self, index: int) -> Array:
        """Return a point of the initial design ``(d,)``, or one beside it if that is taken."""
        design = initial_design(
            self._settings.initial_design,
            self._archive.initial_evaluations,
            self._problem.domain,
            self._seed,
        )
        point: Array = np.asarray(design[index])
        used = taken(self._data)
        # After a pending set-point was cancelled, that of another one has this index.
        pending = self._data.targets[len(self._data) - self._archive.expected :]
        again = used.contains(point[None])[0] and self._models.trusts_readings(self._data)
        if again or (np.abs(pending - point) <= SAME).all(axis=1).any():
            rng = np.random.default_rng([self._seed, 4, index])
            return explore(self._data.inputs, used, rng, domain=self._problem.domain)
        return point

    def candidate(self) -> Array:
        """Return the maximum of the acquisition function ``(d,)``; exploration where it is zero."""
        self._archive.update()
        rng = np.random.default_rng([self._seed, 2, len(self._data)])
        inputs, failed = self._data.inputs, self._data.failed & self._data.highest
        if not self._models.ready or self._archive.is_short_of_readings:
            return explore(inputs, taken(self._data), rng, domain=self._problem.domain)
        confirming = confirmation(self._archive, self._settings)
        if confirming is not None:
            return confirming
        acquisition = self._merit.acquisition_function(tails=False)
        if acquisition is None:
            return self._explored(rng)
        found = self._maximum(acquisition, rng, inputs[failed], FAILED_TOLERANCE)
        if self._merit.is_out_of_reach(found):
            acquisition = self._merit.acquisition_function(nearest=True) or acquisition
            found = self._maximum(acquisition, rng, inputs[failed], FAILED_TOLERANCE)
        elif found is None:
            acquisition = self._merit.acquisition_function() or acquisition
            found = self._maximum(acquisition, rng, inputs[failed], FAILED_TOLERANCE)
        if found is None:
            return self._explored(rng)
        if self._should_explore(found):
            return self._explored(rng, anywhere=not self._archive.belief.feasible.any())
        used = taken(self._data)
        if self._pays(found, used):
            return found
        if self._seconds_left == 0.0:
            return self._explored(rng)
        # The machine was there: the best elsewhere, or else what is known least.
        centers = np.vstack([inputs[failed], used.centers])
        reach = np.vstack([np.full(inputs[failed].shape, FAILED_TOLERANCE), used.reach])
        other = self._maximum(acquisition, rng, centers, reach)
        if other is not None and self._pays(other, used):
            return other
        return self._explored(rng)

    def _should_explore(self, found: Array) -> bool:
        """Return whether a point far from all others is worth more than the best candidate ``(d,)``.

        The models may be certain and wrong where nothing was measured, and no reading elsewhere shows it.
        A point that fills the space finds what they miss with a chance of about `exploration` over the
        number of evaluations, and may be worth as much as all that was found before: it is chosen if the
        candidate promises less. It is chosen at every second evaluation, too, while valid ones do not move
        the front: then the models promise too much, unless what they promised missed a constraint only, which
        is learned where it was missed. With weights, or one objective without noise, the best point is sought
        to the last digit, and nothing is explored; nor where the machine varies, a reference point is out of
        reach, which is approached first, or readings are noisy and nothing is feasible yet: then what lacks
        little of a limit may meet it.
        """
        chance, n, belief = self._settings.exploration, len(self._data), self._archive.belief
        trusted = self._models.trusts_readings(self._data)
        exact = self._settings.weights is not None or (
            len(self._problem.objectives) == 1 and trusted
        )
        if chance == 0.0 or exact or self._models.varies:
            return False
        front = belief.front_rows()
        if belief.feasible.any():
            if not len(front):
                return False
            if self._merit.expected_gain(found) < chance / n:
                return True
        elif not trusted:
            return False
        told = np.flatnonzero((self._data.valid & self._data.highest)[: n - self._archive.expected])
        last = int(told[-_PATIENCE]) if len(told) >= _PATIENCE else -1
        if n % 2 or last < self._archive.initial_evaluations or (front >= last).any():
            return False
        missed = ~belief.feasible[told[-_PATIENCE:]]
        return bool(not belief.feasible.any() or missed.sum() <= _MOST_MISSED)

    @property
    def _seconds_left(self) -> float | None:
        """Time left for the suggestion [s]; None if there is no limit."""
        left = self._deadline - time.monotonic()
        return None if math.isinf(left) else max(left, 0.0)

    def _maximum(
        self,
        acquisition: AcquisitionFunction,
        rng: np.random.Generator,
        excluded: Array,
        tolerance: ArrayLike,
    ) -> Array | None:
        """Return where the acquisition function is largest ``(d,)``; None if it is zero everywhere."""
        maximum = self._settings.make_maximizer().maximize(
            acquisition,
            len(self._problem.variables),
            rng,
            starts=self._data.inputs[self._archive.belief.front_rows()],
            excluded=excluded,
            tolerance=tolerance,
            seconds=self._seconds_left,
            domain=self._problem.domain,
        )
        return None if maximum is None else maximum.x

    def _pays(self, x: Array, used: Taken) -> bool:
        """Return whether measuring at x ``(d,)`` may say anything that is not known."""
        rows = self._data.complete & self._data.valid & self._data.highest
        known, targets = self._data.inputs[rows], self._data.targets[rows]
        if len(known) == 0:
            return not used.contains(x[None])[0]
        # Beside a set-point that the machine missed, it will be missed again, and likewise.
        beside = np.abs(targets - x).max(axis=1)
        if beside.min() <= _NEAR:
            nearest = int(beside.argmin())
            x, distance = x + (known - targets)[nearest], float(beside[nearest])
        else:
            distances = np.abs(known - x).max(axis=1)
            nearest = int(distances.argmin())
            distance = float(distances[nearest])
        again = bool(used.contains(x[None])[0])
        if not again and distance > _NEAR:
            return True
        if again and self._models.trusts_readings(self._data):
            return False
        return self._models.expects_news(x, known[nearest])

    def _explored(self, rng: np.random.Generator, anywhere: bool = False) -> Array:
        """Return a point far from all evaluations that may be feasible and valid, shape ``(d,)``.

        Args:
            rng: Random number generator.
            anywhere: Whether it need not be feasible.
        """
        weight = self._merit.weight(feasible=not anywhere)
        log_weight = None if weight is None else weight.log_value
        used = taken(self._data)
        return explore(self._data.inputs, used, rng, log_weight, self._problem.domain)
