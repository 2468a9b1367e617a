"""Problems on which a start of a run may get stuck: the development set for the default strategy.

Models of a few evaluations are wrong on each of them in another way, and seem certain. A choice of the default strategy
may be based on these, on the paper's toy, on DTLZ2 and on the injector, and on nothing that is held out (see
`experiments.peers.problems.HELD_OUT`).

- *wells*: every objective has a narrow well near the middle, and falls slowly outwards from there, so that all but a
  few starts say: the better, the farther out;
- *tails*: objectives that span four orders of magnitude, whose front lies in the lowest decade;
- *cliffs*: objectives that are the same almost everywhere, and fall in one corner;
- *needles*: smooth objectives with a constraint that only a small place meets, and whose readings are flat elsewhere;
- *steep constraints* (`steep`, `ledge`, `slender`): a constraint that reads within one unit where it is met, and far
  away where it is missed.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

from experiments.problems import Benchmark
from mobo_tuner.core import Problem
from mobo_tuner.core.arrays import FloatArray


def _centres(d: int, n_objectives: int, distance: float) -> FloatArray:
    """Return a place for each objective `(P, d)`, so far from the middle, which is off the box's middle."""
    rng = np.random.default_rng([d, n_objectives])
    directions = rng.standard_normal((n_objectives, d))
    directions -= directions.mean(axis=0)
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    return np.asarray(rng.uniform(-0.3, 0.3, d) + distance * directions)


def well(d: int, n_objectives: int, share: float = 0.04) -> Benchmark:
    """Return objectives with overlapping wells, from which they fall slowly outwards.

    Args:
        d: Number of variables.
        n_objectives: Number of objectives.
        share: Share of the box that a well fills to half of its depth, roughly.
    """
    # A ball of this radius has that share of the box, but for what lies outside.
    radius = _ball_radius(d, share)
    centres = _centres(d, n_objectives, 0.35 * radius)
    width = radius / np.sqrt(2.0 * np.log(2.0))
    middle = centres.mean(axis=0)

    def objectives(x: FloatArray) -> FloatArray:
        outwards = np.square(x - middle).mean(axis=1)[:, None]
        square = np.square(x[:, None] - centres).sum(axis=2)
        tilt = 0.1 * x[:, [j % d for j in range(n_objectives)]]
        return np.asarray(0.9 - 0.3 * outwards + tilt - 0.8 * np.exp(-0.5 * square / width**2))

    return _benchmark(d, np.full(n_objectives, 1.0), objectives)


def tails(d: int, n_objectives: int, decades: float = 4.0) -> Benchmark:
    """Return objectives whose logarithm is smooth and spans so many decades."""
    centres = _centres(d, n_objectives, 0.5)

    def objectives(x: FloatArray) -> FloatArray:
        distance = np.linalg.norm(x[:, None] - centres, axis=2) / np.sqrt(d)
        logarithm = distance + 0.15 * np.sin(4.0 * x[:, :1] + 2.0 * np.arange(n_objectives))
        return np.asarray(10.0 ** (decades * logarithm / 1.3))

    reference = np.quantile(objectives(_sample(d)), 0.4, axis=0)
    return _benchmark(d, reference, objectives)


def long_valley(d: int) -> Benchmark:
    """Return a Rosenbrock function, which spans five decades, and a distance."""

    def objectives(x: FloatArray) -> FloatArray:
        u = 2.0 * x
        steep = 100.0 * np.square(u[:, 1:] - u[:, :-1] ** 2) + np.square(1.0 - u[:, :-1])
        return np.stack([steep.sum(axis=1), np.square(u + 0.5).sum(axis=1)], axis=1)

    return _benchmark(
        d, np.quantile(objectives(_sample(d)), [0.3, 0.5], axis=0).diagonal(), objectives
    )


def cliff(d: int, n_objectives: int, share: float = 0.1) -> Benchmark:
    """Return objectives that are nearly flat, but for a corner with such a share of the box."""
    direction = np.linspace(1.0, 0.5, d)
    edge = float(np.quantile(_sample(d) @ direction, 1.0 - share))
    centres = 0.6 + _centres(d, n_objectives, 0.5)

    def objectives(x: FloatArray) -> FloatArray:
        low = 1.0 / (1.0 + np.exp(-(x @ direction - edge) / 0.05))[:, None]
        bowl = np.square(x[:, None] - centres).mean(axis=2)
        return np.asarray(1.0 - low * (0.9 - 0.7 * np.minimum(bowl, 1.0)) + 0.02 * bowl)

    return _benchmark(d, np.full(n_objectives, 1.0), objectives)


def needle(d: int, n_objectives: int, share: float = 0.02) -> Benchmark:
    """Return distances with a constraint that is met in such a share of the box, and flat elsewhere."""
    centres = _centres(d, n_objectives, 0.6)
    place = np.random.default_rng([d, n_objectives, 1]).uniform(-0.6, 0.6, d)
    radius = _ball_radius(d, share)

    def objectives(x: FloatArray) -> FloatArray:
        return np.asarray(np.linalg.norm(x[:, None] - centres, axis=2))

    def excess(x: FloatArray) -> FloatArray:
        square = np.square(x - place).sum(axis=1) / radius**2
        return np.asarray(0.5 - np.exp2(-square))

    reference = np.quantile(objectives(_sample(d)), 0.9, axis=0)
    return _benchmark(d, reference, objectives, excess)


