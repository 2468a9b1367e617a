"""Derived quantities predicted from the models of what is in their formulas."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from functools import reduce
from typing import Self

import numpy as np

from mobo_tuner.core.arrays import FloatArray
from mobo_tuner.core.dataset import Dataset
from mobo_tuner.core.derived import Derived
from mobo_tuner.core.gaussian_process import GaussianProcess, Prediction
from mobo_tuner.core.output_model import OutputModel
from mobo_tuner.core.prior_mean import PriorMeans
from mobo_tuner.core.problem import Array, Problem

_LEAST = 5  # evaluations that say whether a quantity is better predicted by its parts
_STEP = 1e-4  # of difference quotients: of a part's spread, and of a variable's half range


@dataclass(frozen=True)
class Composition:
    """The formula of a derived quantity, for normal distributions of what was measured.

    Mean and variance are those at 2 p + 1 points, the unscented transform of Julier and Uhlmann, Proc. IEEE 92 (2004)
    401: the mean of a formula of second order is exact, the variance that of a formula of first order.

    Args:
        derived: Derived quantity, whose formula has no choices.
        problem: Problem with d variables.
        sign: -1 where the quantity is maximised, else 1.

    Attributes:
        parts: Names of the p diagnostics in the formula.
    """

    derived: Derived
    problem: Problem
    sign: float

    @property
    def parts(self) -> tuple[str, ...]:
        """Names of the p diagnostics in the formula."""
        return tuple(n for n in self.derived.names if n not in self.problem.variable_names)

    def values(self, x: FloatArray, readings: FloatArray) -> FloatArray:
        """Return the quantity, as it is minimised, ``(...)``; NaN where it is undefined.

        Args:
            x: Normalised set-points, of which the first d columns count ``(m, d)``.
            readings: Readings of the parts ``(..., m, p)``.
        """
        known = self.problem.columns(x[:, : len(self.problem.variables)])
        shape = readings.shape[:-1]
        columns = {
            name: np.broadcast_to(known[name], shape)
            for name in self.derived.names
            if name in known
        }
        columns |= {name: readings[..., j] for j, name in enumerate(self.parts)}
        return self.sign * self.derived.over(columns)

    def moments(
        self, x: FloatArray, means: FloatArray, stddevs: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Return mean and standard deviation ``(m,)``; NaN where the formula is undefined nearby.

        Args:
            x: Normalised set-points ``(m, d)``.
            means: Means of the parts ``(m, p)``.
            stddevs: Standard deviations of the parts ``(m, p)``.
        """
        moves, weights = _sigma_points(len(self.parts))
        values = self.values(x, means + moves[:, None] * stddevs)
        mean = weights @ values
        return mean, np.sqrt(weights @ np.square(values - mean))

    def log_density(
        self, x: FloatArray, y: FloatArray, means: FloatArray, stddevs: FloatArray
    ) -> FloatArray:
        """Return the log density of observations y, as they are minimised, `moments` given ``(m,)``.

        It is -inf where the formula is undefined or leaves no doubt.
        """
        mean, stddev = self.moments(x, means, stddevs)
        with np.errstate(all="ignore"):
            density = -0.5 * (np.square((y - mean) / stddev) + np.log(2.0 * np.pi * stddev**2))
        return np.where(np.isfinite(density), density, -np.inf)

    def gradients(self, x: FloatArray, parts: list[Prediction], steps: FloatArray) -> Prediction:
        """Return `moments` and their gradients in x.

        Args:
            x: Normalised set-points ``(m, d)``.
            parts: Predictions of the parts there.
            steps: Steps of each part for difference quotients ``(p,)``.
        """
        moves, weights = _sigma_points(len(parts))
        means = np.column_stack([part.mean for part in parts])
        stddevs = np.column_stack([part.stddev for part in parts])
        readings = means + moves[:, None] * stddevs
        values = self.values(x, readings)
        slopes = np.zeros((*values.shape, x.shape[1]))  # of the value at each sigma point, in x
        for j, (part, step) in enumerate(zip(parts, steps, strict=True)):
            ahead, behind = readings.copy(), readings.copy()
            ahead[..., j] += step
            behind[..., j] -= step
            by_part = (self.values(x, ahead) - self.values(x, behind)) / (2.0 * step)
            moved = part.mean_gradient + moves[:, j, None, None] * part.stddev_gradient
            slopes += by_part[..., None] * moved
        for k, variable in enumerate(self.problem.variables):
            if variable.name in self.derived.names:
                ahead, behind = x.copy(), x.copy()
                ahead[:, k] = np.minimum(x[:, k] + _STEP, 1.0)
                behind[:, k] = np.maximum(x[:, k] - _STEP, -1.0)
                width = ahead[:, k] - behind[:, k]
                difference = self.values(ahead, readings) - self.values(behind, readings)
                slopes[..., k] += difference / width
        mean = weights @ values
        deviations = values - mean
        stddev = np.sqrt(weights @ np.square(deviations))
        mean_gradient = np.tensordot(weights, slopes, 1)
        covariances = np.einsum("k,km,kmd->md", weights, deviations, slopes - mean_gradient)
        by_stddev = covariances / np.where(stddev > 0.0, stddev, 1.0)[:, None]
        return Prediction(mean, stddev, mean_gradient, by_stddev)


