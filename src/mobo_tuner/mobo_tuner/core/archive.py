"""What a run knows: its evaluations, the models that learned from them, and the front as it is believed."""

from __future__ import annotations

import math
from collections.abc import Mapping
from copy import copy
from typing import Any

import numpy as np

from mobo_tuner.core.belief import Belief, believe, is_certain, measured, probability_nondominated
from mobo_tuner.core.dataset import Dataset, Evaluation, Measured
from mobo_tuner.core.hypervolume import BoxDecomposition
from mobo_tuner.core.linear_algebra import single_blas_thread
from mobo_tuner.core.models import Models
from mobo_tuner.core.prior_mean import Prior
from mobo_tuner.core.problem import Array, Problem, ProblemError, as_float
from mobo_tuner.core.resolution import SAME
from mobo_tuner.core.settings import OptimizerSettings
from mobo_tuner.core.values import as_integer

_LONGEST_START = 4  # evaluations, as a multiple of the initial design, while most of them fail
_OFTEN_PACKED = 500  # evaluations up to which the boxes are built again after each training


class Archive:
    """The evaluations of a run and what follows from them.

    Args:
        problem: Problem that is tuned.
        settings: Settings of the optimiser.
        seed: Seed of every random choice.
        prior_means: Model or functions that predict some quantities, see `prior_mean`.

    Raises:
        ProblemError: If a prior mean is given for a quantity that is not modelled.

    Attributes:
        problem: Problem that is tuned, with the reference point that was inferred, if any.
        dataset: Evaluations so far.
        models: Models as of the last `update`.
        initial_evaluations: Number of points of the initial design.
        expected: Number of the last evaluations that are predictions, see `expecting`.
        hypervolume_measured: Hypervolume of the complete readings as they are, in the product of the
            objectives' units.
    """

    def __init__(
        self,
        problem: Problem,
        settings: OptimizerSettings,
        seed: int,
        prior_means: Prior | None,
    ) -> None:
        self.problem = problem
        self._given = problem
        self.dataset = Dataset(problem)
        self.models = Models(problem, settings, seed, prior_means)
        self.initial_evaluations = settings.initial_evaluations or _initial(problem, prior_means)
        self.expected = 0
        self.hypervolume_measured = 0.0
        self._settings = settings
        self._seed = seed
        self._boxes = _no_boxes(problem)  # of the readings
        self._packed = 0  # number of evaluations when these boxes were last built again
        # Of all that was told, each once it was needed:
        self._extended: Models | None = None
        self._belief: Belief | None = None
        self._believed_boxes: BoxDecomposition | None = None
        self._surprised: bool | None = None

    # ------------------------------------------------------------------ evaluations

    def tell(
        self,
        setpoint: Mapping[str, float],
        outputs: Mapping[str, Measured | None],
        readbacks: Mapping[str, float],
        failed: bool | None,
        time: float | None,
    ) -> Evaluation:
        """Add an evaluation; arguments and errors are those of `Optimizer.tell`."""
        evaluation = self.dataset.add(setpoint, outputs, readbacks, failed, time)
        self._forget_belief()
        if not self.problem.has_references:
            self._infer_references()
        elif evaluation.feasible:
            # A sum of gains never falls, unlike a volume computed again, by its last digit.
            self.hypervolume_measured += self._boxes.add(self._minimised(evaluation))
        return evaluation

    def forget(self, index: int, name: str | None) -> None:
        """Withdraw an evaluation or one diagnostic of it; see `Optimizer.forget`."""
        self.dataset.forget(index, name)
        self._learn_again()

    def unforget(self, index: int, name: str | None) -> None:
        """Take back what `forget` withdrew; see `Optimizer.unforget`."""
        self.dataset.unforget(index, name)
        self._learn_again()

    def update(self) -> None:
        """Update the models, training them when it is time to."""
        was_certain = self.is_certain
        trained = self.models.update(self.dataset)
        self._extended = None
        if trained and not (was_certain and self.is_certain):
            self._forget_belief()

    def expecting(self, *setpoints: Mapping[str, float]) -> Archive:
        """Return an archive as if evaluations at the set-points had read what the models predict.

        Its models have the hyperparameters of this one's last training. This archive is updated, and
        stays as it is otherwise.
        """
        with single_blas_thread():
            self.update()
            other = copy(self)
            other.dataset = self.dataset.copy()
            points = np.array([self.problem.normalize(setpoint) for setpoint in setpoints])
            lacks = np.array([self.dataset.lack(setpoint) for setpoint in setpoints])
            predicted = self.models.predicted(points, lacks)
            for row, setpoint in enumerate(setpoints):
                read = {name: float(means[row]) for name, means in predicted.items()}
                former = self._complete_at(points[row])
                if former is not None and self.is_certain:  # the machine reads the same again
                    read = {name: former.value(name) for name in read}
                other.dataset.add(setpoint, read, failed=False)
            other.expected += len(setpoints)
            other.models = self.models.expecting(other.dataset)
            other._forget_belief()
            if other.problem.has_references:
                other._pack(other.models.trained_rows)
        return other

    def _complete_at(self, point: Array) -> Evaluation | None:
        """Return the last complete evaluation at a point ``(d,)``."""
        data = self.dataset
        same = (np.abs(data.targets - point) <= SAME).all(axis=1) & data.complete & data.valid
        return data.evaluations[np.flatnonzero(same)[-1]] if same.any() else None

    def _infer_references(self) -> None:
        """Fill in what the reference point lacks when the initial design is done.

        It depends on as many evaluations as are needed, and so changes only if some of these are withdrawn.
        """
        data = self.dataset
        if len(data) < self.initial_evaluations:
            return
        problem = self._given.with_references(
            data.objectives, data.valid, data.feasible, self.initial_evaluations
        )
        if problem == self.problem:
            return
        self.problem = data.problem = problem
        self.models = Models(problem, self._settings, self._seed, self.models.means)
        self._count_hypervolume()

    def _learn_again(self) -> None:
        """Follow a change of what was told before."""
        self._forget_belief()
        self._infer_references()
        with single_blas_thread():
            self.models.forget(self.dataset)
        self._count_hypervolume()

    def _count_hypervolume(self) -> None:
        """Count the hypervolume of the readings again."""
        self._boxes, self._packed, self.hypervolume_measured = _no_boxes(self.problem), 0, 0.0
        if not self.problem.has_references:
            return
        gains = [
            self._boxes.add(self._minimised(e)) for e in self.dataset.evaluations if e.feasible
        ]
        self.hypervolume_measured = sum(gains, 0.0)

    def _minimised(self, evaluation: Evaluation) -> Array:
        """Return the minimised objectives of a complete evaluation `(P,)`."""
        return np.array([o.sign * evaluation.values[o.name] for o in self.problem.objectives])

    @property
    def is_short_of_readings(self) -> bool:
        """Whether so many of the first evaluations failed that the others are fewer than an initial design."""
        n, failed = len(self.dataset), int(self.dataset.failed.sum())
        return (
            n - failed < self.initial_evaluations <= n < _LONGEST_START * self.initial_evaluations
        )

    # ------------------------------------------------------------------ belief

    @property
    def is_certain(self) -> bool:
        """Whether every reading counts as it is and none is missing."""
        # The paper takes readings as they are, and its training is too slow for a belief after each.
        as_they_are = self._settings.training == "adam" and not self.models.varies
        return as_they_are or (is_certain(self.dataset, self.models) and not self._is_surprised)

    @property
    def _is_surprised(self) -> bool:
        """Whether the models rule out a reading that they have not learned yet."""
        if self._surprised is None:
            self._surprised = self.models.is_surprised(self.dataset)
        return self._surprised

    @property
    def suspected(self) -> list[tuple[int, str]]:
        """Suspected readings, by index and diagnostic."""
        models = self.extended_models if self._is_surprised else self.models
        names = self.problem.required_diagnostics
        return sorted((int(i), name) for name in names for i in models.suspects(name))

    @property
    def extended_models(self) -> Models:
        """Models that know all that was told, with the hyperparameters of the last training."""
        if self._extended is None:
            with single_blas_thread():
                self._extended = self.models.extended(self.dataset)
        return self._extended

    @property
    def belief(self) -> Belief:
        """Belief about the evaluations: readings where they can be trusted, else the models' means."""
        if self._belief is None:
            if self.is_certain:
                self._belief = measured(self.dataset)
            else:
                with single_blas_thread():
                    self._belief = believe(self.dataset, self.extended_models)
        return self._belief

    @property
    def hypervolume(self) -> float:
        """Hypervolume of what is believed, in the product of the objectives' units."""
        if self.is_certain or not self.problem.has_references:
            return self.hypervolume_measured
        return self._believed_front().hypervolume

    def front(self) -> BoxDecomposition:
        """Return the boxes that the front of what is believed does not dominate."""
        boxes = self._measured_front()
        return boxes if self.is_certain else self._believed_front()

    def pareto_front(self, as_measured: bool, with_probability: bool) -> list[dict[str, Any]]:
        """Return the points of the front, see `Optimizer.pareto_front`.

        Args:
            as_measured: Whether to take complete readings as they are, in place of what is believed.
            with_probability: Whether to compute the probability of each to be non-dominated.
        """
        certain = as_measured or self.is_certain
        belief = measured(self.dataset) if certain else self.belief
        probabilities = np.ones(len(self.dataset))
        if with_probability and not certain:
            rng = np.random.default_rng([self._seed, 5, len(self.dataset)])
            with single_blas_thread():
                probabilities = probability_nondominated(
                    self.dataset, self.extended_models, belief, rng
                )
        names = self.problem.objective_names
        signs = np.array([o.sign for o in self.problem.objectives])
        front = []
        for row in belief.front_rows():
            evaluation = self.dataset.evaluations[row]
            values = (signs * belief.objectives[row]).tolist()
            predicted = zip(names, belief.predicted[row], strict=True)
            point = {
                "index": evaluation.index,
                "setpoint": dict(evaluation.setpoint),
                "objectives": dict(zip(names, values, strict=True)),
                "stddevs": dict(zip(names, belief.stddevs[row].tolist(), strict=True)),
                "predicted": [name for name, is_predicted in predicted if is_predicted],
            }
            if with_probability:
                point["probability"] = float(probabilities[row])
            front.append(point)
        return front

    def _forget_belief(self) -> None:
        self._extended = self._belief = self._believed_boxes = self._surprised = None

    def _believed_front(self) -> BoxDecomposition:
        if self._believed_boxes is None:
            belief = self.belief
            self._believed_boxes = BoxDecomposition(
                self.problem.reference_point, belief.objectives[belief.feasible]
            )
        return self._believed_boxes

    def _measured_front(self) -> BoxDecomposition:
        """Return the boxes of the readings, built again when the models were trained.

        In between they grow, which is slower to sum over but saves time. They depend on the data and
        the last training only, so that a restored optimiser has the same ones.
        """
        trained = self.models.trained_rows
        if self._packed == trained or (trained > _OFTEN_PACKED and trained < 1.2 * self._packed):
            return self._boxes
        if trained > _OFTEN_PACKED and self._settings.suggestion_seconds is not None:
            return self._boxes
        self._pack(trained)
        return self._boxes

    def _pack(self, trained: int) -> None:
        """Build the boxes of the first evaluations at once, and add the others."""
        feasible = np.flatnonzero(self.dataset.feasible)
        objectives = self.dataset.objectives
        rows = feasible[feasible < trained]
        self._boxes = BoxDecomposition(self.problem.reference_point, objectives[rows])
        for row in feasible[len(rows) :]:
            self._boxes.add(objectives[row])
        self._packed = trained

    # ------------------------------------------------------------------ state

    def get_state(self) -> dict[str, Any]:
        """Return what `set_state` needs beside the evaluations, as data for JSON."""
        return {
            "hypervolume": self.hypervolume_measured,
            "packed": self._packed,
            "models": self.models.get_state(),
            "forgotten": [list(each) for each in self.dataset.withdrawn],
        }

    def set_state(self, state: Mapping[str, Any]) -> None:
        """Become the archive that `get_state` came from, given that the same evaluations were told.

        Raises:
            ProblemError: If a value is not allowed or does not suit the evaluations.
        """
        for index, name in state["forgotten"]:
            self.forget(index, name)
        self.hypervolume_measured = as_float("the state's hypervolume", state["hypervolume"])
        if not 0.0 <= self.hypervolume_measured < math.inf:
            raise ProblemError(f"the state's hypervolume is {self.hypervolume_measured}")
        self.models.set_state(state["models"], self.dataset)
        packed = as_integer("the state's packed", state["packed"], 0)
        if packed and self.problem.has_references:
            self._pack(min(packed, len(self.dataset)))


def _initial(problem: Problem, prior_means: Prior | None) -> int:
    """Return the number of points of the initial design.

    It needs to show less where a model is known, and more where the reference point is inferred from it or
    where it is done at the lowest cost, and shows how far fidelities agree.
    """
    d = len(problem.variables)
    if not problem.has_references or problem.fidelity:
        return 2 * (d + 1)
    return 1 + (d + 1) // 3 if prior_means else d + 2


def _no_boxes(problem: Problem) -> BoxDecomposition:
    """Return the boxes of an empty front, of no use before there is a reference point."""
    reference = problem.reference_point
    return BoxDecomposition(np.where(np.isfinite(reference), reference, 0.0))