def steep(d: int, decades: float = 2.5, share: float = 0.2) -> Benchmark:
    """Return distances with a constraint whose logarithm is smooth and spans so many decades where it is missed.

    Args:
        d: Number of variables.
        decades: Decades of the readings beyond the limit, roughly.
        share: Share of the box that meets the constraint.
    """
    centres = _centres(d, 2, 0.9)
    direction = np.linspace(1.0, -0.6, d)

    def height(x: FloatArray) -> FloatArray:
        wavy = 0.2 * np.sin(4.0 * x[:, 0] + 1.0) * np.cos(3.0 * x[:, -1])
        return np.asarray(x @ direction / np.sqrt(d) + 0.4 * np.square(x).mean(axis=1) + wavy)

    edge, top = np.quantile(height(_sample(d)), [share, 1.0])

    def excess(x: FloatArray) -> FloatArray:
        return np.asarray(10.0 ** (decades * (height(x) - edge) / (top - edge)) - 1.0)

    def objectives(x: FloatArray) -> FloatArray:
        return np.asarray(np.linalg.norm(x[:, None] - centres, axis=2))

    reference = np.quantile(objectives(_sample(d)), 0.8, axis=0)
    return _benchmark(d, reference, objectives, excess)


def ledge(d: int, share: float = 0.25, fall: float = 20.0) -> Benchmark:
    """Return distances with a constraint that is nearly flat where it is met, and read far away beyond a cliff.

    Args:
        d: Number of variables.
        share: Share of the box that meets the constraint.
        fall: Height of the cliff, in units of what the constraint is met by.
    """
    centres = _centres(d, 2, 0.9)
    direction = np.linspace(-0.5, 1.0, d)

    def height(x: FloatArray) -> FloatArray:
        return np.asarray(np.square(x - 0.2 * direction).mean(axis=1) + 0.3 * x @ direction / d)

    edge = float(np.quantile(height(_sample(d)), share))

    def excess(x: FloatArray) -> FloatArray:
        beyond = (height(x) - edge) / 0.08
        return np.asarray(0.3 * beyond + fall / (1.0 + np.exp(-(beyond - 1.5) / 0.4))) / 2.0 - 0.25

    def objectives(x: FloatArray) -> FloatArray:
        return np.asarray(np.linalg.norm(x[:, None] - centres, axis=2))

    reference = np.quantile(objectives(_sample(d)), 0.8, axis=0)
    return _benchmark(d, reference, objectives, excess)


def slender(d: int) -> Benchmark:
    """Return cost and compliance of thicknesses that span a factor of 50, with limits of the load on pairs of them."""
    weights = np.linspace(1.0, 0.5, d)

    def thickness(x: FloatArray) -> FloatArray:
        return np.asarray(0.1 + 2.45 * (np.clip(x, -1.0, 1.0) + 1.0))

    def objectives(x: FloatArray) -> FloatArray:
        t = thickness(x)
        cost = t @ weights + 0.3 * t[:, 0] * t[:, -1]
        return np.stack(
            [cost, 1.0 / t[:, 0] + 1.0 / t[:, -1] ** 2 + 0.05 * t[:, 1:-1].mean(axis=1)], axis=1
        )

    def load(x: FloatArray, j: int) -> FloatArray:
        t = thickness(x)
        return np.asarray(1.5 / (t[:, j] * t[:, j + 1]) + 0.2 * t[:, j] - 1.0)

    definition = _benchmark(d, np.array([14.0, 2.5]), objectives).problem.to_dict()
    definition["constraints"] = {f"g{j}": {"max": 0.0} for j in range(d - 1)}
    return Benchmark(
        Problem.from_dict(definition),
        objectives,
        others={f"g{j}": partial(load, j=j) for j in range(d - 1)},
    )


def _sample(d: int) -> FloatArray:
    return np.random.default_rng(d).uniform(-1.0, 1.0, (20_000, d))


def _ball_radius(d: int, share: float) -> float:
    """Return the radius of a ball around the middle with such a share of the box."""
    return float(np.quantile(np.linalg.norm(_sample(d), axis=1), share))


def _benchmark(
    d: int,
    reference: FloatArray,
    objectives: Callable[[FloatArray], FloatArray],
    excess: Callable[[FloatArray], FloatArray] | None = None,
) -> Benchmark:
    definition: dict[str, Any] = {
        "variables": {f"x{i}": {"min": -1.0, "max": 1.0} for i in range(d)},
        "objectives": {f"f{j}": {"reference": float(r)} for j, r in enumerate(reference)},
    }
    if excess is not None:
        definition["constraints"] = {"g": {"max": 0.0}}
    others = {} if excess is None else {"g": excess}
    return Benchmark(Problem.from_dict(definition), objectives, others=others)


HARD: dict[str, Callable[[], Benchmark]] = {
    "well_2_2": lambda: well(2, 2),
    "well_3_3": lambda: well(3, 3),
    "well_2_3": lambda: well(2, 3, 0.1),
    "well_4_2": lambda: well(4, 2),
    "well_6_4": lambda: well(6, 4),
    "tails_2_2": lambda: tails(2, 2),
    "tails_3_3": lambda: tails(3, 3),
    "tails_5_2": lambda: tails(5, 2),
    "long_valley_3": lambda: long_valley(3),
    "cliff_2_2": lambda: cliff(2, 2),
    "cliff_4_3": lambda: cliff(4, 3),
    "needle_3_2": lambda: needle(3, 2),
    "needle_4_2": lambda: needle(4, 2),
    "steep_2_2": lambda: steep(2),
    "steep_3_2": lambda: steep(3),
    "steep_4_2": lambda: steep(4, 3.5),
    "ledge_2_2": lambda: ledge(2),
    "ledge_4_2": lambda: ledge(4),
    "slender_4_2": lambda: slender(4),
}
"""The problems by kind, number of variables and number of objectives."""
