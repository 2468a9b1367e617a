"""Compiled kernels of the box decomposition: a tree of local upper bounds.

The region below the reference point that no point of the front dominates is the union of cones
{z < u} over the local upper bounds u, and it splits into disjoint boxes [l, u), one for each u
`[Lacour2017]_`. Adding a point y replaces every u with y < u by up to P children, each equal to its
parent in all but one objective, where it takes the component of y. The history of these splits is
kept as a tree: the cone of a child lies inside that of its parent, so that whole branches are
passed over exactly, both when a point is added and when the boxes are summed.

Nothing but indices is stored. Row i of `levels` `(k, P)` is a point: rows 0 .. P-1 bound the
objectives at the reference point, row P is minus infinity, the points of the front follow. Box b
then has the upper corner `levels[upper[b, j], j]` and the lower corner `levels[lower[b, j], j]`,
and any sum over boxes of a product of one-dimensional differences,

    sum_b prod_j (G_j(u_bj) - G_j(l_bj)),

takes a table `(k, P)` of the values of G at the levels.

.. [Lacour2017] R. Lacour, K. Klamroth, C. M. Fonseca, "A box decomposition algorithm to compute
   the hypervolume indicator", Computers & Operations Research 79, 347-360 (2017).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, NamedTuple, ParamSpec, TypeVar

import numba
import numpy as np
from numpy.typing import NDArray

from mobo_tuner.core.pareto import FloatArray

Parameters = ParamSpec("Parameters")
Result = TypeVar("Result")
IndexArray = NDArray[Any]  # int16, or int32 for more than 32 000 points

LEAF = -1
_HALF_NODES, _HALF_WEIGHTS = np.polynomial.legendre.leggauss(6)
_QUADRATURE_NODES = 0.5 * (_HALF_NODES + 1.0)
_QUADRATURE_WEIGHTS = 0.5 * _HALF_WEIGHTS
_SQRT_HALF = math.sqrt(0.5)
_DENSITY_AT_ZERO = 1.0 / math.sqrt(2.0 * math.pi)
_TAIL_FROM = 5.0
_UNDERFLOW_FROM = 39.0
_SMALLEST_STDDEV = 1e-250  # below it a prediction counts as certain: z would overflow


def compiled(function: Callable[Parameters, Result]) -> Callable[Parameters, Result]:
    """Compile to machine code that runs without the interpreter lock and is cached on disk."""
    jitted: Callable[Parameters, Result] = numba.njit(cache=True, nogil=True, error_model="numpy")(
        function
    )
    return jitted


class BoxTree(NamedTuple):
    """The tree's arrays, with room for more nodes than are in use; node 0 is the root.

    Attributes:
        upper: `(nodes, P)`, rows of `levels` that give the upper corners.
        lower: `(nodes, P)`, rows of `levels` that give the lower corners; used in leaves.
        axis: `(nodes,)`, the one objective in which a node differs from its parent.
        first_child: `(nodes,)`, the children are contiguous; `LEAF` marks a box in use.
        n_children: `(nodes,)`, 1 to P for an inner node.
    """

    upper: IndexArray
    lower: IndexArray
    axis: NDArray[np.int8]
    first_child: NDArray[np.int32]
    n_children: NDArray[np.int8]


# --- growing the tree -----------------------------------------------------------------------------


@compiled
def _resized(array: NDArray[np.int32], size: int) -> NDArray[np.int32]:
    larger = np.empty(size, np.int32)
    larger[: len(array)] = array
    return larger


@compiled
def find_leaves(tree: BoxTree, levels: FloatArray, point: FloatArray) -> NDArray[np.int32]:
    """Find the boxes whose upper corner is strictly above `point` `(P,)`, which is below the root.

    Returns:
        `(h,)`, their nodes.
    """
    stack = np.empty(1024, np.int32)
    found = np.empty(1024, np.int32)
    stack[0] = 0
    size = 1
    n_found = 0
    while size > 0:
        size -= 1
        node = stack[size]
        first = tree.first_child[node]
        if first == LEAF:
            if n_found == len(found):
                found = _resized(found, 2 * n_found)
            found[n_found] = node
            n_found += 1
            continue
        if size + tree.n_children[node] > len(stack):
            stack = _resized(stack, 2 * len(stack))
        for child in range(first, first + tree.n_children[node]):
            axis = tree.axis[child]
            if point[axis] < levels[tree.upper[child, axis], axis]:
                stack[size] = child
                size += 1
    return found[:n_found].copy()


@compiled
def split_leaves(
    tree: BoxTree, levels: FloatArray, leaves: NDArray[np.int32], row: int, n_nodes: int
) -> tuple[int, float]:
    """Split the boxes found for the point in `levels[row]`.

    Ties are broken as if the newest point were larger (`>=` below): with a strict comparison, boxes
    would be lost where points share a component.

    Args:
        tree: changed in place; needs room for P children of every leaf.
        levels: `(k, P)`.
        leaves: `(h,)`, from `find_leaves`.
        row: the row of the new point.
        n_nodes: nodes in use.

    Returns:
        Nodes in use now, and the hypervolume gained.
    """
    n_objectives = levels.shape[1]
    point = levels[row]
    gained = 0.0
    for leaf in leaves:
        volume = 1.0
        for j in range(n_objectives):
            below = max(levels[tree.lower[leaf, j], j], point[j])
            volume *= levels[tree.upper[leaf, j], j] - below
        gained += volume
        first = n_nodes
        for axis in range(n_objectives):
            largest = -np.inf
            for k in range(n_objectives):
                if k != axis:
                    largest = max(largest, levels[tree.upper[leaf, k], axis])
            if point[axis] >= largest:
                tree.upper[n_nodes] = tree.upper[leaf]
                tree.upper[n_nodes, axis] = row
                tree.axis[n_nodes] = axis
                tree.first_child[n_nodes] = LEAF
                _set_lower_corner(tree, levels, n_nodes)
                n_nodes += 1
        tree.first_child[leaf] = first
        tree.n_children[leaf] = n_nodes - first
    return n_nodes, gained


@compiled
def _set_lower_corner(tree: BoxTree, levels: FloatArray, node: int) -> None:
    """Set l_j to the largest j-th component of the points that bound the objectives before j."""
    n_objectives = levels.shape[1]
    for j in range(n_objectives):
        best = n_objectives  # the row of minus infinity
        for k in range(j):
            row = tree.upper[node, k]
            if levels[row, j] > levels[best, j]:
                best = row
        tree.lower[node, j] = best


# --- one-dimensional integrals --------------------------------------------------------------------


@compiled
def _tail(x: float) -> tuple[float, float, float]:
    """Return integral_x^inf (w - x) phi(w) dw, Q(x) = integral_x^inf phi and phi(x), for x >= 0.

    Relative errors stay below 1e-13: the closed form phi - x Q cancels for large x and gives way to
    the continued fraction Q = phi / (x + 1/(x + 2/(x + ...))).
    """
    if x > _UNDERFLOW_FROM:
        return 0.0, 0.0, 0.0
    density = _DENSITY_AT_ZERO * math.exp(-0.5 * x * x)
    if x < _TAIL_FROM:
        mass = 0.5 * math.erfc(x * _SQRT_HALF)
        return density - x * mass, mass, density
    fraction = x
    for k in range(int(6.0 + 85.0 / x), 1, -1):
        fraction = x + k / fraction
    mass = density / (x + 1.0 / fraction)
    return mass / fraction, mass, density


@compiled
def _expected_shortfall(z: float) -> tuple[float, float, float]:
    """Return E[max(z - w, 0)], Phi(z) and phi(z) for a standard normal w."""
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

    For a standard deviation of zero, y_j is the mean itself. At a kink the slope is that on the side
    of no improvement.

    Args:
        levels: `(k, P)`, the thresholds t.
        mean: `(P,)`.
        stddev: `(P,)`.
        floor: `(P,)`, A; minus infinity for no truncation.
        values: `(k, P)`, G at the levels, written.
        slopes: `(k, P, 2)`, its derivatives in mean and stddev, written.
    """
    values[:] = 0.0
    slopes[:] = 0.0
    n_levels, n_objectives = levels.shape
    for j in range(n_objectives):
        for i in range(n_levels):
            threshold = levels[i, j]
            if threshold <= floor[j] or threshold == -np.inf:
                continue
            if stddev[j] < _SMALLEST_STDDEV:
                if floor[j] <= mean[j] < threshold:
                    values[i, j] = threshold - mean[j]
                    slopes[i, j, 0] = -1.0
                continue
            z = (threshold - mean[j]) / stddev[j]
            z_floor = (floor[j] - mean[j]) / stddev[j]
            if z_floor > _UNDERFLOW_FROM:
                continue
            if z_floor < -_UNDERFLOW_FROM:
                shortfall, mass, density = _expected_shortfall(z)
                slopes[i, j, 0] = -mass
                slopes[i, j, 1] = density
            else:
                shortfall, slopes[i, j, 0], slopes[i, j, 1] = _truncated_shortfall(z_floor, z)
            values[i, j] = stddev[j] * shortfall


