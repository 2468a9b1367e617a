"""Compiled kernels that sum over the boxes of a decomposition in logarithms.

They do what `mobo_tuner.core.box_sums` does where its sums underflow: all candidates far from any
improvement. A little slower, and needed only there.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mobo_tuner.core.arrays import FloatArray
from mobo_tuner.core.box_tree import LEAF, BoxTree
from mobo_tuner.core.compilation import compiled

_LOG_DENSITY_AT_ZERO = -0.5 * math.log(2.0 * math.pi)
_SMALLEST_STDDEV = 1e-250
_NEGLIGIBLE = -35.0  # logarithm of the share of the largest box
_FRACTION_FROM = 4.0
_FRACTION_TERMS = 80
_ROOT: Any = np.uint64(0)
_PANELS = np.array([0.0, 0.5, 1.5, 4.0, 9.0, 18.0, 36.0])  # in decay lengths of the density
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(8)


@compiled
def _tail_ratios(x: float) -> tuple[float, float]:
    """Return Q(x) / phi(x) and 1 - x Q(x) / phi(x) for x >= 0, at any x."""
    if x < _FRACTION_FROM:
        mass = 0.5 * math.erfc(x * math.sqrt(0.5))
        mills = mass / math.exp(_LOG_DENSITY_AT_ZERO - 0.5 * x * x)
        return mills, 1.0 - x * mills
    fraction = x
    for k in range(_FRACTION_TERMS, 1, -1):
        fraction = x + k / fraction
    mills = 1.0 / (x + 1.0 / fraction)
    return mills, mills / fraction


@compiled
def _log_shortfall(z: float) -> tuple[float, float, float]:
    """Return log h, -Phi / h and phi / h, h(z) = E[max(z - w, 0)] of a standard normal w."""
    x = abs(z)
    mills, shortfall = _tail_ratios(x)
    log_density = _LOG_DENSITY_AT_ZERO - 0.5 * x * x
    if z <= 0.0:
        return log_density + math.log(shortfall), -mills / shortfall, 1.0 / shortfall
    density = math.exp(log_density)
    h = z + density * shortfall
    return math.log(h), (density * mills - 1.0) / h, density / h


@compiled
def _log_truncated_shortfall(lower: float, upper: float) -> tuple[float, float, float]:
    """Return log S and ratios to S = E[(upper - w) 1(lower <= w <= upper)] of its derivatives.

    By quadrature from the end where the density is largest; relative errors are below 1e-6.
    """
    if upper <= 0.0:
        start, direction = upper, -1.0
    elif lower >= 0.0:
        start, direction = lower, 1.0
    else:
        start, direction = 0.0, 0.0
    total = by_mean = by_stddev = 0.0
    for side in (-1.0, 1.0):
        if direction != 0.0 and side != direction:
            continue
        width = start - lower if side < 0.0 else upper - start
        unit = 1.0 / max(abs(start), 1.0)
        for panel in range(len(_PANELS) - 1):
            left = min(_PANELS[panel] * unit, width)
            right = min(_PANELS[panel + 1] * unit, width)
            half = 0.5 * (right - left)
            if half <= 0.0:
                break
            for node, weight in zip(_NODES, _WEIGHTS):  # noqa: B905
                step = left + half * (1.0 + node)
                w = start + side * step
                away = width - step if side > 0.0 else upper - w
                term = half * weight * away * math.exp(-step * (abs(start) + 0.5 * step))
                total += term
                by_mean += term * w
                by_stddev += term * (w * w - 1.0)
    if total <= 0.0:
        return -math.inf, 0.0, 0.0
    log_density = _LOG_DENSITY_AT_ZERO - 0.5 * start * start
    return log_density + math.log(total), by_mean / total, by_stddev / total


@compiled
def _fill_log_tables(
    levels: FloatArray,
    mean: FloatArray,
    stddev: FloatArray,
    floor: FloatArray,
    logs: FloatArray,
    slopes: FloatArray,
) -> None:
    """Tabulate log G_j, G_j as in `box_sums._fill_tables`, and its derivatives in mean and stddev."""
    n_levels, n_objectives = levels.shape
    for j in range(n_objectives):
        for i in range(n_levels):
            logs[i, j] = -math.inf
            slopes[i, j, 0] = slopes[i, j, 1] = 0.0
            gain = levels[i, j] - mean[j]
            if stddev[j] < _SMALLEST_STDDEV:
                if mean[j] >= floor[j] and gain > 0.0:
                    logs[i, j] = math.log(gain)
                    slopes[i, j, 0] = -1.0 / gain
                continue
            if levels[i, j] == -math.inf or levels[i, j] <= floor[j]:
                continue
            z = gain / stddev[j]
            if abs(z) > 1e150:
                if z > 0.0:
                    logs[i, j] = math.log(gain)
                    slopes[i, j, 0] = -1.0 / gain
                continue
            if floor[j] == -math.inf:
                log_value, by_mean, by_stddev = _log_shortfall(z)
            else:
                z_floor = max((floor[j] - mean[j]) / stddev[j], -1e150)
                log_value, by_mean, by_stddev = _log_truncated_shortfall(z_floor, z)
            if log_value > -math.inf:
                logs[i, j] = math.log(stddev[j]) + log_value
                slopes[i, j, 0] = by_mean / stddev[j]
                slopes[i, j, 1] = by_stddev / stddev[j]


@compiled
def _log_box(
    tree: BoxTree, logs: FloatArray, slopes: FloatArray, node: int, derivatives: FloatArray
) -> float:
    """Return the logarithm of one box, and write its derivatives."""
    total = 0.0
    for j in range(logs.shape[1]):
        above = tree.upper[node, j]
        below = tree.lower[node, j]
        ratio = math.exp(min(logs[below, j] - logs[above, j], 0.0))
        if logs[above, j] == -math.inf or ratio >= 1.0:
            return -math.inf
        total += logs[above, j] + math.log1p(-ratio)
        for k in range(2):
            derivatives[j, k] = (slopes[above, j, k] - ratio * slopes[below, j, k]) / (1.0 - ratio)
    return total


@compiled
def _log_sum_over_boxes(
    tree: BoxTree,
    logs: FloatArray,
    slopes: FloatArray,
    stack: NDArray[np.int32],
    gradient: FloatArray,
) -> float:
    """Return log sum_b prod_j (G_j(u_bj) - G_j(l_bj)), and write its derivatives `(P, 2)`."""
    n_objectives = logs.shape[1]
    derivatives = np.zeros((n_objectives, 2))
    for j in range(n_objectives):
        gradient[j, 0] = gradient[j, 1] = 0.0
    if tree.first_child[0] == LEAF:
        total = _log_box(tree, logs, slopes, _ROOT, derivatives)
        if total > -math.inf:
            gradient[:] = derivatives
        return total
    largest = -math.inf
    share = 0.0  # the sum as a multiple of exp(largest)
    stack[0] = 0
    size = 1
    while size > 0:
        size -= 1
        first = tree.first_child[stack[size]]
        for child in range(first, first + tree.n_children[stack[size]]):
            bound = 0.0
            for j in range(n_objectives):
                bound += logs[tree.upper[child, j], j]
            if not bound > largest + _NEGLIGIBLE:
                continue
            if tree.first_child[child] != LEAF:
                stack[size] = child
                size += 1
                continue
            term = _log_box(tree, logs, slopes, child, derivatives)
            if not term > largest + _NEGLIGIBLE:
                continue
            if term > largest:
                scale = math.exp(largest - term)
                share *= scale
                for j in range(n_objectives):
                    gradient[j, 0] *= scale
                    gradient[j, 1] *= scale
                largest = term
            part = math.exp(term - largest)
            share += part
            for j in range(n_objectives):
                gradient[j, 0] += part * derivatives[j, 0]
                gradient[j, 1] += part * derivatives[j, 1]
    if share == 0.0:
        return -math.inf
    for j in range(n_objectives):
        gradient[j, 0] /= share
        gradient[j, 1] /= share
    return largest + math.log(share)


@compiled
def log_expected_improvements(
    tree: BoxTree, levels: FloatArray, mean: FloatArray, stddev: FloatArray, floor: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return the logarithms of the expected hypervolume improvement of m candidates.

    Args:
        tree: Boxes.
        levels: Levels of the boxes `(k, P)`.
        mean: Predicted means `(m, P)`.
        stddev: Predicted standard deviations `(m, P)`.
        floor: Lower corner A of the truncation box `(P,)`; minus infinity for none.

    Returns:
        The logarithms `(m,)`, and their derivatives in mean and standard deviation `(m, P, 2)`.
    """
    n_levels, n_objectives = levels.shape
    logs = np.empty((n_levels, n_objectives))
    slopes = np.empty((n_levels, n_objectives, 2))
    stack = np.empty(n_levels * n_objectives, np.int32)
    values = np.empty(len(mean))
    gradients = np.empty((len(mean), n_objectives, 2))
    for i in range(len(mean)):
        _fill_log_tables(levels, mean[i], stddev[i], floor, logs, slopes)
        values[i] = _log_sum_over_boxes(tree, logs, slopes, stack, gradients[i])
    return values, gradients
