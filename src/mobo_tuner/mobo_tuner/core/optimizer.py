"""Ask and tell: where to measure next, and what was measured.

.. [Roussel2021] R. Roussel, A. Hanuka, A. Edelen, "Multiobjective Bayesian optimization for online
   accelerator tuning", Phys. Rev. Accel. Beams 24, 062801 (2021).
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from difflib import get_close_matches
from pathlib import Path
from typing import Any, overload

import numpy as np

from mobo_tuner.core.archive import Archive
from mobo_tuner.core.batch import Pending
from mobo_tuner.core.dataset import Dataset, Evaluation, Measured
from mobo_tuner.core.focus import around, choose_on_front
from mobo_tuner.core.hints import doubtful_references, doubts, hints, sudden_change
from mobo_tuner.core.models import Models
from mobo_tuner.core.optimizer_state import (
    STATE_VERSION,
    evaluations_state,
    read_state,
    reading_state,
    told_evaluations,
    write_state,
)
from mobo_tuner.core.predicted_front import predict_front
from mobo_tuner.core.prior_mean import Prior
from mobo_tuner.core.problem import Array, Problem, ProblemError
from mobo_tuner.core.settings import make_settings
from mobo_tuner.core.suggestion import Source, Suggester
from mobo_tuner.core.values import as_integer

LARGEST_BATCH = 10_000
"""Largest number of set-points that are asked for at once."""
JUDGE_PERIOD = 10
"""Number of evaluations between two judgements of the models."""


class Optimizer:
    """Multi-objective Bayesian optimisation, one set-point at a time ([Roussel2021]_ algo:BO).

    The first `initial_evaluations` set-points are a space-filling design. Each later one maximises the
    acquisition function, over Gaussian processes of all that was told. What `ask` returns depends on
    the problem, the settings, the seed and what was told and asked before; asking twice gives the same
    answer.

    Args:
        problem: Problem to tune.
        preset: "default", or "paper" for exactly the paper's method.
        seed: Seed of every random choice, at least 0.
        prior_means: Model that predicts the machine (`prior_mean.PriorModel`), or a function for each of
            some objectives and constrained diagnostics, from one array per variable. The Gaussian
            process of each then learns the difference, if that predicts better.
        overrides: Single choices in place of the preset's, see `settings.OptimizerSettings`.

    Raises:
        ProblemError: If a choice is unknown, not allowed or does not suit the problem.

    Attributes:
        settings: Settings of the method.
        seed: Seed of every random choice.
        archive: Evaluations, the models that learned from them, and the front.
    """

    def __init__(
        self,
        problem: Problem,
        preset: str = "default",
        seed: int = 0,
        prior_means: Prior | None = None,
        **overrides: Any,
    ) -> None:
        if not isinstance(problem, Problem):
            raise ProblemError(f"problem must be a Problem, not {problem!r:.60}")
        seed = as_integer("seed", seed, 0)
        if problem.open_variables:
            raise ProblemError(
                f"the bounds of {', '.join(problem.open_variables)} depend on where the machine is; "
                "Problem.resolved gives them, and the action 'tune' asks the machine"
            )
        self._given = problem
        self.seed = seed
        self.settings = make_settings(preset, overrides)
        self.settings.check_problem(problem)
        self.archive = Archive(problem, self.settings, seed, prior_means)
        self._doubts: list[str] = []  # of the models
        self._judged_at = -JUDGE_PERIOD  # number of evaluations
        self._prior_means = prior_means
        self._last_sources: list[Source] = ["initial"]
        self._told: set[str] = set()  # outputs that were told, or are known to be misspelt
        self._suggester = Suggester(self.settings, seed)
        self._pending = Pending()

    @property
    def problem(self) -> Problem:
        """Problem that is tuned, with the reference point that was inferred, if any."""
        return self.archive.problem

    @property
    def dataset(self) -> Dataset:
        """Evaluations so far."""
        return self.archive.dataset

    @property
    def given_problem(self) -> Problem:
        """Problem as it was given; `problem` also has the parts of the reference point that it left out."""
        return self._given

    @property
    def initial_evaluations(self) -> int:
        """Number of points of the initial design."""
        return self.archive.initial_evaluations

    @property
    def last_source(self) -> Source:
        """Source of the last suggestion."""
        return self._last_sources[-1]

    @property
    def last_sources(self) -> list[Source]:
        """Source of each set-point that `ask` returned last."""
        return list(self._last_sources)

    @property
    def hypervolume(self) -> float:
        """Hypervolume of the front against the reference point, in the product of the objectives' units.

        It is that of what is believed: readings where they can be trusted, else the models' means.
        """
        return self.archive.hypervolume

    @property
    def suspected(self) -> list[tuple[int, str]]:
        """Readings that are nothing like the rest, by index and diagnostic.

        They count as not measured until later readings confirm them.
        """
        return self.archive.suspected

    @property
    def hypervolume_measured(self) -> float:
        """Hypervolume of the complete readings as they are, as for `hypervolume`."""
        return self.archive.hypervolume_measured

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
        return self.archive.pareto_front(measured, probability)

    def tell(
        self,
        setpoint: Mapping[str, float],
        outputs: Mapping[str, Measured | None],
        readbacks: Mapping[str, float] = {},
        failed: bool | None = None,
        time: float | None = None,
    ) -> Evaluation:
        """Learn what was measured at a set-point, whether it was suggested or not.

        Args:
            setpoint: Every variable, in physical units.
            outputs: Diagnostics by name; a pair is (mean, standard deviation); NaN, None or missing
                means not measured: what was measured is learned all the same.
            readbacks: Readbacks of some or all variables during the measurement, in physical units.
                The models learn from them in place of the set-point's values.
            failed: Whether the machine reported a failure; None lets the outputs decide: the
                evaluation failed if no objective and no constrained diagnostic was measured.
            time: When it was measured, from any fixed moment on [s], for a machine that drifts; None
                counts one second for each evaluation.

        Raises:
            ProblemError: If the set-point or a readback does not fit the problem, or an output is not
                a number; nothing is learned.
        """
        evaluation = self.archive.tell(setpoint, outputs, readbacks, failed, time)
        self._pending.remove(setpoint, self.problem)
        self._warn_of_misspelt(outputs)
        return evaluation

    def forget(self, index: int, name: str | None = None) -> None:
        """Withdraw an evaluation, or one diagnostic of it, as if it had never been measured.

        Args:
            index: Index of the evaluation.
            name: Diagnostic to withdraw; the whole evaluation without it.

        Raises:
            ProblemError: If there is no such evaluation or it has no such diagnostic.
        """
        self.archive.forget(index, name)

    def unforget(self, index: int, name: str | None = None) -> None:
        """Take back what `forget` withdrew: one diagnostic, or all of an evaluation.

        Arguments and errors are those of `forget`.
        """
        self.archive.unforget(index, name)

    def _warn_of_misspelt(self, outputs: Mapping[str, Any]) -> None:
        """Warn, once for each, of an unknown output that looks like one that was never told."""
        problem = self.problem
        derived = {d.name for d in problem.derived}
        known = {*problem.measured_diagnostics, *(o.name for o in problem.observables)} - derived
        unknown = outputs.keys() - known
        if not unknown:
            return
        folded = {name.casefold(): name for name in unknown}
        for name in known - self._told - outputs.keys():
            for match in get_close_matches(name.casefold(), folded, n=1, cutoff=0.75):
                self._told.add(name)
                warnings.warn(
                    f"the output '{folded[match]}' is unknown to the problem, and '{name}' is missing",
                    stacklevel=3,
                )
        self._told |= known & outputs.keys()

    @property
    def models(self) -> Models:
        """Models that know all that was told, with the hyperparameters of the last training.

        They are trained here if they were not yet; later suggestions do not depend on it.
        """
        return self.archive.extended_models

    def hints(self) -> list[str]:
        """Return what keeps the front empty, and what the models cannot explain, one sentence each.

        For example that no point is better than the reference in one objective, and by how much, that
        a constraint was never met, that all readings of a diagnostic are alike, that a reference was
        inferred from a suspected reading, that the machine changed at once, or that a model predicts
        badly. The models are judged after
        every `JUDGE_PERIOD` evaluations.
        """
        archive = self.archive
        if archive.models.ready and len(archive.dataset) >= self._judged_at + JUDGE_PERIOD:
            self._judged_at = len(archive.dataset)
            noisy = not archive.models.trusts_readings(archive.dataset)
            self._doubts = doubts(archive.models.by_output, archive.belief, noisy=noisy)
        found = hints(archive.dataset, archive.belief)
        if not self._given.has_references:
            found += doubtful_references(self._given, archive.dataset, self.suspected)
        found += sudden_change(archive.dataset, archive.models.jumps)
        return found + self._doubts

    @overload
    def ask(self) -> dict[str, float]: ...

    @overload
    def ask(self, count: int) -> list[dict[str, float]]: ...

    def ask(self, count: int | None = None) -> dict[str, float] | list[dict[str, float]]:
        """Return the set-point to evaluate next, or several that are worth measuring together.

        The set-points of a batch are pending until they are told or cancelled, and others are chosen
        with regard to them.

        Args:
            count: Number of set-points of a batch; None for a single one, which does not become
                pending.

        Returns:
            Every variable in physical units and inside the bounds: one mapping, or a list of `count`.

        Raises:
            ProblemError: If the count is not an integer from 1 to `LARGEST_BATCH`.
        """
        if count is None:
            suggestion = self._pending.next(self.archive, self._suggester)
            self._last_sources = [suggestion.source]
            return suggestion.setpoint
        count = as_integer("count", count, 1, LARGEST_BATCH)
        batch = self._pending.extend(self.archive, self._suggester, count)
        self._last_sources = [suggestion.source for suggestion in batch]
        return [suggestion.setpoint for suggestion in batch]

    @property
    def pending(self) -> list[dict[str, float]]:
        """Set-points of batches that were neither told nor cancelled yet, in the order of asking."""
        return self._pending.setpoints

    def cancel(self, setpoint: Mapping[str, float]) -> None:
        """Take back a pending set-point that will not be evaluated.

        Args:
            setpoint: Every variable, in physical units.

        Raises:
            ProblemError: If it does not fit the problem or is not pending.
        """
        self.problem.normalize(setpoint)
        if not self._pending.remove(setpoint, self.problem):
            raise ProblemError(f"the set-point {dict(setpoint)} is not pending")

    def expected_gain(self, setpoint: Mapping[str, float]) -> float:
        """Return the gain of hypervolume that the models expect of an evaluation, as a share of it.

        It is the expected hypervolume improvement times the probability of feasibility, by the models
        with which `ask` made its last suggestion. Later suggestions are unaffected.

        Args:
            setpoint: Every variable, in physical units.

        Returns:
            The share; NaN if there are no models or no hypervolume yet.

        Raises:
            ProblemError: If the set-point does not fit the problem.
        """
        return self._suggester.expected_gain(self.archive, self.problem.normalize(setpoint))

    def log_acquisition(self, x: Array) -> Array:
        """Return the logarithm of the acquisition function, by the models of the last suggestion.

        Later suggestions are unaffected.

        Args:
            x: Points ``(m, d)``, normalised to [-1, 1].

        Returns:
            Values ``(m,)``; NaN if there are no models yet, or nothing shows where it is large.

        Raises:
            ProblemError: If x does not have this shape, or not only finite numbers.
        """
        d = len(self.problem.variables)
        try:
            points = np.asarray(x)
        except ValueError:  # rows of different lengths
            points = np.empty(0, dtype=object)
        is_finite = points.dtype.kind in "fiu" and bool(np.isfinite(points).all())
        if not is_finite or points.shape[1:] != (d,):
            raise ProblemError(f"x is {x!r:.60}; rows of {d} finite numbers are allowed")
        return self._suggester.log_acquisition(self.archive, points.astype(float))

    @property
    def needs_start(self) -> bool:
        """Whether suggestions must be near and safe, and no evaluation is, from which they could begin."""
        return self._suggester.needs_start(self.archive)

    def catch_up(self) -> None:
        """Update the models as `ask` would, without the search.

        A run is replayed quickly by it; later suggestions are unaffected.
        """
        self._suggester.catch_up(self.archive)

    def focus(
        self,
        index: int | None = None,
        weights: Mapping[str, float] | None = None,
        radius: float = 0.2,
        bounds: Problem | None = None,
    ) -> Optimizer:
        """Return an optimiser of one objective around a point of the front ([Roussel2021]_, sec:conclusion).

        It minimises the weighted sum of the minimised objectives by expected improvement, within
        `radius` of the point, and knows all that this one was told. All other choices are those of
        this one.

        Args:
            index: Index of the chosen point's evaluation; None for the front's best by `weights`.
            weights: Weight of each objective, in the inverse of its unit. If None, each is one over
                the point's distance from the reference point: then the sum falls where the volume
                between the two grows.
            radius: Distance of the new bounds from the point, as a share of each variable's range.
            bounds: Problem whose bounds must hold, too, if they were changed since.

        Raises:
            ProblemError: If the point is not on the front or outside the bounds, the weights do not
                fit, or neither is given.
        """
        chosen, sums = choose_on_front(
            self.problem, self.pareto_front(probability=False), index, weights
        )
        changes = {"acquisition": "ei", "weights": sums, "initial_evaluations": 1}
        focused = self._like_this(around(self.problem, chosen, radius, bounds), changes)
        self._tell_all_to(focused)
        return focused

    def with_problem(self, problem: Problem) -> Optimizer:
        """Return an optimiser of another problem of the same variables that knows all that was told.

        Bounds, objectives, constraints, costs and the truncation box may differ; evaluations outside
        new bounds stay. The new optimiser's models are trained again, so that its suggestions depend on
        the problem and what was told, and not on when the problem was changed.

        Args:
            problem: New problem.

        Raises:
            ProblemError: If it has other variables, or the settings do not suit it.
        """
        if not isinstance(problem, Problem):
            raise ProblemError(f"problem must be a Problem, not {problem!r:.60}")
        if set(problem.setpoint_names) != set(self.problem.setpoint_names):
            raise ProblemError(
                f"the variables are {', '.join(problem.setpoint_names)}; with what was measured "
                f"only {', '.join(self.problem.setpoint_names)} are allowed"
            )
        changed = self._like_this(problem)
        self._tell_all_to(changed)
        return changed

    def predicted_front(self, size: int = 100) -> list[dict[str, Any]]:
        """Return the front as the models predict it where nothing was measured yet.

        New models are trained for it, so that later suggestions do not depend on it.

        Args:
            size: Highest number of points.

        Returns:
            Set-point, objectives and their standard deviations (`stddevs`) of each point, in their
            own units; empty if an objective was never measured or nothing good is predicted.

        Raises:
            ProblemError: If the size is not an integer of at least 1.
        """
        size = as_integer("size", size, 1)
        if not self.dataset.valid.any():
            return []
        models = Models(self.problem, self.settings, self.seed, self._prior_means)
        models.update(self.dataset)
        if not models.known.all():
            return []
        rng = np.random.default_rng([self.seed, 3, len(self.dataset)])
        known = self.dataset.inputs[self.archive.belief.front_rows()]
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
        """Return an optimiser of another problem without evaluations, with these choices but for some."""
        choices = self.settings.to_dict() | dict(changes)
        return Optimizer(problem, seed=self.seed, prior_means=self._prior_means, **choices)

    def _tell_all_to(self, other: Optimizer) -> None:
        withdrawn = self.dataset.withdrawn
        for e in self.dataset.evaluations:
            outputs = {n: (v, e.stddevs[n]) for n, v in e.values.items()}
            other.tell(e.setpoint, outputs, e.readbacks, e.reported_failed, e.time)
            # At once, so that no reference point is inferred from it.
            for name in [name for index, name in withdrawn if index == e.index]:
                other.forget(e.index, name)
        other._pending = Pending(self.pending)

    # ------------------------------------------------------------------ state

    def get_state(self, *, with_evaluations: bool = True) -> dict[str, Any]:
        """Return the state for `from_state`, which continues with the same suggestions, as data for JSON.

        Args:
            with_evaluations: Whether the evaluations are part of it. A caller that keeps them elsewhere
                adds them again as `evaluations`; the rest does not grow with their number.
        """
        state: dict[str, Any] = {
            "version": STATE_VERSION,
            "problem": self._given.to_dict(),
            "settings": self.settings.to_dict(),
            "seed": self.seed,
            "pending": self.pending,
            **self.archive.get_state(),
        }
        if with_evaluations:
            state["evaluations"] = evaluations_state(self.dataset)
        return state

    @classmethod
    def from_state(cls, state: Mapping[str, Any], prior_means: Prior | None = None) -> Optimizer:
        """Return the optimiser that `get_state` came from; its next suggestions are the same.

        Args:
            state: State from `get_state`, also after a conversion to JSON and back.
            prior_means: The same model or functions again, if there were any.

        Raises:
            ProblemError: If the state is of another version, incomplete or damaged.
        """
        with reading_state(state):
            restored = cls(
                Problem.from_dict(state["problem"]),
                seed=state["seed"],
                prior_means=prior_means,
                **state["settings"],
            )
            for evaluation in told_evaluations(state):
                restored.tell(*evaluation)
            restored.archive.set_state(state)
            pending = state["pending"]
            for setpoint in pending:
                restored.problem.normalize(setpoint)
            restored._pending = Pending(pending)
            return restored

    def save(self, path: str | Path) -> None:
        """Write the state to a JSON file, which replaces an older one only when it is complete."""
        write_state(path, self.get_state())

    @classmethod
    def load(cls, path: str | Path, prior_means: Prior | None = None) -> Optimizer:
        """Read what `save` wrote.

        Args:
            path: File.
            prior_means: The same model or functions again, if there were any.

        Raises:
            ProblemError: If the file cannot be read or does not contain a state.
        """
        return cls.from_state(read_state(path), prior_means)