# --- sums over boxes ------------------------------------------------------------------------------


@compiled
def _sum_over_boxes(
    tree: BoxTree,
    values: FloatArray,
    tolerance: float,
    stack: NDArray[np.int32],
    bounds: FloatArray,
) -> float:
    """Return sum_b prod_j (G_j(u_bj) - G_j(l_bj)), at most a share `tolerance` too small.

    What a branch can add is bounded by prod_j G_j(u_j) at its top. A branch is passed over when
    everything passed over so far stays below the tolerated share of the sum.
    """
    n_objectives = values.shape[1]
    bound = 1.0
    for j in range(n_objectives):
        bound *= values[j, j]
    stack[0] = 0
    bounds[0] = bound
    size = 1
    total = 0.0
    neglected = 0.0
    while size > 0:
        size -= 1
        node = stack[size]
        bound = bounds[size]
        if neglected + bound <= tolerance * total or bound == 0.0:
            neglected += bound
            continue
        first = tree.first_child[node]
        if first == LEAF:
            product = 1.0
            for j in range(n_objectives):
                product *= values[tree.upper[node, j], j] - values[tree.lower[node, j], j]
            total += product
            continue
        for child in range(first, first + tree.n_children[node]):
            axis = tree.axis[child]
            factor = values[tree.upper[child, axis], axis]
            if factor > 0.0:
                stack[size] = child
                bounds[size] = bound * (factor / values[tree.upper[node, axis], axis])
                size += 1
    return total


