"""Compiled kernels that sum over the boxes of a decomposition.

Every acquisition function built on the hypervolume is a sum over boxes of a product of
one-dimensional differences,

    sum_b prod_j (G_j(u_bj) - G_j(l_bj)),

with functions G_j that increase from zero. They are tabulated once per candidate, at the levels of
the tree (see `mobo_tuner.core.box_tree`), so that the sum only needs look-ups. As G_j increases, the
product of G_j(u_j) at the top of a branch is an upper bound of the branch's contribution.

No term is negative, so that even a tiny sum has the relative accuracy of the tabulated values.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import erfcx

from mobo_tuner.core.arrays import FloatArray
from mobo_tuner.core.box_tree import LEAF, BoxTree
from mobo_tuner.core.compilation import compiled

_HALF_NODES, _HALF_WEIGHTS = np.polynomial.legendre.leggauss(6)
_QUADRATURE_NODES = 0.5 * (_HALF_NODES + 1.0)
_QUADRATURE_WEIGHTS = 0.5 * _HALF_WEIGHTS
_DENSITY_AT_ZERO = 1.0 / math.sqrt(2.0 * math.pi)
_UNDERFLOW_FROM = 39.0
_CERTAIN_FROM = 9.0  # beyond it, the other tail is below the rounding error
_CELLS = 8  # cells per unit in the table of ratios
_DEGREE = 7
_ROOT: Any = np.uint64(0)  # same type as the other nodes, so that `_box` is compiled once
_SMALLEST_STDDEV = 1e-250  # below it, a prediction counts as certain, because z would overflow


# --- one-dimensional integrals --------------------------------------------------------------------


def _table_of_ratios() -> FloatArray:
    """Return polynomials of the ratios Q / phi and (phi - x Q) / phi in cells of x from 0 to 39.

    They interpolate at Chebyshev nodes. The second ratio suffers from cancellation for large x, and
    is computed there from the continued fraction Q / phi = 1 / (x + 1 / (x + 2 / (x + ...))).

    Returns:
        The coefficients of the powers of the distance to the cell's middle, highest power first,
        `(cells, _DEGREE + 1, 2)`.
    """
    n_cells = int(_UNDERFLOW_FROM) * _CELLS
    nodes = np.polynomial.chebyshev.chebpts1(_DEGREE + 1) * (0.5 / _CELLS)
    x = (np.arange(n_cells)[:, None] + 0.5) / _CELLS + nodes
    mills = math.sqrt(0.5 * math.pi) * erfcx(x * math.sqrt(0.5))
    fraction = x.copy()
    for k in range(60, 1, -1):
        fraction = x + k / fraction
    shortfall = np.where(x < 4.0, 1.0 - x * mills, mills / fraction)
    values = np.stack([mills, shortfall], axis=2)
    table: FloatArray = np.linalg.solve(np.vander(nodes), values)
    return table


_RATIOS = _table_of_ratios()


@compiled
def _tail(x: float) -> tuple[float, float, float]:
    """Return integral_x^inf (w - x) phi(w) dw, Q(x) = integral_x^inf phi and phi(x), for x >= 0.

    Relative errors stay below 1e-13.
    """
    if x >= _UNDERFLOW_FROM:
        return 0.0, 0.0, 0.0
    density = _DENSITY_AT_ZERO * math.exp(-0.5 * x * x)
    cell = int(x * _CELLS)
    step = x - (cell + 0.5) / _CELLS
    mass = _RATIOS[cell, 0, 0]
    shortfall = _RATIOS[cell, 0, 1]
    for k in range(1, _DEGREE + 1):
        mass = mass * step + _RATIOS[cell, k, 0]
        shortfall = shortfall * step + _RATIOS[cell, k, 1]
    return density * shortfall, density * mass, density


@compiled
def _expected_shortfall(z: float) -> tuple[float, float, float]:
    """Return E[max(z - w, 0)], Phi(z) and phi(z) for a standard normal w."""
    if z > _CERTAIN_FROM:
        return z, 1.0, 0.0
    shortfall, mass, density = _tail(abs(z))
    if z < 0.0:
        return shortfall, mass, density
    return z + shortfall, 1.0 - mass, density


@compiled
def _truncated_shortfall(lower: float, upper: float) -> tuple[float, float, float]:
    """Return S = E[(upper - w) 1(lower <= w <= upper)] of a standard normal w, and its derivatives.

    Returns:
        S, E[w (upper - w) 1(...)] and E[(w^2 - 1) (upper - w) 1(...)]: with w = (y - mean) / stddev
        these are the integral and its derivatives in mean and stddev.
    """
    width = upper - lower
    if width * (1.0 + max(abs(lower), abs(upper))) < 1.0:
        # The closed forms below cancel on a short interval; the integrand is smooth there.
        value = slope_mean = slope_stddev = 0.0
        for node, weight in zip(_QUADRATURE_NODES, _QUADRATURE_WEIGHTS):  # noqa: B905
            w = lower + node * width
            term = weight * (1.0 - node) * math.exp(-0.5 * w * w)
            value += term
            slope_mean += term * w
            slope_stddev += term * (w * w - 1.0)
        scale = width * width * _DENSITY_AT_ZERO
        return scale * value, scale * slope_mean, scale * slope_stddev
    below, below_mass, below_density = _tail(abs(lower))
    above, above_mass, above_density = _tail(abs(upper))
    if lower >= 0.0:
        value = above - below + width * below_mass
        mass = below_mass - above_mass
    elif upper <= 0.0:
        value = above - below - width * below_mass
        mass = above_mass - below_mass
    else:
        value = upper + above - below - width * below_mass
        mass = 1.0 - above_mass - below_mass
    rise = width * below_density
    return max(value, 0.0), rise - mass, above_density - below_density + lower * rise


@compiled
def _fill_tables(
    levels: FloatArray,
    mean: FloatArray,
    stddev: FloatArray,
    floor: FloatArray,
    values: FloatArray,
    slopes: FloatArray,
) -> None:
    """Tabulate G_j(t) = E[max(t - y_j, 0) 1(y_j >= A_j)], y_j ~ N(mean_j, stddev_j^2).

    For a standard deviation of zero, y_j is the mean itself. At a kink, the slope is that on the
    side without improvement.

    Args:
        levels: Thresholds t `(k, P)`.
        mean: Predicted means `(P,)`.
        stddev: Predicted standard deviations `(P,)`.
        floor: Lower corner A of the truncation box `(P,)`; minus infinity for no truncation.
        values: G at the levels `(k, P)`; overwritten.
        slopes: Derivatives of G in mean and stddev `(k, P, 2)`, overwritten; `(0, P, 2)` to skip
            them.
    """
    n_levels, n_objectives = levels.shape
    with_slopes = len(slopes) > 0
    slopes[:] = 0.0
    for j in range(n_objectives):
        if stddev[j] < _SMALLEST_STDDEV:
            credited = mean[j] >= floor[j]
            for i in range(n_levels):
                gain = levels[i, j] - mean[j]
                values[i, j] = gain if credited and gain > 0.0 else 0.0
                if with_slopes and values[i, j] > 0.0:
                    slopes[i, j, 0] = -1.0
            continue
        precision = 1.0 / stddev[j]
        z_floor = (floor[j] - mean[j]) * precision
        for i in range(n_levels):
            values[i, j] = 0.0
            z = (levels[i, j] - mean[j]) * precision
            if z <= z_floor or z <= -_UNDERFLOW_FROM or z_floor >= _UNDERFLOW_FROM:
                continue
            if z_floor <= -_UNDERFLOW_FROM:
                shortfall, mass, slope_stddev = _expected_shortfall(z)
                slope_mean = -mass
            else:
                shortfall, slope_mean, slope_stddev = _truncated_shortfall(z_floor, z)
            values[i, j] = stddev[j] * shortfall
            if with_slopes:
                slopes[i, j, 0] = slope_mean
                slopes[i, j, 1] = slope_stddev


# --- sums over boxes ------------------------------------------------------------------------------


@compiled
def _box(
    tree: BoxTree,
    values: FloatArray,
    slopes: FloatArray,
    node: int,
    before: FloatArray,
    gradient: FloatArray,
) -> float:
    """Return prod_j (G_j(u_j) - G_j(l_j)) of one box, and add its derivatives to `gradient`."""
    n_objectives = values.shape[1]
    product = 1.0
    for j in range(n_objectives):
        before[j] = product
        product *= values[tree.upper[node, j], j] - values[tree.lower[node, j], j]
    if len(slopes) == 0 or product == 0.0:
        return product
    after = 1.0
    for j in range(n_objectives - 1, -1, -1):
        above = tree.upper[node, j]
        below = tree.lower[node, j]
        others = before[j] * after
        gradient[j, 0] += others * (slopes[above, j, 0] - slopes[below, j, 0])
        gradient[j, 1] += others * (slopes[above, j, 1] - slopes[below, j, 1])
        after *= values[above, j] - values[below, j]
    return product


@compiled
def _bound(tree: BoxTree, values: FloatArray, node: int) -> float:
    """Return prod_j G_j(u_j) at the top of a branch."""
    product = 1.0
    for j in range(values.shape[1]):
        product *= values[tree.upper[node, j], j]
    return product


@compiled
def _sum_over_boxes(
    tree: BoxTree,
    values: FloatArray,
    slopes: FloatArray,
    tolerance: float,
    stack: NDArray[np.int32],
    bounds: FloatArray,
    gradient: FloatArray,
) -> float:
    """Return sum_b prod_j (G_j(u_bj) - G_j(l_bj)), with a relative error of at most `tolerance`.

    The contribution of a branch is at most prod_j G_j(u_j) at its top. A branch is skipped if the
    sum of all skipped bounds stays below the tolerated fraction of the sum.

    Args:
        tree: Tree of the boxes.
        values: G at the levels `(k, P)`.
        slopes: Derivatives of G in mean and stddev `(k, P, 2)`, or `(0, P, 2)`.
        tolerance: Relative tolerance.
        stack: Work space for `k P` nodes.
        bounds: Work space of the same length.
        gradient: Derivatives of the sum `(P, 2)`; overwritten unless `slopes` is empty.
    """
    n_objectives = values.shape[1]
    before = np.empty(n_objectives)
    for j in range(n_objectives):
        gradient[j, 0] = gradient[j, 1] = 0.0
    if tree.first_child[0] == LEAF:
        return _box(tree, values, slopes, _ROOT, before, gradient)
    stack[0] = 0
    bounds[0] = _bound(tree, values, _ROOT)
    size = 1
    total = 0.0
    neglected = 0.0
    while size > 0:
        size -= 1
        if neglected + bounds[size] <= tolerance * total:
            neglected += bounds[size]
            continue
        first = tree.first_child[stack[size]]
        for child in range(first, first + tree.n_children[stack[size]]):
            axis = tree.axis[child]
            if values[tree.upper[child, axis], axis] <= 0.0:
                continue
            if tree.first_child[child] == LEAF:
                total += _box(tree, values, slopes, child, before, gradient)
            else:
                bound = _bound(tree, values, child)
                if bound > 0.0:
                    stack[size] = child
                    bounds[size] = bound
                    size += 1
    return total


@compiled
def expected_improvements(
    tree: BoxTree,
    levels: FloatArray,
    mean: FloatArray,
    stddev: FloatArray,
    floor: FloatArray,
    tolerance: float,
    with_gradient: bool,
) -> tuple[FloatArray, FloatArray]:
    """Evaluate the expected hypervolume improvement of m candidates.

    Args:
        tree: Tree of the boxes.
        levels: Levels of the tree `(k, P)`.
        mean: Predicted means `(m, P)`.
        stddev: Predicted standard deviations `(m, P)`.
        floor: Lower corner of the truncation box `(P,)`, see `_fill_tables`.
        tolerance: Relative tolerance.
        with_gradient: Whether to compute the derivatives.

    Returns:
        The improvements `(m,)`, and their derivatives in mean and stddev `(m, P, 2)`, or zeros.
    """
    n_levels, n_objectives = levels.shape
    values = np.empty((n_levels, n_objectives))
    slopes = np.empty((n_levels if with_gradient else 0, n_objectives, 2))
    stack = np.empty(n_levels * n_objectives, np.int32)
    bounds = np.empty(n_levels * n_objectives)
    improvements = np.empty(len(mean))
    gradients = np.empty((len(mean), n_objectives, 2))
    for i in range(len(mean)):
        _fill_tables(levels, mean[i], stddev[i], floor, values, slopes)
        improvement = _sum_over_boxes(tree, values, slopes, tolerance, stack, bounds, gradients[i])
        improvements[i] = max(0.0, improvement)  # rounding can leave a tiny negative sum
    return improvements, gradients
