"""The model of one output of a run: a Gaussian process, and the evaluations that it learns from."""

from __future__ import annotations

from collections.abc import Collection
from copy import copy

import numpy as np
from numpy.typing import NDArray

from mobo_tuner.core.dataset import Dataset
from mobo_tuner.core.gaussian_process import GaussianProcess
from mobo_tuner.core.problem import Array
from mobo_tuner.core.selection import Selection
from mobo_tuner.core.suspects import find_suspects, is_doubtful, is_surprising

_MOST_TRAINED = 250  # evaluations for the hyperparameters, where there are more than rows
_CLEARLY_BETTER = 3.0  # in the log density of the highest fidelity's readings, at most 1 for each
_LEAST_HIGHEST = 4  # evaluations that say whether lower fidelities are of any use


class OutputModel:
    """Model of an objective, as it is minimised, or of a constrained diagnostic.

    It learns from the evaluations in which the output was measured, except for suspected readings and,
    where they say nothing of the highest fidelity, those of the lower ones. The inputs of evaluations are
    ``(n, d)``, with contexts and time.

    Args:
        name: Name of the output.
        sign: -1 where it is maximised, else 1.
        process: Gaussian process without observations.
        selection: Choice of the evaluations, where there are too many.

    Attributes:
        name: Name of the output.
        sign: -1 where it is maximised, else 1.
        process: Gaussian process.
        suspects: Evaluations whose reading is suspected, in their order.
        is_apart: Whether nothing is learned from lower fidelities.
    """

    def __init__(
        self, name: str, sign: float, process: GaussianProcess, selection: Selection
    ) -> None:
        self.name = name
        self.sign = sign
        self.process = process
        self.suspects: NDArray[np.intp] = np.empty(0, dtype=np.intp)
        self.is_apart = False
        self._selection = selection

    def copy(self) -> OutputModel:
        """Return a model of the same observations; what it learns later is its own."""
        other = copy(self)
        other.process = self.process.copy()
        return other

    # ------------------------------------------------------------------ evaluations

    def observations(self, data: Dataset) -> tuple[Array, Array]:
        """Return what is modelled and its standard deviations ``(n,)`` each; NaN for what does not count."""
        y, stddev = self._readings(data)
        y[self.suspects] = np.nan
        if self.is_apart:
            y[~data.highest] = np.nan
        return y, stddev

    def counted(self, data: Dataset) -> NDArray[np.intp]:
        """Return the evaluations with a reading that counts, in their order."""
        return np.flatnonzero(np.isfinite(self.observations(data)[0]))

    def selected(self, data: Dataset, inputs: Array) -> NDArray[np.intp]:
        """Return the evaluations that a training takes, in their order."""
        return self._selection.of_outputs(data, inputs, self.counted(data))

    def held(self, data: Dataset, inputs: Array, count: int, trained: int) -> NDArray[np.intp]:
        """Return the evaluations that the process holds, in their order.

        Args:
            data: Evaluations.
            inputs: Inputs of the evaluations.
            count: Number of evaluations that were learned.
            trained: Number of these at the last training.
        """
        rows = self.counted(data)
        rows = rows[rows < count]
        former = self._selection.of_outputs(data, inputs, rows[rows < trained])
        return np.concatenate([former, rows[rows >= trained]])

    def _readings(self, data: Dataset) -> tuple[Array, Array]:
        """Return all readings, as they are modelled, and their standard deviations ``(n,)`` each."""
        return data.column(self.name) * self.sign, data.stddev_column(self.name)

    # ------------------------------------------------------------------ learning

    def train(
        self,
        data: Dataset,
        inputs: Array,
        rows: NDArray[np.intp],
        *,
        seed: list[int],
        restarts: int | None,
        seconds: float,
        noisy: bool,
    ) -> None:
        """Train the process, from its last hyperparameters on.

        Args:
            data: Evaluations.
            inputs: Inputs of the evaluations.
            rows: Evaluations that it takes, with a reading that counts.
            seed: Seed of the random starts.
            restarts: Number of random starts in place of the settings'.
            seconds: Time budget [s].
            noisy: Whether the machine is known to be noisy.
        """
        y, stddev = self.observations(data)
        self.process.fit(
            inputs[rows],
            y[rows],
            stddev[rows],
            rng=np.random.default_rng(seed),
            restarts=restarts,
            most_trained=_MOST_TRAINED if len(rows) < len(self.counted(data)) else None,
            seconds=seconds,
            noisy=noisy,
            decisive=data.highest[rows],
        )

    def add(self, data: Dataset, inputs: Array, rows: NDArray[np.intp], at_once: bool) -> None:
        """Learn new evaluations without training.

        Args:
            data: Evaluations.
            inputs: Inputs of the evaluations.
            rows: Those that are new, with a reading that counts.
            at_once: Whether all are learned at once and not one after the other.
        """
        y, stddev = self.observations(data)
        for part in [rows] if at_once and len(rows) else rows[:, None]:
            self.process.add_all(inputs[part], y[part], stddev[part])

    def learn_again(self, data: Dataset, inputs: Array, rows: NDArray[np.intp]) -> None:
        """Learn the given evaluations in place of all former ones, without training where it was trained."""
        if len(rows) == 0:
            self.process = self.process.untrained()
            return
        y, stddev = self.observations(data)
        learn = self.process.condition if self.process.n else self.process.fit
        learn(inputs[rows], y[rows], stddev[rows])

    def judge_fidelities(self, data: Dataset, inputs: Array, noisy: bool, seed: list[int]) -> None:
        """Find out whether lower fidelities say anything of the output at the highest one.

        If a model without them predicts left-out evaluations at the highest fidelity better, it is taken.

        Args:
            data: Evaluations.
            inputs: Inputs of the evaluations.
            noisy: Whether the machine is known to be noisy.
            seed: Seed of the trainings.
        """
        self.is_apart = False
        y, stddev = self.observations(data)
        known, densities = np.isfinite(y), []
        if np.count_nonzero(known & data.highest) < _LEAST_HIGHEST or data.highest[known].all():
            return
        for usable in (known, known & data.highest):
            rows = self._selection.of_outputs(data, inputs, np.flatnonzero(usable))
            process = self.process.untrained().fit(
                inputs[rows],
                y[rows],
                stddev[rows],
                rng=np.random.default_rng(seed),
                most_trained=_MOST_TRAINED,
                noisy=noisy,
                decisive=data.highest[rows],
            )
            density = np.full(len(data), np.nan)
            density[rows] = process.leave_one_out().log_density
            densities.append(density)
        # Of readings that are nearly all alike, a few would outweigh all others.
        gains = np.clip(densities[1] - densities[0], -1.0, 1.0)
        self.is_apart = bool(np.nansum(gains) > _CLEARLY_BETTER)

    # ------------------------------------------------------------------ suspects

    def suspect(self, data: Dataset, inputs: Array, noisy: bool, seed: list[int]) -> None:
        """Look for suspected readings after a training, and train without them.

        Args:
            data: Evaluations.
            inputs: Inputs of the evaluations.
            noisy: Whether the machine is known to be noisy.
            seed: Seed of the trainings.
        """
        y, stddev = self._readings(data)
        former = self.suspects[np.isfinite(y[self.suspects])]
        every = np.union1d(self.selected(data, inputs), former)
        found = find_suspects(
            self.process.plain(),
            inputs[every],
            y[every],
            stddev[every],
            np.searchsorted(every, former),
            np.random.default_rng(seed),
        )
        if not np.array_equal(every[found], former):
            self.suspects = every[found]
            self._train_from_nothing(data, inputs, np.delete(every, found), noisy, seed)

    def suspect_doubtful(
        self, data: Dataset, inputs: Array, doubted: Collection[int], noisy: bool, seed: list[int]
    ) -> None:
        """Suspect readings that are doubtful where another output is suspected, and train without them.

        Args:
            data: Evaluations.
            inputs: Inputs of the evaluations.
            doubted: Evaluations of which an output is suspected.
            noisy: Whether the machine is known to be noisy.
            seed: Seed of the training.
        """
        rows = self.selected(data, inputs)
        if len(rows) != self.process.n:
            return
        found = [i for i, row in enumerate(rows) if row in doubted and is_doubtful(self.process, i)]
        if found:
            self.suspects = np.union1d(self.suspects, rows[found])
            self._train_from_nothing(data, inputs, np.delete(rows, found), noisy, seed)

    def is_surprised(self, data: Dataset, inputs: Array, first: int) -> bool:
        """Return whether a reading from the first new one on is ruled out by the process."""
        y, stddev = self.observations(data)
        return any(
            np.isfinite(y[row]) and is_surprising(self.process, inputs[row], y[row], stddev[row])
            for row in range(first, len(data))
        )

    def _train_from_nothing(
        self, data: Dataset, inputs: Array, rows: NDArray[np.intp], noisy: bool, seed: list[int]
    ) -> None:
        y, stddev = self._readings(data)
        self.process = self.process.untrained().fit(
            inputs[rows],
            y[rows],
            stddev[rows],
            rng=np.random.default_rng(seed),
            noisy=noisy,
            decisive=data.highest[rows],
        )
