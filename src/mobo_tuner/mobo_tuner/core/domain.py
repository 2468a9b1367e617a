"""The domain of the search: grids, choices, fixed variables and linear limits within [-1, 1]^d.

.. [Boyle1986] J. P. Boyle, R. L. Dykstra, "A method for finding projections onto the intersection of
   convex sets in Hilbert spaces", Lecture Notes in Statistics 37, 28-47 (1986).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from mobo_tuner.core.arrays import FloatArray

TOLERANCE = 1e-9
"""Largest distance from a bound or a grid that is rounding, where a variable spans 2."""
CHANGED = 1.0
"""Distance between two choices without an order, where other variables span 2: half their range."""
_ROUNDING = 1e-12  # excess of a limit, relative to the range of its sum, that is rounding
# Distance from a limit, likewise, at which a projection ends: no rounding leads across it.
_INSET = 1e-9
SMALL = 4096
"""Number of points up to which a domain is searched point by point."""
_PROJECTIONS = 40
_NODES = 100_000  # of the search for a point within the limits
# Steps towards the centre of what a projection leaves outside, the last onto the centre.
_PULLS = 24


def sobol(d: int, count: int, rng: np.random.Generator | int) -> FloatArray:
    """Return the first points of a scrambled Sobol sequence in [0, 1)^d, shape ``(count, d)``.

    Args:
        d: Number of dimensions.
        count: Number of points, a power of two: then they are evenly spread.
        rng: Random number generator of the scrambling, or its seed.
    """
    from scipy.stats import qmc  # takes half a second, which a check of settings can spare

    return np.asarray(qmc.Sobol(d, seed=rng).random(count))


class EmptyDomainError(ValueError):
    """No point of the box is on all grids and within all limits."""


class Domain:
    """The normalised set-points that may be suggested.

    Args:
        values: For each variable its allowed values in ascending order, ``(k,)`` in [-1, 1]; None if it
            is continuous.
        coefficients: Coefficients of the linear limits ``(m, d)``.
        lower: Lower ends of the limits ``(m,)``, minus infinity for none.
        upper: Upper ends ``(m,)``, infinity for none.
        unordered: Which variables have no order; empty = none.

    Raises:
        EmptyDomainError: If no point is allowed.
    """

    def __init__(
        self,
        values: Sequence[FloatArray | None],
        coefficients: FloatArray | None = None,
        lower: FloatArray | None = None,
        upper: FloatArray | None = None,
        unordered: Sequence[bool] = (),
    ) -> None:
        d = len(values)
        self.unordered = np.array(unordered or [False] * d, dtype=np.bool_)
        self.values = tuple(values)
        self._a = np.empty((0, d)) if coefficients is None else coefficients
        self._lower = np.empty(0) if lower is None else lower
        self._upper = np.empty(0) if upper is None else upper
        self._range = np.abs(self._a).sum(axis=1)
        self._center = self._find_center() if len(self._a) else None

    @property
    def is_box(self) -> bool:
        """Whether all of [-1, 1]^d is allowed."""
        return len(self._a) == 0 and all(v is None for v in self.values)

    def distances(
        self, a: FloatArray, b: FloatArray, metric: Literal["euclidean", "chebyshev"] = "euclidean"
    ) -> FloatArray:
        """Return the distances ``(m, n)`` between points ``(m, d)`` and ``(n, d)``.

        Two choices of a variable without an order are `CHANGED` apart, whichever they are.
        """
        from scipy.spatial.distance import cdist  # takes time, which a check of settings can spare

        if not self.unordered.any():
            return np.asarray(cdist(a, b, metric))
        changed = CHANGED * np.sum(
            [np.abs(a[:, None, j] - b[:, j]) > TOLERANCE for j in np.flatnonzero(self.unordered)],
            axis=0,
        )
        ordered = np.zeros(changed.shape)
        if not self.unordered.all():
            ordered = cdist(a[:, ~self.unordered], b[:, ~self.unordered], metric)
        if metric == "chebyshev":
            return np.asarray(np.maximum(ordered, np.minimum(changed, CHANGED)))
        return np.asarray(np.sqrt(ordered**2 + CHANGED * changed))

    @cached_property
    def discrete(self) -> NDArray[np.bool_]:
        """Which variables have grids, ``(d,)``."""
        return np.array([v is not None for v in self.values])

    @property
    def size(self) -> float:
        """Number of points on the grids, whether the limits allow them or not; infinity if any is free."""
        return math.prod(math.inf if v is None else len(v) for v in self.values)

    def points(self) -> FloatArray:
        """Return all points of a finite domain, ``(m, d)``."""
        grids = np.meshgrid(*[v for v in self.values if v is not None], indexing="ij")
        points = np.column_stack([g.ravel() for g in grids])
        return points[self.contains(points)]

    def contains(self, x: FloatArray) -> NDArray[np.bool_]:
        """Return which rows of x ``(m, d)`` are allowed."""
        inside = (np.abs(x) <= 1.0 + TOLERANCE).all(axis=1) & self._within_limits(x)
        return np.asarray(inside & (np.abs(self.snap(x) - x) <= TOLERANCE).all(axis=1))

    def nearest(self, x: FloatArray) -> FloatArray:
        """Return allowed points ``(m, d)`` near the rows of x, each its own if that is allowed."""
        if self.is_box:
            return np.clip(x, -1.0, 1.0)
        found = self.snap(np.clip(x, -1.0, 1.0))
        outside = ~self._within_limits(found)
        if outside.any():
            found[outside] = self._pull(self.project(x[outside]))
        return found

    def project(self, x: FloatArray) -> FloatArray:
        """Return the points ``(m, d)`` of the box within the limits near x, whatever the grids.

        Alternating projections with corrections [Boyle1986]_, cut off after some turns: a rest of the
        way is made straight towards the centre.
        """
        x = np.clip(x, -1.0, 1.0)
        if self._center is None:
            return x
        rows = ~self._within_limits(x)
        if not rows.any():
            return x
        moved = x[rows]
        corrections = np.zeros((len(self._a) + 1, *moved.shape))
        for _ in range(_PROJECTIONS):
            for i, (a, low, high) in enumerate(zip(self._a, self._lower, self._upper, strict=True)):
                wanted = moved + corrections[i]
                value = wanted @ a
                excess = value - np.clip(value, low, high)
                moved = wanted - (excess / (a @ a))[:, None] * a
                corrections[i] = wanted - moved
            wanted = moved + corrections[-1]
            moved = np.clip(wanted, -1.0, 1.0)
            corrections[-1] = wanted - moved
        x[rows] = self._retract(moved)
        return x

    def draw(self, count: int, rng: np.random.Generator) -> FloatArray:
        """Return allowed points, at most `count` and different from each other, ``(m, d)``.

        They are spread over the domain; all points of a domain with no more of them.
        """
        if self.size <= count:
            return self.points()
        x = 2.0 * sobol(len(self.values), 2 ** math.ceil(math.log2(count)), rng) - 1.0
        snapped = self.snap(x)
        inside = self._within_limits(snapped)
        if np.count_nonzero(inside) < len(x) // 4:  # the limits leave little of the box
            snapped = np.vstack([snapped[inside], self.nearest(x[~inside])])
        else:
            snapped = snapped[inside]
        _, first = np.unique(np.round(snapped / TOLERANCE), axis=0, return_index=True)
        return snapped[np.sort(first)][:count]

    def neighbours(self, x: FloatArray) -> FloatArray:
        """Return allowed points ``(m, d)`` around the point x ``(d,)``, from near to far in each variable."""
        rows = []
        for j, values in enumerate(self.values):
            if values is None:
                moves = x[j] + np.outer([-1.0, 1.0], 0.3 * 0.3 ** np.arange(8)).ravel()
            elif self.unordered[j]:
                moves = values
            else:
                here = int(np.abs(values - x[j]).argmin())
                reach = 2 ** np.arange(len(values).bit_length())
                places = np.concatenate([here - reach, here + reach])
                moves = values[places[(places >= 0) & (places < len(values))]]
            around = np.repeat(x[None], len(moves), axis=0)
            around[:, j] = moves
            rows.append(around)
        return self.nearest(np.vstack(rows))

    # ------------------------------------------------------------------ grids and limits

    def snap(self, x: FloatArray) -> FloatArray:
        """Return x ``(m, d)`` with every variable at its nearest allowed value."""
        snapped = x.copy()
        for j, values in enumerate(self.values):
            if values is not None:
                after = np.searchsorted(values, x[:, j]).clip(1, max(len(values) - 1, 1))
                before = values[after - 1]
                after_value = values[np.minimum(after, len(values) - 1)]
                snapped[:, j] = np.where(
                    x[:, j] - before <= after_value - x[:, j], before, after_value
                )
        return snapped

    def _within_limits(self, x: FloatArray) -> NDArray[np.bool_]:
        value = x @ self._a.T
        slack = _ROUNDING * self._range
        low, high = self._lower - slack, self._upper + slack
        return np.asarray(((low <= value) & (value <= high)).all(axis=1))

    def _retract(self, x: FloatArray) -> FloatArray:
        """Move rows of x ``(m, d)`` straight towards the centre until they are within the limits."""
        assert self._center is not None
        inner, outer = self._a @ self._center, x @ self._a.T
        low, high = self._lower + _INSET * self._range, self._upper - _INSET * self._range
        with np.errstate(divide="ignore", invalid="ignore"):
            share = np.where(
                outer > high,
                (high - inner) / (outer - inner),
                np.where(outer < low, (low - inner) / (outer - inner), 1.0),
            )
        share = np.clip(np.nan_to_num(share), 0.0, 1.0).min(axis=1)[:, None]
        return np.asarray(self._center + share * (x - self._center))

    def _pull(self, x: FloatArray) -> FloatArray:
        """Snap rows of x ``(m, d)``, and those that leave the limits by it from nearer to the centre."""
        assert self._center is not None
        found = self.snap(x)
        for share in np.linspace(1.0, 0.0, _PULLS)[1:]:
            outside = ~self._within_limits(found)
            if not outside.any():
                break
            found[outside] = self.snap(self._center + share * (x[outside] - self._center))
        return found

    def _find_center(self) -> FloatArray:
        """Return the allowed point ``(d,)`` with the largest distance to the limits and the bounds.

        A mixed-integer linear programme: a grid is a sum of its values, each times 0 or 1, or a multiple
        of its step.
        """
        from scipy.optimize import Bounds, LinearConstraint, milp
        from scipy.sparse import lil_matrix

        d, columns = len(self.values), len(self.values) + 1  # the variables, then the distance
        integers: list[tuple[int, FloatArray]] = []
        for j, values in enumerate(self.values):
            if values is not None:
                integers.append((j, values))
        sizes = [1 if _is_even(v) else len(v) for _, v in integers]
        total = columns + sum(sizes)
        low, high = np.full(total, 0.0), np.full(total, 1.0)
        low[:d], high[:d], high[d] = -1.0, 1.0, 2.0
        kinds = np.concatenate([np.zeros(columns), np.ones(total - columns)])
        rows = lil_matrix((2 * len(self._a) + 2 * len(integers), total))
        ends = np.zeros((rows.shape[0], 2))
        norms = np.linalg.norm(self._a, axis=1)
        for i, a in enumerate(self._a):
            rows[2 * i, :d], rows[2 * i, d] = a, norms[i]
            rows[2 * i + 1, :d], rows[2 * i + 1, d] = a, -norms[i]
        ends[: 2 * len(self._a) : 2] = np.column_stack(
            [np.full(len(self._a), -np.inf), self._upper]
        )
        ends[1 : 2 * len(self._a) : 2] = np.column_stack(
            [self._lower, np.full(len(self._a), np.inf)]
        )
        at, row = columns, 2 * len(self._a)
        for (j, values), size in zip(integers, sizes, strict=True):
            rows[row, j] = -1.0
            if size == 1 and len(values) > 1:
                rows[row, at] = (values[-1] - values[0]) / (len(values) - 1)
                high[at] = len(values) - 1
                ends[row] = -values[0]
            else:
                rows[row, at : at + size] = values
                rows[row + 1, at : at + size] = 1.0
                ends[row + 1] = 1.0
            at, row = at + size, row + 2
        cost = np.zeros(total)
        cost[d] = -1.0
        solved = milp(
            cost,
            integrality=kinds,
            bounds=Bounds(low, high),
            constraints=LinearConstraint(rows.tocsr(), ends[:, 0], ends[:, 1]),
            options={"node_limit": _NODES},  # no time limit: the answer must not depend on the host
        )
        if solved.x is None:
            raise EmptyDomainError("no set-point is within all limits")
        center = self.snap(np.clip(solved.x[None, :d], -1.0, 1.0))
        if not self._within_limits(center)[0]:
            raise EmptyDomainError("no set-point is within all limits")
        return np.asarray(center[0])


def _is_even(values: FloatArray) -> bool:
    """Return whether values are a constant step apart."""
    steps = np.diff(values)
    return len(values) == 1 or bool(np.ptp(steps) <= 1e-12)
