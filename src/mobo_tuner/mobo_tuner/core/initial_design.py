"""Where a run begins: set-points chosen before any model is trusted."""

from __future__ import annotations

import numpy as np

from mobo_tuner.core.problem import Array

DESIGNS = ("latin_hypercube", "random")


def initial_design(kind: str, n: int, d: int, seed: int) -> Array:
    """Draw `n` points of ``[-1, 1]^d``, shape ``(n, d)``.

    `latin_hypercube` spreads the points along each axis ([Roussel2021]_, section
    subsec:convergence); `random` draws them uniformly (its toy problem). The points depend on the
    arguments alone.
    """
    from scipy.stats import qmc  # takes half a second, which a check of settings can spare

    rng = np.random.default_rng([seed, 0])
    spread = kind == "latin_hypercube"
    unit = qmc.LatinHypercube(d, rng=rng).random(n) if spread else rng.random((n, d))
    return np.asarray(2.0 * unit - 1.0)
