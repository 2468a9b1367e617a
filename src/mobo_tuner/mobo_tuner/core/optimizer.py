"""Ask and tell: where to measure next, and what was measured."""

from __future__ import annotations

import json
import math
import os
import time
import warnings
from collections.abc import Mapping
from difflib import get_close_matches
from functools import partial, reduce
from operator import mul
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from mobo_tuner.core.acquisition import (
    ACQUISITION_FUNCTIONS,
    AcquisitionFunction,
    Knowledge,
    Model,
    beta_schedule,
)
from mobo_tuner.core.belief import Belief, believe, is_certain, probability_nondominated
from mobo_tuner.core.belief import measured as _measured
from mobo_tuner.core.constraints import ProbabilityOfFeasibility, ValidityWeight
from mobo_tuner.core.dataset import BoolArray, Dataset, Evaluation, Measured
from mobo_tuner.core.exploration import explore
from mobo_tuner.core.focus import around, choose_on_front
from mobo_tuner.core.gaussian_process import GaussianProcess
from mobo_tuner.core.hints import hints, nearest_to_reference
from mobo_tuner.core.hypervolume import BoxDecomposition
from mobo_tuner.core.initial_design import initial_design
from mobo_tuner.core.linear_algebra import single_blas_thread
from mobo_tuner.core.models import Models, PriorMean
from mobo_tuner.core.predicted_front import predict_front
from mobo_tuner.core.problem import Array, Problem, ProblemError, as_float
from mobo_tuner.core.proximal import ProximalBiasing
from mobo_tuner.core.resolution import Taken, taken
from mobo_tuner.core.scalarisation import WeightedSum
from mobo_tuner.core.settings import make_settings
from mobo_tuner.errors import UserError

Source = Literal["initial", "model"]

STATE_VERSION = 2
# A failed set-point is not proposed again within 1 % of every variable's range.
FAILED_TOLERANCE = 0.02
# A suspected reading that is better than believed is confirmed 1 % of every variable's range beside it.
CONFIRMING_STEP = 0.02
# A set-point within 0.05 % of every variable's range of a measured one must promise something new.
_NEAR = 1e-3
_ALIKE = 0.05  # range of a constraint's readings, as a share of what they lack
_OFTEN_PACKED = 500  # evaluations up to which the boxes are built again after each training
_HOPELESS = 1e-4  # expected improvement of each objective, as a share of its spread
_SKILL = 0.5  # least share of their variance that a model must explain to be followed


