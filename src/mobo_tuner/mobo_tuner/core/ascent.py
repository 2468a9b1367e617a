"""Two local maximisation methods over the box [-1, 1]^d, for many starts at once.

The function has a high fixed cost per call and a low cost per point. Therefore all starts step
together, with one evaluation of the whole batch per step.

.. [Bertsekas1982] D. P. Bertsekas, "Projected Newton methods for optimization problems with simple
   constraints", SIAM Journal on Control and Optimization 20, 221-246 (1982).
.. [Igel2003] C. Igel, M. Huesken, "Empirical evaluation of the improved Rprop learning algorithms",
   Neurocomputing 50, 105-123 (2003).
.. [Nocedal2006] J. Nocedal, S. J. Wright, "Numerical optimization", Springer (2006).
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from mobo_tuner.core.arrays import FloatArray

Function = Callable[[FloatArray], tuple[FloatArray, FloatArray]]
"""Callable from points `(m, d)` to values `(m,)` and gradients `(m, d)`.

The value of a forbidden point is minus infinity.
"""

_FIRST_STEP = 0.05
_SUFFICIENT = 1e-4  # fraction of the increase predicted by the slope


def climb_by_signs(function: Function, x: FloatArray, steps: int) -> tuple[FloatArray, FloatArray]:
    """Step along the signs of the gradients, independent of the function's scale `[Igel2003]_`.

    A component's step grows while its sign stays the same, and shrinks when the sign changes.

    Args:
        function: Function to maximise.
        x: Starts `(m, d)`.
        steps: Number of steps of each start.

    Returns:
        The best point of each start `(m, d)` and its value `(m,)`.
    """
    best, best_value = x.copy(), np.full(len(x), -np.inf)
    step = np.full(x.shape, _FIRST_STEP)
    last_sign = np.zeros_like(x)
    for _ in range(steps + 1):
        value, gradient = function(x)
        better = value > best_value
        best[better], best_value[better] = x[better], value[better]
        sign = np.sign(gradient)
        turned = sign * last_sign
        step = np.where(turned > 0.0, 1.4 * step, np.where(turned < 0.0, 0.4 * step, step))
        step = np.clip(step, 1e-6, 0.4)
        x = np.clip(x + sign * step, -1.0, 1.0)
        last_sign = np.where(turned < 0.0, 0.0, sign)
    return best, best_value


def climb_by_curvature(
    function: Function, x: FloatArray, evaluations: int, tolerance: float
) -> None:
    """Climb to the maxima by the BFGS method, projected onto the box `[Bertsekas1982]_`.

    Every start has its own inverse Hessian `[Nocedal2006]_` Eq. (6.17) and line search; it leaves
    the batch when the predicted increase of its next step is below the tolerance. `function` must
    record the best points itself.

    Args:
        function: Function to maximise, finite at the starts.
        x: Starts `(m, d)`.
        evaluations: Highest number of evaluations of each start.
        tolerance: Smallest increase of the function that counts.
    """
    value, gradient = function(x)
    d = x.shape[1]
    curvature = np.zeros((len(x), d, d))  # inverse Hessian of minus the function
    curvature[:] = np.eye(d)
    norm = np.linalg.norm(gradient, axis=1)
    curvature *= (_FIRST_STEP / np.where(norm > 0.0, norm, 1.0))[:, None, None]
    scaled = np.zeros(len(x), dtype=np.bool_)
    length = np.ones(len(x))
    for _ in range(evaluations - 1):
        blocked = np.abs(x) >= 1.0
        blocked &= x * gradient >= 0.0
        free_gradient = np.where(blocked, 0.0, gradient)
        direction = np.einsum("mij,mj->mi", curvature, free_gradient)
        direction[blocked] = 0.0
        promise = length * np.einsum("mi,mi->m", direction, free_gradient)
        # Without curvature information, the predicted increase may be far too small.
        going = promise > np.where(scaled, tolerance, 1e-3 * tolerance)
        if not going.all():
            x, value, gradient, curvature, scaled, length, direction = (
                each[going] for each in (x, value, gradient, curvature, scaled, length, direction)
            )
            if len(x) == 0:
                return
        trial = np.clip(x + length[:, None] * direction, -1.0, 1.0)
        trial_value, trial_gradient = function(trial)
        step = trial - x
        slope = np.einsum("mi,mi->m", gradient, step)
        risen = trial_value >= value + _SUFFICIENT * slope
        # If it has not increased enough: to the top of the interpolating parabola, within limits.
        with np.errstate(divide="ignore", invalid="ignore"):
            shrink = 0.5 * slope / (slope - (trial_value - value))
        shrink = np.clip(np.where(np.isfinite(shrink), shrink, 0.1), 0.1, 0.5)
        length = np.where(risen, 1.0, shrink * length)
        change = gradient - trial_gradient
        bend = np.einsum("mi,mi->m", step, change)
        learns = risen & (
            bend > 1e-12 * np.linalg.norm(step, axis=1) * np.linalg.norm(change, axis=1)
        )
        first = learns & ~scaled
        size = np.einsum("mi,mi->m", change, change)
        curvature[first] = np.eye(d) * (bend[first] / size[first])[:, None, None]
        scaled |= learns
        curvature[learns] = _updated(curvature[learns], step[learns], change[learns], bend[learns])
        x = np.where(risen[:, None], trial, x)
        value = np.where(risen, trial_value, value)
        gradient = np.where(risen[:, None], trial_gradient, gradient)


def _updated(
    inverse: FloatArray, step: FloatArray, change: FloatArray, bend: FloatArray
) -> FloatArray:
    """Return the inverse Hessians `(m, d, d)` after steps and gradient changes, `(m, d)` each."""
    carried = np.einsum("mij,mj->mi", inverse, change)
    outer = step[:, :, None] * carried[:, None, :]
    total = bend + np.einsum("mi,mi->m", change, carried)
    return np.asarray(
        inverse
        + (total / bend**2)[:, None, None] * step[:, :, None] * step[:, None, :]
        - (outer + outer.transpose(0, 2, 1)) / bend[:, None, None]
    )
