"""The search for the next candidate: the maximum of the acquisition function, or exploration."""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from functools import partial, reduce
from operator import mul

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.distance import cdist

from mobo_tuner.core.acquisition import (
    ACQUISITION_FUNCTIONS,
    AcquisitionFunction,
    Average,
    ExpectedHypervolumeImprovement,
    Knowledge,
    Model,
    beta_schedule,
)
from mobo_tuner.core.archive import Archive
from mobo_tuner.core.constraints import ProbabilityOfFeasibility, ValidityWeight
from mobo_tuner.core.dataset import BoolArray
from mobo_tuner.core.exploration import explore
from mobo_tuner.core.gaussian_process import GaussianProcess
from mobo_tuner.core.hints import nearest_to_reference
from mobo_tuner.core.hypervolume import BoxDecomposition
from mobo_tuner.core.initial_design import initial_design
from mobo_tuner.core.problem import Array
from mobo_tuner.core.proximal import ProximalBiasing
from mobo_tuner.core.resolution import SAME, Taken, taken
from mobo_tuner.core.scalarisation import WeightedSum
from mobo_tuner.core.settings import OptimizerSettings

# A failed set-point is not proposed again within 1 % of every variable's range.
FAILED_TOLERANCE = 0.02
# A suspected reading that is better than believed is confirmed 1 % of every variable's range beside it.
CONFIRMING_STEP = 0.02
# A set-point within 0.05 % of every variable's range of a measured one must promise something new.
_NEAR = 1e-3
_MOST_LOOKS = 2  # beside a suspected reading
_ALIKE = 1.0  # range of a constraint's readings, as a share of what they lack
_ALIKE_BUT_FOR_NOISE = 4.0  # the same where readings are noisy
_MOST_FAILURES = 3  # in a row, after which the search goes back to what was valid
_MOST_HALVINGS = 12
_HOPELESS = 1e-4  # expected improvement of each objective, as a share of its spread
_PATIENCE = 3  # evaluations in which the front should move
_MOST_MISSED = 1  # of these may miss a constraint if the front stands still for another reason
_DRAWS = 8  # of the function at noisy evaluations
_MOST_DRAWN = 100  # evaluations up to which it is drawn; many are known well by their means
_MOST_BOXES = 1000  # of the believed front, up to which one for each draw takes little time
_SKILL = 0.5  # least share of their variance that a model must explain to be followed


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
        unconfirmed = self._unconfirmed()
        if unconfirmed is not None:
            return unconfirmed
        repetition = self._repetition()
        if repetition is not None:
            return repetition
        acquisition = self.acquisition_function(tails=False)
        if acquisition is None:
            return self._explored(rng)
        found = self._maximum(acquisition, rng, inputs[failed], FAILED_TOLERANCE)
        if self._is_out_of_reach(found):
            acquisition = self.acquisition_function(nearest=True) or acquisition
            found = self._maximum(acquisition, rng, inputs[failed], FAILED_TOLERANCE)
        elif found is None:
            acquisition = self.acquisition_function() or acquisition
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

    def expected_gain(self, x: Array) -> float:
        """Return the share by which an evaluation at x ``(d,)`` is expected to raise the hypervolume.

        It is the expected improvement times the probability of feasibility, by the models of the last
        update. NaN if the models are not ready or there is no hypervolume yet.
        """
        models, belief, volume = self._models, self._archive.belief, self._archive.hypervolume
        if not models.ready or not models.known.all() or volume <= 0.0:
            return math.nan
        values, reference = belief.objectives[belief.feasible], self._problem.reference_point
        single = ACQUISITION_FUNCTIONS.find(self._settings.acquisition).single_objective
        # The boxes of the archive are only built when the acquisition function needs them, too.
        front = partial(BoxDecomposition, reference, values) if single else self._archive.front
        knowledge = Knowledge(tuple(models.objectives), values, reference, 0.0, front)
        improvement: AcquisitionFunction = ExpectedHypervolumeImprovement.of(knowledge)
        for limit in models.constraints:
            improvement = improvement * ProbabilityOfFeasibility(*limit)
        return float(np.exp(improvement.log_value(x[None])[0]) / volume)

    def _should_explore(self, found: Array) -> bool:
        """Return whether a point far from all others is worth more than the best candidate ``(d,)``.

        The models may be certain and wrong where nothing was measured, and no reading elsewhere shows it.
        A point that fills the space finds what they miss with a chance of about `exploration` over the
        number of evaluations, and may be worth as much as all that was found before: it is chosen if the
        candidate promises less. It is chosen at every second evaluation, too, while the front does not
        move: then the models promise too much, unless what they promised missed a constraint only, which is
        learned where it was missed. With one objective, or weights, the best point is sought
        to the last digit, and nothing is explored; nor where the machine varies, a reference point is out of
        reach, which is approached first, or readings are noisy and nothing is feasible yet: then what lacks
        little of a limit may meet it.
        """
        chance, n, belief = self._settings.exploration, len(self._data), self._archive.belief
        single = len(self._problem.objectives) == 1 or self._settings.weights is not None
        if chance == 0.0 or single or self._models.varies:
            return False
        front = belief.front_rows()
        if belief.feasible.any():
            if not len(front):
                return False
            if self.expected_gain(found) < chance / n:
                return True
        elif not self._models.trusts_readings(self._data):
            return False
        told = np.flatnonzero(self._data.highest[: n - self._archive.expected])
        last = int(told[-_PATIENCE]) if len(told) >= _PATIENCE else -1
        if n % 2 or last < self._archive.initial_evaluations or (front >= last).any():
            return False
        missed = self._data.valid[told[-_PATIENCE:]] & ~belief.feasible[told[-_PATIENCE:]]
        return bool(not belief.feasible.any() or missed.sum() <= _MOST_MISSED)

    def _unconfirmed(self) -> Array | None:
        """Return a point beside a suspected reading that is better than believed, shape ``(d,)``.

        What is worse than believed shows by itself if it is right: the search comes there again. None
        if there is no such reading, or if each was looked at already.
        """
        if not self._models.has_suspects:
            return None
        data, inputs, belief = self._data, self._data.inputs, self._archive.belief
        better = (data.objectives < belief.objectives).any(axis=1)
        better |= data.feasible & ~belief.feasible
        if not belief.feasible.any():
            better |= self._nearer_limits()
        suspected = {index for index, _ in self._archive.suspected}
        for index in sorted(suspected):
            if not better[index]:
                continue
            distances = np.abs(inputs[index + 1 :] - inputs[index]).max(axis=1)
            looks = distances[data.valid[index + 1 :]] <= 2.0 * CONFIRMING_STEP
            looked = index + 1 + np.flatnonzero(data.valid[index + 1 :])[looks]
            if len(looked) < _MOST_LOOKS and self._is_open(looked, suspected):
                inward = np.where(inputs[index] > 0.0, -1.0, 1.0)
                step = CONFIRMING_STEP * (1.0 + 0.5 * len(looked))
                beside = np.asarray(inputs[index] + step * inward)
                domain = self._problem.domain
                return beside if domain.is_box else domain.nearest(beside[None])[0]
        return None

    def _is_open(self, looked: NDArray[np.intp], suspected: set[int]) -> bool:
        """Return whether evaluations beside a suspected reading have left open whether it is right.

        They were suspected, too, as they are where an instrument failed for a while; by now it reads right elsewhere.
        """
        if len(looked) == 0:
            return True
        later = set(np.flatnonzero(self._data.valid[looked[-1] + 1 :]) + looked[-1] + 1)
        return suspected.issuperset(looked) and bool(later - suspected)

    def _repetition(self) -> Array | None:
        """Return a set-point to measure again ``(d,)``, if that shows whether the machine is noisy.

        It is the one of the front that is farthest from all others, of all if none is on it: whatever there
        is of luck in its reading, no other reading shows it.
        """
        data = self._data
        if self._settings.training == "adam" or not self._models.should_repeat(data):
            return None
        rows = self._archive.belief.front_rows()
        if len(rows) == 0:
            rows = np.flatnonzero(data.valid)
        rows = rows[self._problem.domain.contains(data.targets[rows])]  # bounds may have changed
        if len(rows) == 0:
            return None
        distances = cdist(data.inputs[rows], data.inputs)
        distances[np.arange(len(rows)), rows] = np.inf
        return np.asarray(data.targets[rows[distances.min(axis=1).argmax()]])

    def _nearer_limits(self) -> BoolArray:
        """Return which evaluations have a suspected reading that lacks less of a constraint than believed ``(n,)``."""
        nearer = np.zeros(len(self._data), dtype=bool)
        signs = {o.name: o.sign for o in self._problem.objectives}
        for name, model, lower, upper in self._models.limited:
            rows = self._models.suspects(name)
            if len(rows):
                readings = self._data.column(name)[rows] * signs.get(name, 1.0)
                believed = model.predict(self._data.inputs[rows])[0]
                nearer[rows] |= _lack(readings, lower, upper) < _lack(believed, lower, upper)
        return nearer

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

    def _is_out_of_reach(self, found: Array | None) -> bool:
        """Return whether no evaluation is better than the reference point, nor will be at `found`.

        There is next to no improvement even at the best candidate, compared with the spread of the
        readings; or nothing is feasible, nor will be. Then the search is for an improvement on the point
        that comes nearest.
        """
        belief = self._archive.belief
        if not belief.feasible.any():
            return found is not None and self._is_hopeless(found)
        if len(belief.front_rows()) or not self._models.known.all():
            return False
        if found is None:
            return True
        improvement = self._improvement(self._models.known).log_value(found[None])[0]
        models = self._models.objectives
        if self._settings.weights is not None:
            spreads = [
                sum(w * m.spread for w, m in zip(self._settings.weights, models, strict=True))
            ]
        else:
            spreads = [model.spread for model in models]
        return bool(improvement < sum(math.log(_HOPELESS * (s or 1.0)) for s in spreads))

    def _is_hopeless(self, x: Array) -> bool:
        """Return whether the models are certain that x ``(d,)`` misses a constraint."""
        limits = self._models.constraints
        chance = sum(ProbabilityOfFeasibility(*limit).log_value(x[None])[0] for limit in limits)
        return bool(chance < math.log(_HOPELESS))

    def _half_way(self) -> list[tuple[GaussianProcess, float, float]]:
        """Return the constraints with limits half-way to them from the evaluation that lacks least.

        Where the models are certain that nothing is feasible, the probability is largest where they know
        least, which are the corners; they still know where the readings become better.
        """
        limits = self._models.constraints
        measured = self._data.inputs[self._data.valid]
        believed = [model.predict(measured)[0] for model, _, _ in limits]
        lacks = [
            _lack(values, lower, upper) / (model.spread or 1.0)
            for values, (model, lower, upper) in zip(believed, limits, strict=True)
        ]
        nearest = int(np.sum(lacks, axis=0).argmin())
        return [
            (model, min(lower, 0.5 * (lower + at)), max(upper, 0.5 * (upper + at)))
            for (model, lower, upper), at in zip(
                limits, (b[nearest] for b in believed), strict=True
            )
        ]

    def _pays(self, x: Array, used: Taken) -> bool:
        """Return whether measuring at x ``(d,)`` may say anything that is not known."""
        rows = self._data.complete & self._data.valid & self._data.highest
        known, targets = self._data.inputs[rows], self._data.targets[rows]
        if len(known) == 0:
            return True
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
        limits = [] if anywhere else [c for c in self._models.constraints if self._is_informed(c)]
        factors = self._factors(limits)
        weight = reduce(mul, factors).log_value if factors else None
        used = taken(self._data)
        return explore(self._data.inputs, used, rng, weight, self._problem.domain)

    def acquisition_function(
        self, nearest: bool = False, tails: bool = True
    ) -> AcquisitionFunction | None:
        """Return the acquisition function over all that was told, times its factors.

        It is None if the readings do not show where it is large: the readings of all objectives are
        alike, or those of a constraint that was never met.

        Args:
            nearest: Whether to improve on the evaluation that comes nearest to the reference point, or to
                the limits if none meets them.
            tails: Whether improvements that underflow are needed.
        """
        known = self._models.known
        limits = self._models.constraints
        factors = self._factors(limits)
        # Without a feasible point there is no front to improve: feasibility comes first.
        if limits and not (known.any() and self._archive.belief.feasible.any()):
            if not all(map(self._is_informed, limits)):
                return None
            return reduce(mul, self._factors(self._half_way()) if nearest else factors)
        if all(m.is_constant for m in self._models.objectives if m.n):
            return None
        if not self._problem.has_references:  # some objective was never measured
            return None
        return reduce(mul, [self._improvement(known, nearest, tails), *factors])

    def _factors(
        self, limits: Sequence[tuple[GaussianProcess, float, float]]
    ) -> list[AcquisitionFunction]:
        """Return the factors of the improvement: the given constraints, validity, proximal biasing."""
        factors: list[AcquisitionFunction] = [ProbabilityOfFeasibility(*limit) for limit in limits]
        if self._data.failed.any():
            factors.append(ValidityWeight(self._models.validity))
            factors.extend(self._back_to_valid())
        precision = self._settings.proximal_precision(self._problem)
        if precision is not None:
            factors.append(
                ProximalBiasing(
                    self._data.inputs[-1],
                    precision,
                    [bool(v.choice_names) for v in self._problem.variables],
                )
            )
        return factors

    def _back_to_valid(self) -> list[AcquisitionFunction]:
        """Return the factor that leads back to where evaluations were valid, if several failed in a row.

        What the failures have in common may be far from anything that the model of validity can tell
        from a few of them. Each further one halves the square of the distance that is allowed.
        """
        valid = self._data.inputs[self._data.valid]
        failures = int(np.argmin(self._data.failed[::-1])) if len(valid) else 0
        if failures <= _MOST_FAILURES:
            return []
        precision = 2.0 ** min(failures - _MOST_FAILURES, _MOST_HALVINGS)
        return [ProximalBiasing(valid[-1 - failures % len(valid)], precision)]

    def _improvement(
        self, known: BoolArray, nearest: bool = False, tails: bool = True
    ) -> AcquisitionFunction:
        """Return the acquisition function of the objectives that were measured at least once.

        Args:
            known: Which objectives these are ``(P,)``.
            nearest: Whether the evaluation that comes nearest to the reference point takes its place
                where that is better than it.
            tails: Whether improvements that underflow are needed.
        """
        settings, belief = self._settings, self._archive.belief
        chosen = ACQUISITION_FUNCTIONS.find(settings.acquisition)
        models = tuple(m for m, k in zip(self._models.objectives, known, strict=True) if k)
        values = belief.objectives[belief.feasible][:, known]
        reference = self._problem.reference_point[known]
        if nearest:
            reference = np.maximum(reference, values[nearest_to_reference(values, reference)])
        lower = self._problem.truncation_lower[known]
        beta = settings.beta
        if isinstance(beta, str):
            beta = beta_schedule(len(self._data), len(self._problem.variables))
        if chosen.single_objective and settings.weights is not None:
            weights = np.array(settings.weights)[known]
            if not weights.any():  # nothing that counts was measured yet
                weights = np.ones(len(weights))
            summed: tuple[Model, ...] = (WeightedSum(models, weights),)
            sums = (values @ weights)[:, None]
            worst = np.array([sums.max() if nearest else reference @ weights])
            least = partial(BoxDecomposition, worst, sums)
            return chosen.of(Knowledge(summed, sums, worst, beta, least))
        truncation = (lower, reference) if np.isfinite(lower).any() else None
        if not nearest and self._should_draw(chosen):
            rng = np.random.default_rng([self._seed, 6, len(self._data)])
            inputs = self._data.inputs[belief.feasible]
            improvements = []
            for drawn in zip(*(m.drawn(_DRAWS, rng) for m in self._models.objectives), strict=True):
                values = np.column_stack([model.predict(inputs)[0] for model in drawn])
                boxes = partial(BoxDecomposition, reference, values)
                knowledge = Knowledge(drawn, values, reference, beta, boxes, truncation, tails)
                improvements.append(chosen.of(knowledge))
            return Average(improvements)

        def front() -> BoxDecomposition:
            boxes = self._archive.front()
            special = nearest or not known.all()
            return BoxDecomposition(reference, values) if special else boxes

        return chosen.of(Knowledge(models, values, reference, beta, front, truncation, tails))

    def _should_draw(self, chosen: type[AcquisitionFunction]) -> bool:
        """Return whether the improvement is the mean over draws of the functions at noisy evaluations.

        Against the means alone, what is uncertain about a measured point promises an improvement at just
        that point, and the search stays there.
        """
        models = self._models
        return (
            issubclass(chosen, ExpectedHypervolumeImprovement)
            and len(models.objectives) > 1  # with one, it was not measured, and a start got stuck
            and not (models.trusts_readings(self._data) or models.varies)
            and bool(models.known.all() and self._archive.belief.feasible.any())
            and not any(model.contexts for model in models.objectives)
            and len(self._data) <= _MOST_DRAWN
            and self._archive.front().n_boxes <= _MOST_BOXES
        )

    def _is_informed(self, limit: tuple[GaussianProcess, float, float]) -> bool:
        """Return whether the readings of a constraint say anything of where it is met.

        They do not where none met it and all are alike, compared with what they lack, but for noise.
        """
        model, lower, upper = limit
        least, most = model.range
        lack = max(lower - most, least - upper)
        alike = _ALIKE if self._models.trusts_readings(self._data) else _ALIKE_BUT_FOR_NOISE
        if lack <= 0.0 or most - least > alike * lack:
            return True
        return not model.is_constant and model.skill > _SKILL


def _lack(values: Array, lower: float, upper: float) -> Array:
    """Return by how much values ``(n,)`` miss the limits; 0 where they are met."""
    return np.maximum(np.maximum(lower - values, values - upper), 0.0)