class ComposedProcess(GaussianProcess):
    """The process of a derived quantity, whose predictions come from the processes of its parts.

    What was observed and learned of the quantity itself is that of its own process, which also predicts
    where the formula is undefined.
    """

    _composition: Composition
    _direct: GaussianProcess
    _parts: list[tuple[float, GaussianProcess]]

    @classmethod
    def of(
        cls,
        direct: GaussianProcess,
        composition: Composition,
        parts: Mapping[str, tuple[float, GaussianProcess]],
    ) -> Self:
        """Return the process of a quantity.

        Args:
            direct: Process of the quantity itself.
            composition: Its formula.
            parts: Sign and process of each of its parts, by name.
        """
        composed = cls.__new__(cls)
        vars(composed).update(vars(direct))
        composed._composition, composed._direct = composition, direct
        composed._parts = [parts[name] for name in composition.parts]
        return composed

    def predict(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:  # type: ignore[override]
        """Return what `GaussianProcess.predict` does."""
        x = np.asarray(x, dtype=float)
        predicted = [process.predict(x) for _, process in self._parts]
        means = np.column_stack(
            [sign * mean for (sign, _), (mean, _) in zip(self._parts, predicted, strict=True)]
        )
        stddevs = np.column_stack([stddev for _, stddev in predicted])
        mean, stddev = self._composition.moments(x, means, stddevs)
        undefined = ~(np.isfinite(mean) & np.isfinite(stddev))
        if undefined.any():
            mean[undefined], stddev[undefined] = self._direct.predict(x[undefined])
        return mean, stddev

    def predict_with_gradient(self, x: FloatArray) -> Prediction:  # type: ignore[override]
        """Return what `GaussianProcess.predict_with_gradient` does."""
        x = np.asarray(x, dtype=float)
        parts = []
        for sign, process in self._parts:
            mean, stddev, mean_gradient, stddev_gradient = process.predict_with_gradient(x)
            parts.append(Prediction(sign * mean, stddev, sign * mean_gradient, stddev_gradient))
        steps = np.array([_STEP * (process.spread or 1.0) for _, process in self._parts])
        composed = self._composition.gradients(x, parts, steps)
        undefined = ~np.all(
            [np.isfinite(a).reshape(len(x), -1).all(axis=1) for a in composed], axis=0
        )
        if undefined.any():
            for values, instead in zip(
                composed, self._direct.predict_with_gradient(x[undefined]), strict=True
            ):
                values[undefined] = instead
        return composed

    def sample(self, x: FloatArray, normals: FloatArray) -> FloatArray:  # type: ignore[override]
        """Return what `GaussianProcess.sample` does; the draws of the parts are independent."""
        x = np.asarray(x, dtype=float)
        draws = [
            sign * process.sample(x, np.roll(normals, j, axis=0))
            for j, (sign, process) in enumerate(self._parts)
        ]
        values = self._composition.values(x, np.stack(draws, axis=-1))
        return np.where(np.isfinite(values), values, self._direct.sample(x, normals))


def compositions(problem: Problem, means: PriorMeans) -> dict[str, Composition]:
    """Return the formulas by which quantities of a problem may be predicted from their parts, by name.

    A formula with choices may jump, so that no two moments describe it; what has a prior mean keeps it.
    """
    signs = {o.name: o.sign for o in problem.objectives}
    contexts = {context.name for context in problem.context}
    found = {}
    for derived in problem.derived:
        composition = Composition(derived, problem, signs.get(derived.name, 1.0))
        is_modelled = derived.name in problem.required_diagnostics and not means.mean(derived.name)
        is_measured = composition.parts and contexts.isdisjoint(composition.parts)
        if is_modelled and is_measured and not derived.has_choices and problem.fidelity is None:
            found[derived.name] = composition
    return found


def better_by_parts(
    compositions: Mapping[str, Composition],
    outputs: Mapping[str, OutputModel],
    data: Dataset,
    inputs: Array,
) -> frozenset[str]:
    """Return the derived quantities of which left-out evaluations are more likely by their parts.

    Args:
        compositions: Formula of each quantity.
        outputs: Models of the quantities and of their parts, just trained.
        data: Evaluations.
        inputs: Inputs of the evaluations.
    """
    better = []
    for name, composition in compositions.items():
        models = [outputs[n] for n in (name, *composition.parts)]
        rows = [model.selected(data, inputs) for model in models]
        if any(len(r) != model.process.n for r, model in zip(rows, models, strict=True)):
            continue
        common = reduce(np.intersect1d, rows)
        if len(common) < _LEAST:
            continue
        direct, *parts = (
            (model, left, np.searchsorted(r, common))
            for model, r in zip(models, rows, strict=True)
            for left in [model.process.leave_one_out()]
        )
        density = composition.log_density(
            inputs[common],
            direct[0].observations(data)[0][common],
            np.column_stack([model.sign * left.mean[at] for model, left, at in parts]),
            np.column_stack([left.stddev[at] for _, left, at in parts]),
        )
        if density.sum() > direct[1].log_density[direct[2]].sum():
            better.append(name)
    return frozenset(better)


def composed_processes(
    compositions: Mapping[str, Composition],
    names: Collection[str],
    outputs: Mapping[str, OutputModel],
) -> dict[str, ComposedProcess]:
    """Return the processes of the named quantities, predicted by their parts."""
    parts = {name: (output.sign, output.process) for name, output in outputs.items()}
    return {
        name: ComposedProcess.of(parts[name][1], compositions[name], parts)
        for name in sorted(names)
    }


def _sigma_points(p: int) -> tuple[FloatArray, FloatArray]:
    """Return points ``(2 p + 1, p)``, in standard deviations, and weights ``(2 p + 1,)`` for p independent parts."""
    scale = float(max(3, p + 1))
    moves = np.sqrt(scale) * np.vstack([np.zeros((1, p)), np.eye(p), -np.eye(p)])
    weights = np.full(2 * p + 1, 0.5 / scale)
    weights[0] = 1.0 - p / scale
    return moves, weights
