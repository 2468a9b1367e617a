"""Which variable drives an output: first-order Sobol indices of a function on the normalised box."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from mobo_tuner.core.domain import sobol
from mobo_tuner.core.problem import Array


def first_order_indices(
    function: Callable[[Array], Array], d: int, samples: int = 1024, seed: int = 0
) -> Array:
    """Return the share of a function's variance that each variable alone explains.

    The variables are independent and uniform over [-1, 1]. The estimator is that of [Saltelli2010]_,
    Table 2 (b), on scrambled Sobol points; its error is about `1 / sqrt(samples)` at most. It takes
    `samples (d + 2)` values of the function.

    Args:
        function: Function from inputs ``(m, d)`` to values ``(m,)``.
        d: Number of variables.
        samples: Number of base points, a power of two.
        seed: Seed of the scrambling.

    Returns:
        Indices ``(d,)``, each in [0, 1]; all zero if the function is constant.

    .. [Saltelli2010] A. Saltelli et al., "Variance based sensitivity analysis of model output. Design and
       estimator for the total sensitivity index", Comput. Phys. Commun. 181, 259 (2010).

    Example:
        >>> first_order_indices(lambda x: 2.0 * x[:, 0] + x[:, 1], 2).round(2)
        array([0.8, 0.2])
    """
    points = 2.0 * sobol(2 * d, samples, seed) - 1.0
    base, other = points[:, :d], points[:, d:]
    at_base, at_other = function(base), function(other)
    variance = float(np.var(np.concatenate([at_base, at_other])))
    scale = float(np.abs(at_base).max())
    if not variance > (1e-12 * scale) ** 2:
        return np.zeros(d)
    centred = at_other - at_other.mean()
    indices = np.empty(d)
    for j in range(d):
        mixed = base.copy()
        mixed[:, j] = other[:, j]
        indices[j] = np.mean(centred * (function(mixed) - at_base)) / variance
    return np.clip(indices, 0.0, 1.0)