class Optimizer:
    """Multi-objective Bayesian optimisation, one set-point at a time ([Roussel2021]_ algo:BO).

    The first `initial_evaluations` set-points come from a space-filling design, every later one from
    maximising the acquisition function over Gaussian processes of all that was told. What `ask`
    returns depends on the problem, the settings, the seed and what was told and asked before; asking
    twice gives the same answer.

    Args:
        problem: what is tuned.
        preset: "default", or "paper" for the paper's recipe to the letter.
        seed: of every random choice, at least 0.
        prior_means: for some objectives or constrained diagnostics a function that predicts them,
            such as a surrogate of the machine, from one array per variable; the Gaussian process
            then learns the difference.
        overrides: single choices in place of the preset's, see `settings.OptimizerSettings`.

    Raises:
        ProblemError: a choice is unknown, not allowed or does not suit the problem.
    """

    def __init__(
        self,
        problem: Problem,
        preset: str = "default",
        seed: int = 0,
        prior_means: Mapping[str, PriorMean] | None = None,
        **overrides: Any,
    ) -> None:
        if not isinstance(problem, Problem):
            raise ProblemError(f"problem must be a Problem, not {problem!r:.60}")
        if isinstance(seed, bool) or not isinstance(seed, int) or seed < 0:
            raise ProblemError(f"seed is {seed!r}; a whole number of at least 0 is allowed")
        self.problem = problem
        self._given = problem  # before what it left out was inferred
        self.seed = seed
        self.settings = make_settings(preset, overrides)
        self.settings.check_problem(problem)
        self.dataset = Dataset(problem)
        self._prior_means = prior_means
        self._models = Models(problem, self.settings, seed, prior_means)
        self._boxes = _no_boxes(problem)
        self._packed = 0  # number of evaluations when the boxes were last built again
        self._hypervolume = 0.0
        # Of all that was told, each once it was needed:
        self._extended: Models | None = None
        self._belief: Belief | None = None
        self._believed_boxes: BoxDecomposition | None = None
        self._last_source: Source = "initial"
        self._deadline = math.inf  # of the present suggestion, of `time.monotonic`
        self._told: set[str] = set()  # outputs that were told, or are known to be misspelt

    @property
    def given_problem(self) -> Problem:
        """The problem as it was given; that of `problem` has what its reference point left out."""
        return self._given

    @property
    def initial_evaluations(self) -> int:
        """Number of points of the initial design."""
        return self.settings.initial_evaluations or 2 * (len(self.problem.variables) + 1)

    @property
    def last_source(self) -> Source:
        """Where the set-point asked for last came from."""
        return self._last_source

    @property
    def hypervolume(self) -> float:
        """Hypervolume of the front against the reference point, in the product of the objectives' units.

        It is that of what is believed: readings where they can be trusted, else the models' means.
        """
        if self._is_certain or not self.problem.has_references:
            return self._hypervolume
        return self._believed_front().hypervolume

    @property
    def suspected(self) -> list[tuple[int, str]]:
        """Readings that are nothing like the rest, by index and diagnostic, as of the last training.

        They count as not measured until later readings confirm them.
        """
        names = self.problem.required_diagnostics
        return sorted((int(i), name) for name in names for i in self._models.suspects(name))

    @property
    def hypervolume_measured(self) -> float:
        """Hypervolume of the complete readings as they are, as for `hypervolume`."""
        return self._hypervolume

    def pareto_front(
        self, measured: bool = False, *, probability: bool = True
    ) -> list[dict[str, Any]]:
        """Return the points that are feasible, non-dominated and strictly better than the reference point.

        Args:
            measured: Whether to take complete readings as they are, in place of what is believed.
            probability: Whether to compute probabilities, in twice the time if readings are noisy.

        Returns:
            For each point `index`, `setpoint`, `objectives` and their `stddevs`, in their own units,
            `predicted`, the names of the objectives that were not measured there, and `probability`
            of the point to be non-dominated among all evaluations, if it is computed.
        """
        certain = measured or self._is_certain
        belief = _measured(self.dataset) if certain else self._believed()
        probabilities = None
        if probability and certain:
            probabilities = np.ones(len(self.dataset))
        elif probability:
            rng = np.random.default_rng([self.seed, 5, len(self.dataset)])
            with single_blas_thread():
                probabilities = probability_nondominated(self.dataset, self.models, belief, rng)
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
            if probabilities is not None:
                point["probability"] = float(probabilities[row])
            front.append(point)
        return front

    def tell(
        self,
        setpoint: Mapping[str, float],
        outputs: Mapping[str, Measured | None],
        readbacks: Mapping[str, float] = {},
        failed: bool | None = None,
    ) -> Evaluation:
        """Learn what was measured at a set-point, which need not have been asked for.

        Args:
            setpoint: Every variable, in physical units.
            outputs: Diagnostics by name; a pair is (mean, standard deviation); NaN, None or missing
                means not measured: what was measured is learned all the same.
            readbacks: Some or all variables, in physical units: where the machine was while it
                measured. The models learn from them in place of the set-point's values.
            failed: Whether the machine reported a failure; None lets the outputs decide: the
                evaluation failed if no objective and no constrained diagnostic was measured.

        Raises:
            ProblemError: If the set-point or a readback does not fit the problem, or an output is not
                a number; nothing is learned.
        """
        evaluation = self.dataset.add(setpoint, outputs, readbacks, failed)
        self._forget_belief()
        self._warn_of_misspelt(outputs)
        if not self.problem.has_references:
            self._infer_references()
        elif evaluation.feasible:
            # A sum of gains never falls, unlike a volume computed again, by its last digit.
            self._hypervolume += self._boxes.add(self._minimised(evaluation))
        return evaluation

    def forget(self, index: int, name: str | None = None) -> None:
        """Withdraw an evaluation, or one diagnostic of it, as if it had never been measured.

        Args:
            index: Index of the evaluation.
            name: Diagnostic to withdraw; the whole evaluation without it.

        Raises:
            ProblemError: If there is no such evaluation or it has no such diagnostic.
        """
        self.dataset.forget(index, name)
        self._learn_again()

    def unforget(self, index: int, name: str | None = None) -> None:
        """Take back what `forget` withdrew: one diagnostic, or all of an evaluation.

        Arguments and errors are those of `forget`.
        """
        self.dataset.unforget(index, name)
        self._learn_again()

    def _infer_references(self) -> None:
        """Fill in what the reference point lacks, once and for all, when the initial design is done."""
        data = self.dataset
        if len(data) < self.initial_evaluations:
            return
        problem = self.problem.with_references(
            data.objectives, data.valid, data.feasible, self.initial_evaluations
        )
        if problem.has_references:
            self.problem = data.problem = problem
            self._models = Models(problem, self.settings, self.seed, self._prior_means)
            self._count_hypervolume()

    def _learn_again(self) -> None:
        """Follow a change of what was told before."""
        self._forget_belief()
        with single_blas_thread():
            self._models.forget(self.dataset)
        if self.problem.has_references:
            self._count_hypervolume()

    def _count_hypervolume(self) -> None:
        """Count the hypervolume of the readings again."""
        self._boxes = BoxDecomposition(self.problem.reference_point)
        self._packed = 0
        self._hypervolume = sum(
            self._boxes.add(self._minimised(e)) for e in self.dataset.evaluations if e.feasible
        )

    def _minimised(self, evaluation: Evaluation) -> Array:
        """Return the objectives of a complete evaluation as they are minimised, shape ``(P,)``."""
        return np.array([o.sign * evaluation.values[o.name] for o in self.problem.objectives])

    @property
    def _is_certain(self) -> bool:
        """Whether every reading counts as it is and none is missing."""
        # The paper takes readings as they are, and its training is too slow for a belief after each.
        return self.settings.training == "adam" or is_certain(self.dataset, self._models)

    def _believed(self) -> Belief:
        """Return what is believed of the evaluations so far."""
        if self._belief is None:
            if self._is_certain:
                self._belief = _measured(self.dataset)
            else:
                with single_blas_thread():
                    self._belief = believe(self.dataset, self.models)
        return self._belief

    def _believed_front(self) -> BoxDecomposition:
        """Return the boxes of what is believed, for all objectives."""
        if self._believed_boxes is None:
            belief = self._believed()
            self._believed_boxes = BoxDecomposition(
                self.problem.reference_point, belief.objectives[belief.feasible]
            )
        return self._believed_boxes

    def _forget_belief(self) -> None:
        self._extended = self._belief = self._believed_boxes = None

    def _update_models(self) -> None:
        was_certain = self._is_certain
        trained = self._models.update(self.dataset)
        self._extended = None
        if trained and not (was_certain and self._is_certain):
            self._forget_belief()

    def _warn_of_misspelt(self, outputs: Mapping[str, Any]) -> None:
        """Warn, once for each, of an unknown output that looks like one that was never told."""
        problem = self.problem
        known = {*problem.required_diagnostics, *(o.name for o in problem.observables)}
        unknown = outputs.keys() - known
        if not unknown:
            return
        for name in known - self._told - outputs.keys():
            for match in get_close_matches(name, unknown, n=1, cutoff=0.75):
                self._told.add(name)
                warnings.warn(
                    f"the output '{match}' is unknown to the problem, and '{name}' is missing",
                    stacklevel=3,
                )
        self._told |= known & outputs.keys()

    @property
    def models(self) -> Models:
        """Models that know all that was told, with the hyperparameters of the last training.

        They are trained here if they were not yet. Nothing that this optimiser asks later depends on it.
        """
        if self._extended is None:
            with single_blas_thread():
                self._extended = self._models.extended(self.dataset)
        return self._extended

    def hints(self) -> list[str]:
        """Return what keeps the front empty, one sentence each; none once there is a front.

        For example that no point is better than the reference in one objective, and by how much, that
        a constraint was never met, or that all readings of a diagnostic are alike.
        """
        return hints(self.dataset, self._believed())

    def ask(self) -> dict[str, float]:
        """The set-point to evaluate next, in physical units and inside the bounds."""
        told = len(self.dataset)
        if told < self.initial_evaluations:
            self._last_source = "initial"
            return self.problem.denormalize(self._initial_point(told))
        self._last_source = "model"
        with single_blas_thread():
            return self.problem.denormalize(self._candidate())

    def catch_up(self) -> None:
        """Do what `ask` does but for the search: what is asked later is as if `ask` had been called.

        So a run is replayed without the time of its suggestions.
        """
        if len(self.dataset) >= self.initial_evaluations:
            self._update_models()
            if self._models.ready:
                self._acquisition_function()

    def focus(
        self,
        index: int | None = None,
        weights: Mapping[str, float] | None = None,
        radius: float = 0.2,
        bounds: Problem | None = None,
    ) -> Optimizer:
        """Go on with a single objective around a point of the front ([Roussel2021]_, sec:conclusion).

        The new optimiser minimises the weighted sum of the minimised objectives by expected
        improvement, within `radius` of the point, and knows all that this one was told. All other
        choices are those of this one.

        Args:
            index: evaluation of the chosen point; the front's best by `weights` where None.
            weights: one for each objective, in the inverse of its unit. Where None, each is one over
                the point's distance to the reference point: then the sum falls where the volume
                between the two grows.
            radius: of the new bounds around the point, as a share of each variable's range.
            bounds: problem whose bounds must hold, too, where they were changed since.

        Raises:
            ProblemError: the point is not on the front or outside the bounds, the weights do not fit,
                or neither is given.
        """
        chosen, sums = choose_on_front(self.problem, self.pareto_front(), index, weights)
        changes = {"acquisition": "ei", "weights": sums, "initial_evaluations": 1}
        focused = self._like_this(around(self.problem, chosen, radius, bounds), changes)
        self._tell_all_to(focused)
        return focused

    def with_problem(self, problem: Problem) -> Optimizer:
        """Go on with another problem of the same variables, knowing all that was told.

        Bounds, objectives, constraints, costs and the truncation box may differ; evaluations outside
        new bounds stay. The new optimiser's models are trained again, so that what it asks depends on
        the problem and what was told, and not on when the problem was changed.

        Raises:
            ProblemError: the variables are others, or the settings do not suit the problem.
        """
        if not isinstance(problem, Problem):
            raise ProblemError(f"problem must be a Problem, not {problem!r:.60}")
        if set(problem.variable_names) != set(self.problem.variable_names):
            raise ProblemError(
                f"the variables are {', '.join(problem.variable_names)}; with what was measured "
                f"only {', '.join(self.problem.variable_names)} are allowed"
            )
        changed = self._like_this(problem)
        self._tell_all_to(changed)
        return changed

    def predicted_front(self, size: int = 100) -> list[dict[str, Any]]:
        """The front as the models predict it where nothing was measured yet.

        The models are trained again for it: nothing that this optimiser asks later depends on it.

        Args:
            size: most points of the front.

        Returns:
            Set-point, objectives and their standard deviations (`stddevs`) of each point, in their
            own units; empty where no evaluation is valid or nothing good is predicted.

        Raises:
            ProblemError: the size is not a whole number of at least 1.
        """
        if isinstance(size, bool) or not isinstance(size, int) or size < 1:
            raise ProblemError(f"size is {size!r}; a whole number of at least 1 is allowed")
        if not self.dataset.valid.any():
            return []
        models = Models(self.problem, self.settings, self.seed, self._prior_means)
        models.update(self.dataset)
        rng = np.random.default_rng([self.seed, 3, len(self.dataset)])
        known = self.dataset.inputs[self._believed().front_rows()]
        front = predict_front(self.problem, models, known, rng, size)
        signs = [o.sign for o in self.problem.objectives]
        names = self.problem.objective_names
        return [
            {
                "setpoint": self.problem.denormalize(x),
                "objectives": dict(zip(names, (signs * means).tolist(), strict=True)),
                "stddevs": dict(zip(names, stddevs.tolist(), strict=True)),
            }
            for x, means, stddevs in zip(*front, strict=True)
        ]

    def _like_this(self, problem: Problem, changes: Mapping[str, Any] = {}) -> Optimizer:
        """An optimiser of another problem that knows nothing yet, with these choices but for some."""
        choices = self.settings.to_dict() | dict(changes)
        return Optimizer(problem, seed=self.seed, prior_means=self._prior_means, **choices)

    def _tell_all_to(self, other: Optimizer) -> None:
        for e in self.dataset.evaluations:
            outputs = {n: (v, e.stddevs[n]) for n, v in e.values.items()}
            other.tell(e.setpoint, outputs, e.readbacks, e.reported_failed)
        for index, name in self.dataset.withdrawn:
            other.forget(index, name)

    # ------------------------------------------------------------------ state

    def get_state(self, *, with_evaluations: bool = True) -> dict[str, Any]:
        """Return the state for `from_state`, which continues with the same suggestions, as data for JSON.

        Args:
            with_evaluations: whether they are part of it; who keeps them elsewhere puts them in
                again as `evaluations`, and what is left does not grow with their number.
        """
        state: dict[str, Any] = {
            "version": STATE_VERSION,
            "problem": self._given.to_dict(),
            "settings": self.settings.to_dict(),
            "seed": self.seed,
            "hypervolume": self._hypervolume,
            "packed": self._packed,
            "models": self._models.get_state(),
            "forgotten": [list(each) for each in self.dataset.withdrawn],
        }
        if with_evaluations:
            state["evaluations"] = [
                {
                    "setpoint": dict(e.setpoint),
                    "outputs": {n: [v, e.stddevs[n]] for n, v in e.values.items()},
                    "readbacks": dict(e.readbacks),
                    "failed": e.reported_failed,
                }
                for e in self.dataset.evaluations
            ]
        return state

    @classmethod
    def from_state(
        cls, state: Mapping[str, Any], prior_means: Mapping[str, PriorMean] | None = None
    ) -> Optimizer:
        """The optimiser that `get_state` came from; it asks what that one would have asked.

        Args:
            state: from `get_state`, also after a passage through JSON.
            prior_means: the same functions again, where there were some.

        Raises:
            ProblemError: the state is of another version, incomplete or damaged.
        """
        if not isinstance(state, Mapping) or state.get("version") != STATE_VERSION:
            version = state.get("version") if isinstance(state, Mapping) else None
            raise ProblemError(f"the state is of version {version!r}; {STATE_VERSION} is allowed")
        try:
            return cls._restored(state, prior_means)
        except UserError:
            raise
        except KeyError as error:
            raise ProblemError(f"the state lacks {error}") from None
        except (TypeError, ValueError, AttributeError, LookupError, ArithmeticError) as error:
            raise ProblemError(f"the state is not one that get_state gave: {error}") from None

    @classmethod
    def _restored(
        cls, state: Mapping[str, Any], prior_means: Mapping[str, PriorMean] | None
    ) -> Optimizer:
        restored = cls(
            Problem.from_dict(state["problem"]),
            seed=state["seed"],
            prior_means=prior_means,
            **state["settings"],
        )
        for evaluation in state["evaluations"]:
            outputs = {n: (pair[0], pair[1]) for n, pair in evaluation["outputs"].items()}
            restored.tell(
                evaluation["setpoint"],
                outputs,
                evaluation.get("readbacks", {}),
                evaluation.get("failed"),
            )
        for index, name in state["forgotten"]:
            restored.forget(index, name)
        restored._hypervolume = as_float("the state's hypervolume", state["hypervolume"])
        if not 0.0 <= restored._hypervolume < math.inf:
            raise ProblemError(f"the state's hypervolume is {restored._hypervolume}")
        restored._models.set_state(state["models"], restored.dataset)
        packed = state["packed"]
        if isinstance(packed, bool) or not isinstance(packed, int) or packed < 0:
            raise ProblemError(f"the state's boxes hold {packed!r} evaluations")
        if packed and restored.problem.has_references:
            restored._pack(min(packed, len(restored.dataset)))
        return restored

    def save(self, path: str | Path) -> None:
        """Write the state to a JSON file, replacing an older one only when it is complete."""
        partial = Path(f"{path}.partial")
        partial.write_text(json.dumps(self.get_state()), encoding="utf-8")
        os.replace(partial, path)

    @classmethod
    def load(
        cls, path: str | Path, prior_means: Mapping[str, PriorMean] | None = None
    ) -> Optimizer:
        """Read what `save` wrote.

        Raises:
            ProblemError: the file cannot be read or holds no state.
        """
        try:
            state = json.loads(Path(path).read_text(encoding="utf-8"))
        except OSError as error:
            raise ProblemError(f"the file '{path}' cannot be read: {error.strerror}") from None
        except ValueError:
            raise ProblemError(f"the file '{path}' is not JSON") from None
        if not isinstance(state, dict):
            raise ProblemError(f"the file '{path}' holds no state of an optimiser")
        return cls.from_state(state, prior_means)

    # ------------------------------------------------------------------ candidates

    def _initial_point(self, index: int) -> Array:
        design = initial_design(
            self.settings.initial_design,
            self.initial_evaluations,
            len(self.problem.variables),
            self.seed,
        )
        point: Array = np.asarray(design[index])
        used = taken(self.dataset)
        if used.contains(point[None])[0] and not self._models.is_noisy(self.dataset):
            rng = np.random.default_rng([self.seed, 4, index])
            return explore(self.dataset.inputs, used, rng)
        return point

    def _candidate(self) -> Array:
        """The maximum of the acquisition function, shape ``(d,)``; exploration where it is zero."""
        seconds = self.settings.suggestion_seconds
        self._deadline = math.inf if seconds is None else time.monotonic() + seconds
        self._update_models()
        rng = np.random.default_rng([self.seed, 2, len(self.dataset)])
        inputs, failed = self.dataset.inputs, self.dataset.failed
        if not self._models.ready:
            return explore(inputs, taken(self.dataset), rng)
        unconfirmed = self._unconfirmed()
        if unconfirmed is not None:
            return unconfirmed
        acquisition = self._acquisition_function(tails=False)
        if acquisition is None:
            return self._explored(rng)
        found = self._maximum(acquisition, rng, inputs[failed], FAILED_TOLERANCE)
        if self._is_out_of_reach(found):
            acquisition = self._acquisition_function(nearest=True) or acquisition
            found = self._maximum(acquisition, rng, inputs[failed], FAILED_TOLERANCE)
        elif found is None:
            acquisition = self._acquisition_function() or acquisition
            found = self._maximum(acquisition, rng, inputs[failed], FAILED_TOLERANCE)
        if found is None:
            return self._explored(rng)
        used = taken(self.dataset)
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

    def _unconfirmed(self) -> Array | None:
        """Return a point beside a suspected reading that is better than believed, shape ``(d,)``.

        What is worse than believed shows by itself if it is right: the search comes there again. None
        if there is no such reading, or if each was looked at already.
        """
        if not self._models.has_suspects:
            return None
        data, inputs, belief = self.dataset, self.dataset.inputs, self._believed()
        better = (data.objectives < belief.objectives).any(axis=1)
        better |= data.feasible & ~belief.feasible
        for index in sorted({index for index, _ in self.suspected}):
            if not better[index]:
                continue
            distances = np.abs(inputs[index + 1 :] - inputs[index]).max(axis=1)
            if (distances[data.valid[index + 1 :]] > 2.0 * CONFIRMING_STEP).all():
                inward = np.where(inputs[index] > 0.0, -1.0, 1.0)
                return np.asarray(inputs[index] + CONFIRMING_STEP * inward)
        return None

    @property
    def _seconds_left(self) -> float | None:
        """Time for the rest of the suggestion [s]; None where there is no limit."""
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
        maximum = self.settings.make_maximizer().maximize(
            acquisition,
            len(self.problem.variables),
            rng,
            starts=self.dataset.inputs[self._believed().front_rows()],
            excluded=excluded,
            tolerance=tolerance,
            seconds=self._seconds_left,
        )
        return None if maximum is None else maximum.x

    def _is_out_of_reach(self, found: Array | None) -> bool:
        """Return whether no evaluation is better than the reference point, nor will be at `found`.

        There is next to no improvement even at the best candidate, compared with the spread of the
        readings. Then the search is for an improvement on the point that comes nearest.
        """
        belief = self._believed()
        if not belief.feasible.any() or len(belief.front_rows()) or not self._models.known.all():
            return False
        if found is None:
            return True
        improvement = self._improvement(self._models.known).log_value(found[None])[0]
        models = self._models.objectives
        if self.settings.weights is not None:
            spreads = [
                sum(w * m.spread for w, m in zip(self.settings.weights, models, strict=True))
            ]
        else:
            spreads = [model.spread for model in models]
        return bool(improvement < sum(math.log(_HOPELESS * (s or 1.0)) for s in spreads))

    def _pays(self, x: Array, used: Taken) -> bool:
        """Return whether measuring at x ``(d,)`` may say anything that is not known."""
        known = self.dataset.inputs[self.dataset.complete & self.dataset.valid]
        if len(known) == 0:
            return True
        distances = np.abs(known - x).max(axis=1)
        nearest = int(distances.argmin())
        again = bool(used.contains(x[None])[0])
        if not again and distances[nearest] > _NEAR:
            return True
        if again and not self._models.is_noisy(self.dataset):
            return False
        return self._models.expects_news(x, known[nearest])

    def _explored(self, rng: np.random.Generator) -> Array:
        """Return a point far from all evaluations that may be feasible and valid, shape ``(d,)``."""
        factors = self._factors(informed=True)
        weight = reduce(mul, factors).log_value if factors else None
        return explore(self.dataset.inputs, taken(self.dataset), rng, weight)

    def _acquisition_function(
        self, nearest: bool = False, tails: bool = True
    ) -> AcquisitionFunction | None:
        """Return the acquisition function over all that was told, times its factors.

        None where the readings say nothing of where it is large: all objectives read alike, or a
        constraint that was never met did.

        Args:
            nearest: Whether to improve on the evaluation that comes nearest to the reference point.
            tails: Whether improvements that underflow are needed.
        """
        known = self._models.known
        limits = self._models.constraints
        factors = self._factors()
        # Without a feasible point there is no front to improve: feasibility comes first.
        if limits and not (known.any() and self._believed().feasible.any()):
            return reduce(mul, factors) if all(map(_is_informed, limits)) else None
        if all(m.is_constant for m in self._models.objectives if m.n):
            return None
        if not self.problem.has_references:  # some objective was never measured
            return None
        return reduce(mul, [self._improvement(known, nearest, tails), *factors])

    def _factors(self, informed: bool = False) -> list[AcquisitionFunction]:
        """Return what the improvement is multiplied by.

        Args:
            informed: Whether to leave out constraints whose readings do not say where they are met.
        """
        factors: list[AcquisitionFunction] = [
            ProbabilityOfFeasibility(*limit)
            for limit in self._models.constraints
            if not informed or _is_informed(limit)
        ]
        if self.dataset.failed.any():
            factors.append(ValidityWeight(self._models.validity))
        precision = self.settings.proximal_precision(self.problem)
        if precision is not None:
            factors.append(ProximalBiasing(self.dataset.inputs[-1], precision))
        return factors

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
        settings, belief = self.settings, self._believed()
        chosen = ACQUISITION_FUNCTIONS.find(settings.acquisition)
        models = tuple(m for m, k in zip(self._models.objectives, known, strict=True) if k)
        values = belief.objectives[belief.feasible][:, known]
        reference = self.problem.reference_point[known]
        if nearest:
            reference = np.maximum(reference, values[nearest_to_reference(values, reference)])
        lower = self.problem.truncation_lower[known]
        beta = settings.beta
        if isinstance(beta, str):
            beta = beta_schedule(len(self.dataset), len(self.problem.variables))
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

        def front() -> BoxDecomposition:
            boxes = self._front()
            if nearest or not known.all():
                return BoxDecomposition(reference, values)
            return boxes if self._is_certain else self._believed_front()

        return chosen.of(Knowledge(models, values, reference, beta, front, truncation, tails))

    def _front(self) -> BoxDecomposition:
        """Return the boxes of the readings, built again when the models were trained.

        In between they grow, which is slower to sum over but spares the time. What they are depends
        on the data and the last training only, so that a restored optimiser has the same.
        """
        trained = self._models.trained_rows
        if self._packed == trained or (trained > _OFTEN_PACKED and trained < 1.2 * self._packed):
            return self._boxes
        if trained > _OFTEN_PACKED and self.settings.suggestion_seconds is not None:
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


def _no_boxes(problem: Problem) -> BoxDecomposition:
    """Return the boxes of an empty front, of no use before there is a reference point."""
    reference = problem.reference_point
    return BoxDecomposition(np.where(np.isfinite(reference), reference, 0.0))


def _is_informed(limit: tuple[GaussianProcess, float, float]) -> bool:
    """Return whether the readings of a constraint say anything of where it is met.

    They do not where none met it and all are alike, compared with what they lack, but for noise.
    """
    model, lower, upper = limit
    least, most = model.range
    lack = max(lower - most, least - upper)
    if lack <= 0.0 or most - least > _ALIKE * lack:
        return True
    return not model.is_constant and model.skill > _SKILL
