"""The initial design: set-points chosen before there is a model."""

from __future__ import annotations

import numpy as np

from mobo_tuner.core.domain import TOLERANCE, Domain
from mobo_tuner.core.problem import Array

_POOL = 2048  # allowed points among which replacements are sought
DESIGNS = ("latin_hypercube", "random")


def initial_design(kind: str, n: int, domain: Domain, seed: int) -> Array:
    """Draw `n` points of a domain of ``[-1, 1]^d``, shape ``(n, d)``.

    They depend on the arguments alone.

    Args:
        kind: "latin_hypercube" to distribute the points along each axis ([Roussel2021]_, section
            subsec:convergence), or "random" to draw them uniformly (its toy problem).
        n: Number of points. They are different from each other, unless the domain has fewer.
        domain: Domain of d variables.
        seed: Seed of the random number generator.
    """
    from scipy.stats import qmc  # takes half a second, which a check of settings does not need

    d = len(domain.values)
    rng = np.random.default_rng([seed, 0])
    spread = kind == "latin_hypercube"
    unit = qmc.LatinHypercube(d, seed=rng).random(n) if spread else rng.random((n, d))
    points: Array = np.asarray(2.0 * unit - 1.0)
    return points if domain.is_box else _fitted(points, domain, rng)


def _fitted(points: Array, domain: Domain, rng: np.random.Generator) -> Array:
    """Return points ``(n, d)`` on the grids; those outside the limits or twice there are replaced.

    Each of these is replaced by the allowed point that is farthest from all others.
    """
    snapped = domain.snap(points)
    pool = domain.draw(_POOL, rng)
    kept = np.zeros(len(points), dtype=np.bool_)
    for i in np.flatnonzero(domain.contains(snapped)):
        kept[i] = not (np.abs(snapped[kept] - snapped[i]) <= TOLERANCE).all(axis=1).any()
    to_kept = domain.distances(pool, snapped[kept])
    distances, times = to_kept.min(axis=1, initial=np.inf), (to_kept <= TOLERANCE).sum(axis=1)
    for i in np.flatnonzero(~kept):
        # Once all are used, each comes again as often as any other.
        fewest = np.flatnonzero(times == times.min())
        snapped[i] = pool[fewest[distances[fewest].argmax()]]
        to_new = domain.distances(pool, snapped[i : i + 1])[:, 0]
        distances, times = np.minimum(distances, to_new), times + (to_new <= TOLERANCE)
    return snapped
