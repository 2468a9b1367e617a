"""The models of a run: a Gaussian process for each objective and each constrained diagnostic, and validity."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from mobo_tuner.core.dataset import Dataset
from mobo_tuner.core.gaussian_process import GaussianProcess
from mobo_tuner.core.gaussian_process_settings import GaussianProcessSettings, MeanFunction
from mobo_tuner.core.presets import OptimizerSettings
from mobo_tuner.core.problem import Array, Problem, ProblemError
from mobo_tuner.core.validity import ValidityModel

PriorMean = Callable[[Mapping[str, Array]], Array]
"""Predicts one quantity in its own unit, shape ``(n,)``, from one array ``(n,)`` per variable."""


class Models:
    """Independent Gaussian processes over the valid evaluations, [Roussel2021]_ section subsec:MOBO.

    Objectives are modelled as they are minimised. A constraint on an objective shares its model.

    Args:
        problem: whose quantities are modelled.
        settings: how.
        seed: of the random starts of training.
        prior_means: for some quantities a function that predicts them, see `PriorMean`.

    Raises:
        ProblemError: a prior mean is given for a quantity that is not modelled.
    """

    def __init__(
        self,
        problem: Problem,
        settings: OptimizerSettings,
        seed: int,
        prior_means: Mapping[str, PriorMean] | None = None,
    ) -> None:
        self._problem = problem
        self._refit_every = settings.refit_every
        self._seed = seed
        self._signs = {o.name: o.sign for o in problem.objectives}
        self._means = {n: self._mean_function(n, f) for n, f in (prior_means or {}).items()}
        process = settings.gaussian_process
        self._processes = {
            o.name: GaussianProcess(
                self._with_prior_mean(process, o.name), reference=o.sign * o.reference
            )
            for o in problem.objectives
        }
        # A constrained diagnostic has no reference point; its mean is that of the data.
        constrained = replace(process, mean="data") if process.mean == "reference" else process
        for name in problem.required_diagnostics:
            if name not in self._processes:
                self._processes[name] = GaussianProcess(self._with_prior_mean(constrained, name))
        for name in self._means:
            if name not in self._processes:
                raise ProblemError(
                    f"a prior mean is given for '{name}'; allowed are {', '.join(self._processes)}"
                )
        self.validity = ValidityModel()
        self._judged = 0  # number of evaluations that the model of validity holds
        self._trained = 0  # number of valid evaluations at the last training
        self._held = 0  # number of valid evaluations that the models hold

    def _mean_function(self, name: str, prior_mean: PriorMean) -> MeanFunction:
        """The prior mean of what is modelled, on normalised inputs."""
        sign = self._signs.get(name, 1.0)
        return lambda x: sign * np.asarray(prior_mean(self._problem.columns(x)), dtype=float)

    def _with_prior_mean(
        self, settings: GaussianProcessSettings, name: str
    ) -> GaussianProcessSettings:
        if name not in self._means:
            return settings
        return replace(settings, mean=self._means[name], transform="none")

    @property
    def ready(self) -> bool:
        """Whether there was any valid evaluation to learn from."""
        return self._held > 0

    @property
    def trained(self) -> int:
        """Number of valid evaluations at the last training."""
        return self._trained

    @property
    def objectives(self) -> list[GaussianProcess]:
        """Models of the minimised objectives, in the problem's order."""
        return [self._processes[name] for name in self._problem.objective_names]

    @property
    def constraints(self) -> list[tuple[GaussianProcess, float, float]]:
        """For each constraint its model, and the lower and upper limit of what it models."""
        limits = []
        for constraint in self._problem.constraints:
            ends = (constraint.minimum, constraint.maximum)
            if self._signs.get(constraint.name, 1.0) < 0.0:
                ends = (-ends[1], -ends[0])
            limits.append((self._processes[constraint.name], *ends))
        return limits

    def update(self, data: Dataset) -> None:
        """Learn the evaluations that are new, training when it is time to.

        What it does depends on `data` and on when it was called before, on nothing else.
        """
        if len(data) > self._judged:
            self.validity.fit(data.inputs, data.valid)
            self._judged = len(data)
        rows = np.flatnonzero(data.valid)
        count = len(rows)
        if count == self._held:
            return
        patience = self._refit_every or 1 + self._trained // 25
        train = self._trained == 0 or count - self._trained >= patience
        restarts = None if _is_time_to_restart(self._trained, count) else 0
        inputs = data.inputs
        for position, (name, process) in enumerate(self._processes.items()):
            y, stddev = self._observations(name, data)
            if train:
                rng = np.random.default_rng([self._seed, 1, count, position])
                process.fit(inputs[rows], y[rows], stddev[rows], rng=rng, restarts=restarts)
            else:
                for row in rows[self._held :]:
                    process.add(inputs[row], float(y[row]), float(stddev[row]))
        self._held = count
        if train:
            self._trained = count

    def _observations(self, name: str, data: Dataset) -> tuple[Array, Array]:
        """Values as they are modelled and their standard deviations, ``(n,)`` each."""
        return data.column(name) * self._signs.get(name, 1.0), data.stddev_column(name)

    def get_state(self) -> dict[str, Any]:
        """What `set_state` needs beside the data, as plain data."""
        return {
            "trained": self._trained,
            "held": self._held,
            "judged": self._judged,
            "validity": self.validity.get_state(),
            "processes": {name: p.get_state() for name, p in self._processes.items()},
        }

    def set_state(self, state: dict[str, Any], data: Dataset) -> None:
        """Be as the models that `get_state` came from, given the data that they had learned from."""
        self._trained, self._held = state["trained"], state["held"]
        self._judged = state["judged"]
        self.validity = ValidityModel.from_state(
            state["validity"], data.inputs[: self._judged], data.valid[: self._judged]
        )
        rows = np.flatnonzero(data.valid)[: self._held]
        for name in self._processes:
            y, stddev = self._observations(name, data)
            self._processes[name] = GaussianProcess.from_state(
                state["processes"][name],
                data.inputs[rows],
                y[rows],
                stddev[rows],
                mean=self._means.get(name),
            )


def _is_time_to_restart(trained: int, count: int) -> bool:
    """Whether a training of `count` evaluations, the last one of `trained`, tries random starts too.

    Where the last optimum is a poor one, a few more evaluations seldom show it, and a random start costs more than
    to go on from there: it is tried whenever there are a fifth more evaluations.
    """
    return trained == 0 or int(_log_in_fifths(count)) > int(_log_in_fifths(trained))


def _log_in_fifths(count: int) -> float:
    return math.log(count) / math.log(1.2)
