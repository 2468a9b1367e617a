"""What keeps a run from progress, in sentences for the operator, each with what to do."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from mobo_tuner.core.belief import Belief
from mobo_tuner.core.dataset import Dataset
from mobo_tuner.core.gaussian_process import GaussianProcess
from mobo_tuner.core.problem import Array, Problem

FEWEST = 20
"""Least number of readings by which a model is judged."""
FEWEST_PER_VARIABLE = 10
"""The same for each variable."""
FEWEST_ON_FRONT = 3
"""Least number of points by which the range of the front is judged."""
RECENT = 50
"""Number of evaluations for which a change is told."""
UNEXPLAINED = 0.9
"""Share of the readings' spread by which predictions are off where the model predicts badly.

Standard deviations do not show it: a trained model of what it cannot explain has wide ones.
"""


def hints(data: Dataset, belief: Belief) -> list[str]:
    """Return one sentence for each thing that is wrong; none while points are on the front."""
    problem = data.problem
    if not data.highest.any() or len(belief.front_rows()):
        return []
    failed, withdrawn = data.failed[data.highest], data.forgotten[data.highest]
    if (failed | withdrawn).all():
        which = "" if data.highest.all() else " of the highest fidelity"
        if not failed.any():
            return [f"all {len(failed)} evaluations{which} are withdrawn"]
        others = " or are withdrawn" if withdrawn.any() else ""
        return [f"all {len(failed)} evaluations{which} failed{others}: see why the last one did"]
    missing = [n for n in problem.required_diagnostics if np.isnan(data.column(n)).all()]
    if missing:
        return [_lacks(data, name) for name in missing] + _alike(data)
    return _constraints(data, belief) + _references(problem, belief) + _alike(data)


def doubts(models: Mapping[str, GaussianProcess], belief: Belief, *, noisy: bool) -> list[str]:
    """Return which outputs the models cannot explain, be it for noise or for what is not a variable.

    A prediction is that from all other readings, with the hyperparameters of the last training. A constraint
    counts only if it is in doubt whether it is met.

    Args:
        models: Trained models by their outputs.
        belief: What they believe of the evaluations.
        noisy: Whether the readings are believed to be noisy.
    """
    sentences, problem = [], belief.problem
    front = belief.objectives[belief.front_rows()]
    gains: dict[str, float] = {}
    if noisy and len(front) >= FEWEST_ON_FRONT:
        gains = dict(zip(problem.objective_names, np.ptp(front, axis=0), strict=True))
    fewest = max(FEWEST, FEWEST_PER_VARIABLE * len(problem.variables))
    for name, model in models.items():
        if model.n < fewest or model.is_constant:
            continue
        left_out = model.leave_one_out()
        readings = left_out.mean + left_out.residual
        latest = slice(-fewest, None)  # more shots cure the later readings, not those before
        error = float(np.median(np.abs(left_out.residual[latest])))
        spread = float(np.median(np.abs(readings - np.median(readings))))
        is_unexplained = error > UNEXPLAINED * spread > 0.0
        is_noise = error <= float(np.median(model.known_noise[latest]))
        is_harmless = name not in problem.objective_names and (
            is_noise or is_surely_met(problem, name, left_out.mean, left_out.stddev)
        )
        if is_harmless:
            continue
        if is_unexplained and not is_noise:
            sentences.append(
                f"the model predicts {name} badly: it is off by {error:.3g}, and the readings differ by "
                f"{spread:.3g}; queue one set-point twice: if its readings differ as much, the noise is larger "
                "than the gain, so take more shots; else something else changes it, such as drift"
            )
        elif is_unexplained or error > gains.get(name, math.inf):
            reach = gains.get(name, math.inf)
            where = f"all readings of {name} differ by {spread:.3g}"
            if error > reach:
                where = f"on the front {name} differs by {reach:.3g}"
            sentences.append(
                f"the noise of {name} is larger than the gain: readings are off by {error:.3g}, and "
                f"{where}; take more shots, or end the run"
            )
    return sentences


def sudden_change(data: Dataset, jumps: Sequence[float]) -> list[str]:
    """Return that the machine changed at once, until `RECENT` evaluations came after that.

    Args:
        data: Evaluations.
        jumps: Times of the first evaluation after each change [s].
    """
    if not jumps:
        return []
    after = np.flatnonzero(data.times >= jumps[-1])
    if len(after) == 0 or len(after) > RECENT:
        return []
    return [
        f"the machine changed at once, before evaluation {after[0]}: find out what happened; what was "
        "measured earlier counts for less now"
    ]


def doubtful_references(
    given: Problem, data: Dataset, suspected: Sequence[tuple[int, str]]
) -> list[str]:
    """Return which inferred components of the reference point rest on a suspected reading.

    Args:
        given: Problem as it was given, without them.
        data: Evaluations, with the problem that has them.
        suspected: Suspected readings, by index and diagnostic.
    """
    sentences = []
    for left_out, objective in zip(given.objectives, data.problem.objectives, strict=True):
        if math.isfinite(left_out.reference) or math.isinf(objective.reference):
            continue
        readings = objective.sign * data.column(objective.name)
        for index in [index for index, name in suspected if name == objective.name]:
            others = np.delete(readings, index)
            if (
                np.nanmax(others, initial=-math.inf)
                < readings[index]
                < objective.sign * objective.reference
            ):
                sentences.append(
                    f"the reference of {objective.reference:.4g} in {objective.name} was inferred from evaluation "
                    f"{index}, whose reading is suspected: withdraw it, or set objectives.{objective.name}.reference"
                )
    return sentences


def is_surely_met(problem: Problem, name: str, means: Array, stddevs: Array) -> bool:
    """Return whether an output has limits, and all predictions meet them by three standard deviations.

    Args:
        problem: Problem with the limits.
        name: Name of the output.
        means: Predictions ``(n,)``.
        stddevs: Their standard deviations ``(n,)``.
    """
    limits = [c for c in problem.constraints if c.name == name]
    low, high = means - 3.0 * stddevs, means + 3.0 * stddevs
    return bool(limits) and all(
        (low >= c.minimum).all() and (high <= c.maximum).all() for c in limits
    )


def nearest_to_reference(objectives: Array, reference: Array) -> int:
    """Return the row ``(n, P)`` whose objective that lacks most lacks least.

    What it lacks is measured by the spread of the objectives.
    """
    spread = np.std(objectives, axis=0)
    spread = np.where(spread > 0.0, spread, np.maximum(np.abs(objectives[0] - reference), 1e-300))
    return int(((objectives - reference) / spread).max(axis=1).argmin())


def _lacks(data: Dataset, name: str) -> str:
    """Say why no reading of a diagnostic counts."""
    if any(np.isfinite(e.values.get(name, math.nan)) and not e.failed for e in data.evaluations):
        return f"all readings of {name} are withdrawn"
    return f"{name} was never measured: check its name and its source"


def _constraints(data: Dataset, belief: Belief) -> list[str]:
    """Say which constraint was never met, or that all never were at once."""
    if belief.feasible.any() or not data.problem.constraints:
        return []
    sentences = []
    for constraint in data.problem.constraints:
        values = data.column(constraint.name)
        values = values[np.isfinite(values)]
        if not any(constraint.is_met(value) for value in values):
            lack = np.maximum(constraint.minimum - values, values - constraint.maximum)
            sides = (("at least", constraint.minimum), ("at most", constraint.maximum))
            limits = " and ".join(f"{w} {v:.4g}" for w, v in sides if math.isfinite(v))
            sentences.append(
                f"no point meets the constraint that {constraint.name} is {limits}; "
                f"nearest {values[lack.argmin()]:.4g}: check the limit, constraints.{constraint.name}"
            )
    return sentences or [_tightest(data)]


def _tightest(data: Dataset) -> str:
    """Say that all constraints were never met at once, and which one is met least often."""
    met = {c.name: sum(map(c.is_met, data.column(c.name))) for c in data.problem.constraints}
    name = min(met, key=lambda each: met[each])
    return (
        f"no point meets all constraints at once; {name} is met by the fewest, {met[name]} of "
        f"{len(data)}: relax it, or the one that matters least"
    )


def _references(problem: Problem, belief: Belief) -> list[str]:
    """Say which component of the reference point was never reached, or that all never were."""
    rows = np.flatnonzero(belief.feasible & np.isfinite(belief.objectives).all(axis=1))
    if not len(rows) or not problem.has_references:
        return []
    objectives, reference = belief.objectives[rows], problem.reference_point
    sentences = []
    for objective, column, limit in zip(problem.objectives, objectives.T, reference, strict=True):
        if not (column < limit).any():
            sentences.append(
                f"no point is better than the reference of {objective.reference:.4g} in "
                f"{objective.name}; nearest {objective.sign * column.min():.4g}: set "
                f"objectives.{objective.name}.reference to a value that is reached"
            )
    if sentences:
        return sentences
    row = nearest_to_reference(objectives, reference)
    lacking = ", ".join(
        f"{o.name} is {o.sign * value:.4g} (reference {o.reference:.4g})"
        for o, value in zip(problem.objectives, objectives[row], strict=True)
        if not value < o.sign * o.reference
    )
    return [
        "no point is better than the reference point in all objectives at once; in evaluation "
        f"{rows[row]}, which comes nearest, {lacking}: relax the references"
    ]


def _alike(data: Dataset) -> list[str]:
    """Say which diagnostic always reads the same."""
    sentences = []
    for name in data.problem.required_diagnostics:
        values = data.column(name)
        values = values[np.isfinite(values)]
        if len(values) > 2 and np.ptp(values) == 0.0:
            sentences.append(
                f"all {len(values)} readings of {name} are {values[0]:.4g}: check whether the "
                "diagnostic is alive"
            )
    return sentences
