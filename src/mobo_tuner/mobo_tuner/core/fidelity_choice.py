"""The choice of a fidelity for a candidate: gain of hypervolume, or knowledge of it, per cost."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mobo_tuner.core.archive import Archive
from mobo_tuner.core.constraints import log_probability_between
from mobo_tuner.core.dataset import Dataset
from mobo_tuner.core.fidelity import Fidelity
from mobo_tuner.core.models import Models
from mobo_tuner.core.problem import Array
from mobo_tuner.core.resolution import SAME

_DRAWS = 64  # of what a cheaper evaluation may read
_LEAST_AGREEMENT = 0.5  # share of the variance, below which what is cheap replaces no design
_GOOD_AGREEMENT = 0.8  # above which what is learned serves later evaluations, too
_VARIABLES_SERVED = 2.0  # for which it then counts once
_MOST_SPENT = 1.0  # on cheaper evaluations since the last one at the highest fidelity, in its cost


class _Foresight(NamedTuple):
    """Prediction of one output at the highest fidelity, and what m evaluations may teach of it.

    Attributes:
        mean: Mean, as it is minimised.
        stddev: Standard deviation.
        correlations: Correlation of the output with the reading of each evaluation ``(m,)``.
    """

    mean: float
    stddev: float
    correlations: Array


def needs_design(archive: Archive, fidelity: Fidelity) -> bool:
    """Return whether a design at the highest fidelity is due: the cheaper ones turned out to tell little of it.

    The archive's models are updated.
    """
    archive.update()
    highest = np.count_nonzero(archive.dataset.highest)
    if highest >= archive.initial_evaluations or not archive.models.ready:
        return False
    lacks = np.array([fidelity.lack(level) for level in fidelity.levels[:-1]])
    return _agreement(archive, lacks) < _LEAST_AGREEMENT


def choose_fidelity(archive: Archive, fidelity: Fidelity, x: Array, seed: int) -> dict[str, float]:
    """Return the fidelity with which a candidate should be evaluated: the cheapest in the initial design.

    At the highest fidelity, an evaluation gains the expected improvement v itself. A cheaper one gains
    knowledge: after it, the candidate promises w in place of v, and another one is taken, which promised
    about as much, where w is less. The expected gain of that is E max(w - v, 0), by draws of what it may
    read, as often as it serves (`times_served`). What gains most for its cost is chosen. The highest fidelity
    is also chosen if so much was spent on cheaper evaluations since the last one there as one there costs:
    whatever the models believe of the cheaper ones, at most twice the cost is spent.

    Args:
        archive: Evaluations and models of the last update.
        fidelity: Fidelities that may be chosen.
        x: Candidate ``(d,)``.
        seed: Seed of the draws.
    """
    data, models = archive.dataset, archive.models
    levels, shares = fidelity.levels, fidelity.shares
    if len(data) < archive.initial_evaluations:
        return dict(levels[0])
    lacks = np.array([fidelity.lack(level) for level in levels])
    allowed = _spent(data, fidelity) + shares <= _MOST_SPENT
    allowed &= ~_known(data, x, lacks)
    allowed[-1] = True
    if not allowed[:-1].any() or not models.ready:
        return fidelity.highest
    rng = np.random.default_rng([seed, 8, len(data)])
    foresight = _foresee(models, x, lacks)
    normals = rng.standard_normal((_DRAWS, len(foresight)))
    values = _values(archive, foresight, lacks, normals)
    gains = np.maximum(values - values[-1:, :1], 0.0).mean(axis=1)
    gains *= times_served(archive, lacks[:-1])
    gains[-1] = values[-1, 0]
    if not gains.any():  # nothing is promised anywhere: what is learned counts alone
        gains = np.mean([each.correlations**2 for each in foresight.values()], axis=0)
    rates = np.where(allowed, gains / shares, -math.inf)
    return dict(levels[int(rates.argmax())])


def times_served(archive: Archive, lacks: Array) -> float:
    """Return for how many evaluations at the highest fidelity the knowledge of a cheaper one is worth its gain.

    It is one for every two variables, at least one: the more variables, the more evaluations are still to come
    that gain from the same knowledge. Where it is not certain that the fidelities agree well, it is one.

    Args:
        archive: Evaluations and models.
        lacks: Distances of the lower fidelities from the highest ``(m, f)``.
    """
    if _agreement(archive, lacks) < _GOOD_AGREEMENT:
        return 1.0
    return max(len(archive.problem.variables) / _VARIABLES_SERVED, 1.0)


def _agreement(archive: Archive, lacks: Array) -> float:
    """Return how well the best one of lower fidelities tells of the highest: the share of the variance, 0 to 1.

    It is that of a reading at one fidelity that is explained by a reading at the same place at the other, by the
    models' kernels, as a mean of the outputs.

    Args:
        archive: Evaluations and models.
        lacks: Distances of the fidelities from the highest ``(m, f)``.
    """
    models, place = archive.models, np.zeros((1, len(archive.problem.variables)))
    inputs = models.inputs_at(place, np.vstack([0.0 * lacks[:1], lacks]))
    shares = [
        output.process.prior_correlations(inputs) ** 2 * (not output.is_apart)
        for output in models.learned
    ]
    return float(np.mean(shares, axis=0).max()) if shares else 1.0


def _foresee(models: Models, x: Array, lacks: Array) -> dict[str, _Foresight]:
    """Return what evaluations at one point may teach, for every output that was measured at least once.

    Args:
        models: Models of the outputs.
        x: Point ``(d,)``.
        lacks: Distances of their fidelities from the highest ``(m, f)``.
    """
    inputs, foreseen = models.inputs_at(x[None], lacks), {}
    for output in models.learned:
        mean, stddev = output.process.predict(x[None])
        correlations = output.process.correlations(x, inputs)
        if output.is_apart:
            correlations[lacks.any(axis=1)] = 0.0
        foreseen[output.name] = _Foresight(float(mean[0]), float(stddev[0]), correlations)
    return foreseen


def _spent(data: Dataset, fidelity: Fidelity) -> float:
    """Return the cost since the last evaluation at the highest fidelity, as a share of one there."""
    highest = np.flatnonzero(data.highest)
    since = int(highest[-1]) + 1 if len(highest) else 0
    return math.fsum(fidelity.share(e.setpoint) for e in data.evaluations[since:])


def _known(data: Dataset, x: Array, lacks: Array) -> NDArray[np.bool_]:
    """Return at which fidelities ``(m, f)`` an evaluation at x ``(d,)`` was made already ``(m,)``."""
    here = (np.abs(data.inputs - x) <= SAME).all(axis=1)
    return np.array(
        [(here & (np.abs(data.lacks - each) <= SAME).all(axis=1)).any() for each in lacks]
    )


def _values(
    archive: Archive, foresight: Mapping[str, _Foresight], lacks: Array, normals: Array
) -> Array:
    """Return what a candidate promises after evaluations that read what is drawn, by fidelity ``(m, s)``.

    Args:
        archive: Evaluations and models.
        foresight: What the models predict of the candidate, by output.
        lacks: Fidelities ``(m, f)``, the highest one last, for which it is what it promises now.
        normals: Independent standard normal numbers ``(s, outputs)``.
    """
    models, problem = archive.models, archive.problem
    shape = len(lacks), len(normals)
    moments = {}
    for (name, foreseen), drawn in zip(foresight.items(), normals.T, strict=True):
        learned = np.append(foreseen.correlations[:-1], 0.0)[:, None]
        mean = foreseen.mean + foreseen.stddev * learned * drawn
        rest = foreseen.stddev * np.sqrt(np.maximum(1.0 - learned**2, 0.0))
        moments[name] = mean.ravel(), np.broadcast_to(rest, shape).ravel()
    values = np.ones(math.prod(shape))
    for name, _, least, most in models.limited:
        if name in moments:
            values *= np.exp(log_probability_between(*moments[name], least, most)[0])
    known = [moments[name] for name in problem.objective_names if name in moments]
    is_feasible = not models.constraints or archive.belief.feasible.any()
    if len(known) == len(problem.objectives) and problem.has_references and is_feasible:
        mean, stddev = (np.stack(each, axis=1) for each in zip(*known, strict=True))
        lower = problem.truncation_lower
        values *= archive.front().expected_improvement(
            mean, stddev, lower if np.isfinite(lower).any() else None
        )
    return values.reshape(shape)
