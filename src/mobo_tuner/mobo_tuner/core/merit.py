"""The merit of measuring at a point, by what is known: the acquisition function and the expected gain.

.. [Daulton2021] S. Daulton, M. Balandat, E. Bakshy, "Parallel Bayesian optimization of multiple noisy
   objectives with expected hypervolume improvement", NeurIPS 34, 2187 (2021).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import partial, reduce
from operator import mul

import numpy as np

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
from mobo_tuner.core.belief import believe
from mobo_tuner.core.constraints import ProbabilityOfFeasibility, ValidityWeight, violation
from mobo_tuner.core.gaussian_process import GaussianProcess
from mobo_tuner.core.hints import nearest_to_reference
from mobo_tuner.core.hypervolume import BoxDecomposition
from mobo_tuner.core.models import Models
from mobo_tuner.core.problem import Array
from mobo_tuner.core.proximal import ProximalBiasing
from mobo_tuner.core.scalarisation import WeightedSum
from mobo_tuner.core.settings import OptimizerSettings

_ALIKE = 1.0  # range of a constraint's readings, as a share of what they lack
_ALIKE_BUT_FOR_NOISE = 4.0  # the same where readings are noisy
_MOST_FAILURES = 3  # in a row, after which the search goes back to what was valid
_MOST_HALVINGS = 12
_HOPELESS = 1e-4  # expected improvement of each objective, as a share of its spread
_DRAWS = 8  # of the function at noisy evaluations
_MOST_DRAWN = 100  # evaluations up to which it is drawn; many are known well by their means
_MOST_BOXES = 100  # of the believed front, up to which one for each draw takes little time
_LARGEST_STEP = 0.3  # towards a limit out of reach, in standard deviations of the readings
_SKILL = 0.5  # least share of their variance that a model must explain to be followed


class Merit:
    """What measuring at a point is worth, by the models of an archive's last update.

    Args:
        archive: Evaluations and models.
        settings: Settings of the optimiser.
        seed: Seed of every random choice.
    """

    def __init__(self, archive: Archive, settings: OptimizerSettings, seed: int) -> None:
        self._archive = archive
        self._problem, self._data, self._models = archive.problem, archive.dataset, archive.models
        self._settings = settings
        self._seed = seed

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
        models = self._models
        limits = models.constraints
        factors = self._factors(limits)
        # Without a feasible point there is no front to improve: feasibility comes first.
        if limits and not (models.known.any() and self._archive.belief.feasible.any()):
            if not all(map(self._is_informed, limits)):
                return None
            return reduce(mul, self._factors(self._half_way()) if nearest else factors)
        if all(m.is_constant for m in models.objectives if m.n):
            return None
        if not self._problem.has_references:  # some objective was never measured
            return None
        if not nearest and self._should_draw():
            return reduce(mul, [self._mean_of_draws(tails), *self._factors([])])
        return reduce(mul, [self._improvement(models, nearest, tails), *factors])

    def weight(self, feasible: bool) -> AcquisitionFunction | None:
        """Return the factors of the acquisition function without the improvement; None if there are none.

        Args:
            feasible: Whether those constraints count of which the readings say where they are met.
        """
        limits = self._models.constraints if feasible else []
        factors = self._factors([limit for limit in limits if self._is_informed(limit)])
        return reduce(mul, factors) if factors else None

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

    def is_out_of_reach(self, found: Array | None) -> bool:
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
        improvement = self._improvement(self._models).log_value(found[None])[0]
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

    def _half_way(self) -> list[tuple[GaussianProcess, float, float]]:
        """Return the constraints with limits half-way to them from the evaluation that lacks least.

        Where the models are certain that nothing is feasible, the probability is largest where they know
        least, which are the corners; they still know where the readings become better. Half-way to a limit
        that is far out of reach they are as certain, so that the step there is limited.
        """
        limits = self._models.constraints
        measured = self._data.inputs[self._data.valid]
        believed = [model.predict(measured)[0] for model, _, _ in limits]
        lacks = [
            violation(values, lower, upper) / (model.spread or 1.0)
            for values, (model, lower, upper) in zip(believed, limits, strict=True)
        ]
        nearest = int(np.sum(lacks, axis=0).argmin())
        halves = []
        for (model, lower, upper), values in zip(limits, believed, strict=True):
            at, most = float(values[nearest]), _LARGEST_STEP * (model.spread or math.inf)
            low, high = at + min(0.5 * (lower - at), most), at + max(0.5 * (upper - at), -most)
            halves.append((model, min(lower, low), max(upper, high)))
        return halves

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

    def _improvement(
        self, models: Models, nearest: bool = False, tails: bool = True
    ) -> AcquisitionFunction:
        """Return the acquisition function of the objectives that were measured at least once.

        Args:
            models: Models of the archive, or a draw of them.
            nearest: Whether the evaluation that comes nearest to the reference point takes its place
                where that is better than it.
            tails: Whether improvements that underflow are needed.
        """
        settings, known = self._settings, models.known
        belief = self._archive.belief if models is self._models else believe(self._data, models)
        chosen = ACQUISITION_FUNCTIONS.find(settings.acquisition)
        objectives = tuple(m for m, k in zip(models.objectives, known, strict=True) if k)
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
            summed: tuple[Model, ...] = (WeightedSum(objectives, weights),)
            sums = (values @ weights)[:, None]
            worst = np.array([sums.max() if nearest else reference @ weights])
            least = partial(BoxDecomposition, worst, sums)
            return chosen.of(Knowledge(summed, sums, worst, beta, least))
        truncation = (lower, reference) if np.isfinite(lower).any() else None

        def front() -> BoxDecomposition:
            if models is self._models and known.all() and not nearest:
                return self._archive.front()
            return BoxDecomposition(reference, values)

        return chosen.of(Knowledge(objectives, values, reference, beta, front, truncation, tails))

    def _mean_of_draws(self, tails: bool) -> AcquisitionFunction:
        """Return the mean of improvement times probability of feasibility over draws of the outputs.

        In each draw, every output is known at all evaluations, and so are the front and what is feasible:
        the noisy expected hypervolume improvement of [Daulton2021]_.
        """
        rng = np.random.default_rng([self._seed, 6, len(self._data)])
        functions = []
        for models in self._models.drawn(_DRAWS, rng):
            limits = [ProbabilityOfFeasibility(*limit) for limit in models.constraints]
            functions.append(reduce(mul, [self._improvement(models, tails=tails), *limits]))
        return Average(functions)

    def _should_draw(self) -> bool:
        """Return whether the improvement is the mean over draws of the functions at noisy evaluations.

        Against the means alone, what is uncertain about a measured point promises an improvement at just
        that point, and the search stays there.
        """
        chosen, models = ACQUISITION_FUNCTIONS.find(self._settings.acquisition), self._models
        return (
            issubclass(chosen, ExpectedHypervolumeImprovement)
            and not (models.trusts_readings(self._data) or models.varies)
            and bool(models.known.all() and self._archive.belief.feasible.any())
            and not any(model.contexts for model in models.objectives)
            and len(self._data) <= _MOST_DRAWN
            and self._archive.front().n_boxes <= _MOST_BOXES
        )
