"""The initial design: set-points chosen before there is a model."""

from __future__ import annotations

import numpy as np

from mobo_tuner.core.problem import Array

DESIGNS = ("latin_hypercube", "random")


def initial_design(kind: str, n: int, d: int, seed: int) -> Array:
    """Draw `n` points of ``[-1, 1]^d``, shape ``(n, d)``.

    They depend on the arguments alone.

    Args:
        kind: "latin_hypercube" to distribute the points along each axis ([Roussel2021]_, section
            subsec:convergence), or "random" to draw them uniformly (its toy problem).
        n: Number of points.
        d: Number of variables.
        seed: Seed of the random number generator.
    """
    from scipy.stats import qmc  # takes half a second, which a check of settings does not need

    rng = np.random.default_rng([seed, 0])
    spread = kind == "latin_hypercube"
    unit = qmc.LatinHypercube(d, seed=rng).random(n) if spread else rng.random((n, d))
    return np.asarray(2.0 * unit - 1.0)
