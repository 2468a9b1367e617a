"""What the models of a run say at its end: how well they predict, and which variable drives what."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from mobo_tuner.core.gaussian_process import GaussianProcess
from mobo_tuner.core.problem import Array
from mobo_tuner.core.sensitivity import first_order_indices
from mobo_tuner.runs.recorded_run import RecordedRun

_SAMPLES = 256
_FEWEST = 3  # readings of which something can be said


class ModelFacts(NamedTuple):
    """The model of one output, in the output's own unit and sense, over n readings.

    Attributes:
        name: Name of the output.
        unit: Its unit.
        measured: Readings ``(n,)``.
        predicted: Each predicted from all others ``(n,)``.
        stddevs: Standard deviations of the predictions, noise included ``(n,)``.
        noise: Known standard deviations of the readings ``(n,)``; 0 where unknown.
        indices: First-order Sobol index of each variable ``(d,)``.
        length_scales: Distance over which the output changes, in each variable's unit ``(d,)``.
    """

    name: str
    unit: str
    measured: Array
    predicted: Array
    stddevs: Array
    noise: Array
    indices: Array
    length_scales: Array

    @property
    def skill(self) -> float:
        """Share of the readings' variance that the predictions explain; at most 1."""
        residual = self.measured - self.predicted
        return 1.0 - float(np.mean(residual**2) / np.var(self.measured))

    @property
    def is_noise(self) -> bool:
        """Whether the readings differ by no more than their known noise, so that there is nothing to predict."""
        spread = np.median(np.abs(self.measured - np.median(self.measured)))
        return bool(spread <= np.median(self.noise))

    @property
    def error(self) -> float:
        """Root mean square of the differences between predictions and readings."""
        return float(np.sqrt(np.mean((self.measured - self.predicted) ** 2)))

    @property
    def coverage(self) -> float:
        """Share of the readings within two standard deviations; 0.95 if these are right."""
        return float(np.mean(np.abs(self.measured - self.predicted) <= 2.0 * self.stddevs))


def model_facts(run: RecordedRun) -> list[ModelFacts]:
    """Return what the models say; an output of which too little is known is left out."""
    if not run.valid.any():
        return []
    problem = run.problem
    half = np.array([0.5 * (v.maximum - v.minimum) for v in problem.variables])
    signs = {o.name: o.sign for o in problem.objectives}
    facts = []
    for name, model in run.optimizer.models.by_output.items():
        if model.n < _FEWEST or model.is_constant:
            continue
        left_out = model.leave_one_out()
        sign = signs.get(name, 1.0)
        facts.append(
            ModelFacts(
                name=name,
                unit=problem.units.get(name, ""),
                measured=sign * (left_out.mean + left_out.residual),
                predicted=sign * left_out.mean,
                stddevs=left_out.stddev,
                noise=model.known_noise,
                indices=_indices(model, len(half)),
                length_scales=half / np.sqrt(np.diagonal(model.precision)),
            )
        )
    return facts


def _indices(model: GaussianProcess, d: int) -> Array:
    return first_order_indices(lambda x: model.predict(x)[0], d, _SAMPLES)
