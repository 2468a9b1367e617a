"""Conflict between objectives: which of them are worth a plot.

Without compiled code, because displays use it: importing that costs a process 60 MB.
"""

from __future__ import annotations

from itertools import combinations

import numpy as np

from mobo_tuner.core.arrays import FloatArray


def conflicting_pair(front: FloatArray) -> tuple[int, int]:
    """Return the columns of the two objectives that conflict most on a front.

    Args:
        front: Minimised objectives of the front, `(n, P)`, P at least 2; NaN if not measured.

    Returns:
        The pair with the lowest rank correlation (Spearman's) over the points that have both; the
        first such pair, or `(0, 1)` if fewer than three points do.
    """
    best, lowest = (0, 1), np.inf
    for pair in combinations(range(front.shape[1]), 2):
        both = front[:, pair]
        both = both[np.isfinite(both).all(axis=1)]
        ranks = np.argsort(np.argsort(both, axis=0, kind="stable"), axis=0)
        if len(both) >= 3:
            correlation = np.atleast_2d(np.corrcoef(ranks.T))[0, 1]
            if correlation < lowest - 1e-12:
                best, lowest = pair, correlation
    return best
