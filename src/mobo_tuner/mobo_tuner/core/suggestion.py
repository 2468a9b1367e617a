"""Suggestions: the next set-point by what is known, and what its evaluation is worth."""

from __future__ import annotations

import math
from typing import Literal, NamedTuple

import numpy as np

from mobo_tuner.core.archive import Archive
from mobo_tuner.core.candidate_search import CandidateSearch
from mobo_tuner.core.fidelity_choice import choose_fidelity, needs_design
from mobo_tuner.core.linear_algebra import single_blas_thread
from mobo_tuner.core.merit import Merit
from mobo_tuner.core.problem import Array
from mobo_tuner.core.safety import SafeSearch, is_guarded, was_safe
from mobo_tuner.core.settings import OptimizerSettings

Source = Literal["initial", "model"]


class Suggestion(NamedTuple):
    """A set-point in physical units, and whether the initial design or the models say so."""

    setpoint: dict[str, float]
    source: Source


class Suggester:
    """Suggests what to evaluate next, by what an archive knows or expects.

    Args:
        settings: Settings of the method.
        seed: Seed of every random choice.
    """

    def __init__(self, settings: OptimizerSettings, seed: int) -> None:
        self._settings = settings
        self._seed = seed

    def next(self, archive: Archive) -> Suggestion:
        """Return the next set-point; the archive's models are updated."""
        index = len(archive.dataset)
        source: Source = "initial" if index < archive.initial_evaluations else "model"
        problem, search = archive.problem, CandidateSearch(archive, self._settings, self._seed)
        with single_blas_thread():
            if is_guarded(problem, self._settings):
                x = SafeSearch(archive, self._settings, self._seed).candidate()
            elif source == "initial":
                x = search.initial_point(index)
            elif problem.fidelity and needs_design(archive, problem.fidelity):
                x = search.initial_point(int(archive.dataset.highest.sum()))
                return Suggestion(problem.denormalize(x), source)
            else:
                x = search.candidate()
            setpoint = problem.denormalize(x)
            if problem.fidelity:
                setpoint |= choose_fidelity(archive, problem.fidelity, x, self._seed)
            return Suggestion(setpoint, source)

    def expected_gain(self, archive: Archive, x: Array) -> float:
        """Return the share by which an evaluation at x ``(d,)`` is expected to raise the hypervolume.

        NaN if there are no models or no hypervolume yet.
        """
        if len(archive.dataset) < archive.initial_evaluations:
            return math.nan
        with single_blas_thread():
            return self._merit(archive).expected_gain(x)

    def log_acquisition(self, archive: Archive, x: Array) -> Array:
        """Return the logarithm of the acquisition function at x ``(m, d)``, by the models of the last update.

        NaN if there are no models yet, or nothing shows where it is large.
        """
        if len(archive.dataset) >= archive.initial_evaluations and archive.models.ready:
            with single_blas_thread():
                function = self._merit(archive).acquisition_function()
                if function is not None:
                    return function.log_value(x)
        return np.full(len(x), math.nan)

    def needs_start(self, archive: Archive) -> bool:
        """Return whether suggestions must be near and safe, and nothing is from which they could begin."""
        return is_guarded(archive.problem, self._settings) and not was_safe(archive.dataset).any()

    def catch_up(self, archive: Archive) -> None:
        """Update the models as `next` would, without the search."""
        guarded = is_guarded(archive.problem, self._settings)
        if guarded or len(archive.dataset) >= archive.initial_evaluations:
            archive.update()
            if archive.models.ready:
                self._merit(archive).acquisition_function()

    def _merit(self, archive: Archive) -> Merit:
        return Merit(archive, self._settings, self._seed)