@compiled
def _sum_over_boxes_with_gradient(
    tree: BoxTree,
    values: FloatArray,
    slopes: FloatArray,
    tolerance: float,
    stack: NDArray[np.int32],
    bounds: FloatArray,
    gradient_mean: FloatArray,
    gradient_stddev: FloatArray,
) -> float:
    """Do as `_sum_over_boxes`, and write the sum's derivatives in mean and stddev, `(P,)` each."""
    n_objectives = values.shape[1]
    factors = np.empty(n_objectives)
    before = np.empty(n_objectives)
    gradient_mean[:] = 0.0
    gradient_stddev[:] = 0.0
    bound = 1.0
    for j in range(n_objectives):
        bound *= values[j, j]
    stack[0] = 0
    bounds[0] = bound
    size = 1
    total = 0.0
    neglected = 0.0
    while size > 0:
        size -= 1
        node = stack[size]
        bound = bounds[size]
        if neglected + bound <= tolerance * total or bound == 0.0:
            neglected += bound
            continue
        first = tree.first_child[node]
        if first == LEAF:
            product = 1.0
            for j in range(n_objectives):
                before[j] = product
                factors[j] = values[tree.upper[node, j], j] - values[tree.lower[node, j], j]
                product *= factors[j]
            total += product
            after = 1.0
            for j in range(n_objectives - 1, -1, -1):
                others = before[j] * after
                above = tree.upper[node, j]
                below = tree.lower[node, j]
                gradient_mean[j] += others * (slopes[above, j, 0] - slopes[below, j, 0])
                gradient_stddev[j] += others * (slopes[above, j, 1] - slopes[below, j, 1])
                after *= factors[j]
            continue
        for child in range(first, first + tree.n_children[node]):
            axis = tree.axis[child]
            factor = values[tree.upper[child, axis], axis]
            if factor > 0.0:
                stack[size] = child
                bounds[size] = bound * (factor / values[tree.upper[node, axis], axis])
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
) -> FloatArray:
    """Evaluate the expected hypervolume improvement, `(m, P) -> (m,)`."""
    values = np.empty(levels.shape)
    slopes = np.empty((levels.shape[0], levels.shape[1], 2))
    stack = np.empty(levels.size, np.int32)
    bounds = np.empty(levels.size)
    improvements = np.empty(len(mean))
    for i in range(len(mean)):
        _fill_tables(levels, mean[i], stddev[i], floor, values, slopes)
        improvements[i] = _sum_over_boxes(tree, values, tolerance, stack, bounds)
    return improvements


@compiled
def expected_improvements_with_gradient(
    tree: BoxTree,
    levels: FloatArray,
    mean: FloatArray,
    stddev: FloatArray,
    floor: FloatArray,
    tolerance: float,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Evaluate the improvement and its gradients, `(m, P) -> (m,), (m, P), (m, P)`."""
    values = np.empty(levels.shape)
    slopes = np.empty((levels.shape[0], levels.shape[1], 2))
    stack = np.empty(levels.size, np.int32)
    bounds = np.empty(levels.size)
    improvements = np.empty(len(mean))
    gradient_mean = np.empty(mean.shape)
    gradient_stddev = np.empty(mean.shape)
    for i in range(len(mean)):
        _fill_tables(levels, mean[i], stddev[i], floor, values, slopes)
        improvements[i] = _sum_over_boxes_with_gradient(
            tree, values, slopes, tolerance, stack, bounds, gradient_mean[i], gradient_stddev[i]
        )
    return improvements, gradient_mean, gradient_stddev
