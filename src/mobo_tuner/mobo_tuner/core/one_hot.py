"""Unordered variables as inputs of models: one column for each choice.

One-hot inputs make every choice equally far from every other one, and with a length-scale of its own for each
column, the data tell which of them are alike. Suggestions are exactly at the choices, as [Garrido2020]_ recommends: a
model that is smooth in between would misplace its maxima.

.. [Garrido2020] E. C. Garrido-Merchan, D. Hernandez-Lobato, "Dealing with categorical and integer-valued variables in
   Bayesian optimization with Gaussian processes", Neurocomputing 380, 20-35 (2020).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mobo_tuner.core.arrays import FloatArray


class OneHot:
    """Replaces the columns of unordered variables by one column for each choice: 1 for it, else 0.

    Further columns, such as time, are kept at the end.

    Args:
        places: For each variable its normalised choices ``(k,)`` in ascending order if they are unordered; None if
            it is ordered.
    """

    def __init__(self, places: Sequence[FloatArray | None]) -> None:
        self._places = tuple(places)
        self._columns = [
            column for j, p in enumerate(places) for column in [j] * (1 if p is None else len(p))
        ]

    @property
    def width(self) -> int:
        """Number of columns of all variables."""
        return len(self._columns)

    def expand(self, x: FloatArray) -> FloatArray:
        """Return inputs ``(m, d + r)`` with `width` + r columns."""
        parts = []
        for j, places in enumerate(self._places):
            column = x[:, j]
            if places is None:
                parts.append(column[:, None])
            else:
                chosen = np.abs(column[:, None] - places).argmin(axis=1)
                parts.append(np.eye(len(places))[chosen])
        return np.hstack([*parts, x[:, len(self._places) :]])

    def pull_back(self, gradient: FloatArray) -> FloatArray:
        """Return the gradient in the variables for one in the columns; 0 for the unordered ones."""
        pulled = np.zeros((len(gradient), len(self._places) + gradient.shape[1] - self.width))
        at = 0
        for j, places in enumerate(self._places):
            if places is None:
                pulled[:, j] = gradient[:, at]
            at += 1 if places is None else len(places)
        pulled[:, len(self._places) :] = gradient[:, self.width :]
        return pulled

    def fold(self, precision: FloatArray) -> FloatArray:
        """Return a precision matrix of the variables for one of the columns: the largest entry of each block."""
        d = len(self._places)
        columns = np.array([*self._columns, *range(d, d + len(precision) - self.width)])
        folded = np.zeros((columns[-1] + 1, columns[-1] + 1))
        np.maximum.at(folded, (columns[:, None], columns), precision)
        return folded
