"""Suspected readings: a few that are nothing like what all others say of the place where they were taken.

A reading is suspected if a model of all others rules it out by far. It does not count as long as it
is; what repeats nearby is not suspected, so that a cliff or a region without beam is believed as soon
as a second evaluation confirms it. Readings that are far from all others hide each other, and are
set aside before any is judged; those of an instrument that fails for a while do not confirm each
other. An instrument that has stopped gives the same reading again and again, to the last digit, within the range of
all others: those are suspected together. Where many readings are alike (a plateau, a clipped camera, no beam
yet), one that differs is what was sought, and nothing is suspected.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mobo_tuner.core.gaussian_process import GaussianProcess
from mobo_tuner.core.problem import Array, rows_apart

_PLATEAU = 0.25  # share of readings that are alike from which on none is suspected
_FEWEST = 5  # readings that say anything of another one
_STANDS_OUT = 2.5  # standardised residuals, in units of the usual one, that are looked at
_RULED_OUT = 10.0  # standard deviations from the prediction of all others
_DOUBTFUL = 3.0  # the same where another output of the evaluation is suspected
_LEAST_SHARE = 0.4  # of the others' range by which it is off
_MOST_SHARE = 0.1  # of all readings that may be suspected
_FEW_APART = 5  # readings far from all others that are set aside, or more as above
_LEAST_REST = 8  # others
_NEARBY = 0.5  # largest distance in any input of the kernel at which readings confirm each other
_ALIKE = 3.0  # largest ratio of the deviations of readings that confirm each other
_STOPPED = 3  # set-points in a row with the same reading, of an instrument that has stopped


def find_suspects(
    model: GaussianProcess,
    x: Array,
    y: Array,
    stddev: Array,
    former: NDArray[np.intp],
    rng: np.random.Generator,
) -> NDArray[np.intp]:
    """Return which readings are suspected, as sorted rows; O(n^3) for each one that stands out.

    Args:
        model: Model trained on all readings but the former suspects, in their order; a plain one, which
            does not bend as easily to a wrong reading.
        x: Normalised inputs ``(n, d)``.
        y: Readings ``(n,)``.
        stddev: Known standard deviations ``(n,)``; NaN where unknown.
        former: Rows that were suspected so far.
        rng: Random number generator of the trainings.
    """
    suspects: dict[int, float] = {}
    kept = np.delete(np.arange(len(y)), former)
    if len(kept) == 0 or np.unique(y[kept], return_counts=True)[1].max() > _PLATEAU * len(kept):
        return np.empty(0, dtype=np.intp)
    apart = rows_apart(y, max(_FEW_APART, int(_MOST_SHARE * len(y))), _LEAST_REST)
    stopped = np.setdiff1d(_stopped(x, y), apart)
    hidden = np.setdiff1d(apart, former)
    if len(hidden) > 1:
        kept, former = np.setdiff1d(kept, hidden), np.union1d(former, hidden)
        model = model.untrained().fit(x[kept], y[kept], stddev[kept], rng=rng)
    rest = np.setdiff1d(kept, stopped)
    if len(stopped) and len(rest) > _FEWEST:
        other = model.untrained().fit(x[rest], y[rest], stddev[rest], rng=rng)
        if any(
            _deviation(other, x[i], float(y[i]), float(stddev[i]), _MOST_SHARE, _DOUBTFUL)
            is not None
            for i in stopped
        ):
            kept, former, model = rest, np.setdiff1d(former, stopped), other
        else:
            stopped = stopped[:0]
    while len(kept) > _FEWEST:
        loo = model.leave_one_out()
        residual = np.abs(loo.residual) / loo.stddev
        worst = int(residual.argmax())
        if residual[worst] < _STANDS_OUT * max(float(np.median(residual)) / 0.6745, 1e-3):
            break
        i, kept = int(kept[worst]), np.delete(kept, worst)
        if abs(loo.residual[worst]) < 0.5 * _LEAST_SHARE * np.ptp(y[kept]):
            break
        model = model.untrained().fit(x[kept], y[kept], stddev[kept], rng=rng)
        deviation = _deviation(model, x[i], float(y[i]), float(stddev[i]))
        if deviation is None:
            break
        suspects[i] = deviation
    for i in former:
        deviation = _deviation(model, x[i], float(y[i]), float(stddev[i]))
        if deviation is not None:
            suspects[int(i)] = deviation
    seen = model.seen(x)
    found = np.array(
        sorted(i for i in suspects if not _is_confirmed(i, suspects, seen, i in apart)),
        dtype=np.intp,
    )
    few = len(np.setdiff1d(found, apart)) <= max(1, int(_MOST_SHARE * len(y)))
    return np.union1d(found if few else np.intersect1d(found, apart), stopped)


def _stopped(x: Array, y: Array) -> NDArray[np.intp]:
    """Return the rows of readings ``(n,)`` that repeat the one before within the range of all others.

    Where any others are alike, readings have few values, and nothing is said. The first of them may be right.

    Args:
        x: Inputs ``(n, d)`` in the order of measuring.
        y: Readings ``(n,)``.
    """
    stays = np.concatenate([[False], (np.diff(y) == 0.0) & (np.diff(x, axis=0) != 0.0).any(axis=1)])
    begins = np.flatnonzero(~stays)
    runs = [rows for rows in np.split(np.arange(len(y)), begins[1:]) if len(rows) >= _STOPPED]
    if not runs:
        return np.empty(0, dtype=np.intp)
    others = np.delete(y, np.concatenate([rows[1:] for rows in runs]))
    if len(np.unique(others)) < len(others):
        return np.empty(0, dtype=np.intp)
    within = [rows[1:] for rows in runs if others.min() < y[rows[0]] < others.max()]
    return np.concatenate(within) if within else np.empty(0, dtype=np.intp)


def is_doubtful(model: GaussianProcess, row: int) -> bool:
    """Return whether a reading is far from what all others say, if another output there is suspected.

    Args:
        model: Model of the other output.
        row: Row of the reading among those of the model.
    """
    loo = model.leave_one_out()
    residual = np.abs(loo.residual) / loo.stddev
    usual = max(1.0, float(np.sqrt(np.mean(np.square(np.delete(residual, row))))))
    return bool(residual[row] > _DOUBTFUL * usual)


def is_surprising(model: GaussianProcess, x: Array, y: float, stddev: float) -> bool:
    """Return whether a new reading is ruled out by a model of those before; it may be suspected.

    Args:
        model: Model of the readings so far.
        x: Normalised input ``(d,)``.
        y: Reading.
        stddev: Known standard deviation; NaN if unknown.
    """
    return model.n > _FEWEST and _deviation(model, x, y, stddev) is not None


def _deviation(
    model: GaussianProcess,
    x: Array,
    y: float,
    stddev: float,
    share: float = _LEAST_SHARE,
    deviations: float = _RULED_OUT,
) -> float | None:
    """Return how far a reading is from the prediction of all others; None if they do not rule it out.

    Args:
        model: Model of all others.
        x: Normalised input ``(d,)``.
        y: Reading.
        stddev: Known standard deviation; NaN if unknown.
        share: Share of the others' range by which it is off if it is ruled out.
        deviations: The same in standard deviations.
    """
    mean, spread = model.predict(x[None])
    deviation = float(y - mean[0])
    least, most = model.range
    if abs(deviation) <= share * (most - least):
        return None
    loo = model.leave_one_out()
    calibration = max(1.0, float(np.sqrt(np.mean(np.square(loo.residual / loo.stddev)))))
    spread_of_reading = np.hypot(spread[0], model.noise_at(x))
    if np.isfinite(stddev):
        spread_of_reading = np.hypot(spread_of_reading, stddev)
    ruled_out = abs(deviation) > deviations * calibration * float(spread_of_reading)
    return deviation if ruled_out else None


def _is_confirmed(i: int, deviations: dict[int, float], x: Array, far: bool) -> bool:
    """Return whether another reading nearby deviates in the same way.

    Where it is far from all others, an instrument may have failed for a while: readings of a row in which none was
    as expected do not confirm each other, and a reading that is as expected and nearer speaks against it.

    Args:
        i: Row of the reading, in the order of measuring.
        deviations: Deviations of the suspects by their rows.
        x: Inputs as the kernel sees them, where every other choice without an order is far.
        far: Whether it is far from all others.
    """
    distances = np.abs(x - x[i]).max(axis=1)
    expected = np.delete(distances, list(deviations))
    nearest = expected.min(initial=np.inf) if far else np.inf
    for j, other in deviations.items():
        alike = other * deviations[i] > 0.0 and 1.0 / _ALIKE <= other / deviations[i] <= _ALIKE
        if j != i and alike and distances[j] <= min(_NEARBY, nearest):
            between = range(min(i, j) + 1, max(i, j))
            if not far or any(k not in deviations for k in between):
                return True
    return False
