"""Choice of a working point on a front: the point, the weights, and the bounds around it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from mobo_tuner.core.problem import FARTHEST, LARGEST, Problem, ProblemError, as_float
from mobo_tuner.core.quantities import Limit
from mobo_tuner.core.values import as_integer

LEAST_RADIUS = 10.0 / FARTHEST
"""Smallest radius of a focus, as a fraction of a variable's range.

With it, evaluations anywhere in the range are still near enough for the models.
"""


def choose_on_front(
    problem: Problem,
    front: Sequence[Mapping[str, Any]],
    index: int | None,
    weights: Mapping[str, float] | None,
) -> tuple[dict[str, float], tuple[float, ...]]:
    """Return the set-point of the chosen point, and the weights of the minimised objectives.

    Arguments and errors are those of `Optimizer.focus`.
    """
    if not front:
        raise ProblemError("the front is empty; there is no point to focus on")
    if index is None and weights is None:
        raise ProblemError("index or weights must be given")
    values = np.array(
        [[p["objectives"][o.name] * o.sign for o in problem.objectives] for p in front]
    )
    if weights is not None:
        vector = _checked_weights(problem, weights)
    if index is None:
        row = int(np.argmin(values @ vector))
    else:
        indices = [p["index"] for p in front]
        if as_integer("index", index, 0) not in indices:
            raise ProblemError(
                f"index is {index!r}; the front has {', '.join(str(i) for i in sorted(indices))}"
            )
        row = indices.index(index)
    if weights is None:
        with np.errstate(over="ignore"):
            vector = np.minimum(1.0 / (problem.reference_point - values[row]), LARGEST)
    return dict(front[row]["setpoint"]), tuple(float(w) for w in vector)


def largest_box(problem: Problem, front: Sequence[Mapping[str, Any]]) -> Mapping[str, Any] | None:
    """Return the point of the front that dominates the largest volume; None if the front is empty.

    The volume is the product of its distances to the reference point, which prefers a point that is
    good in every objective to one that is best in some.
    """
    if not front:
        return None
    values = np.array(
        [[p["objectives"][o.name] * o.sign for o in problem.objectives] for p in front]
    )
    return front[int(np.argmax(np.log(problem.reference_point - values).sum(axis=1)))]


def around(
    problem: Problem,
    setpoint: Mapping[str, float],
    radius: float,
    bounds: Problem | None = None,
) -> Problem:
    """Return the problem with bounds reduced to a neighbourhood of a set-point.

    Args:
        problem: Problem to reduce.
        setpoint: Centre of the neighbourhood.
        radius: Half-width of the new bounds, as a fraction of each range.
        bounds: Problem whose bounds and limits must hold, too, such as those of now. What it fixes stays
            where the set-point has it.

    Raises:
        ProblemError: If the radius is not between `LEAST_RADIUS` and 1, the set-point is outside the
            bounds, or the new bounds are too close to each other.
    """
    if not LEAST_RADIUS <= as_float("radius", radius) <= 1.0:
        raise ProblemError(f"radius is {radius!r}; a number from {LEAST_RADIUS:g} to 1 is allowed")
    if bounds is not None and not isinstance(bounds, Problem):
        raise ProblemError(f"bounds must be a Problem, not {bounds!r:.60}")
    others = {v.name: v for v in bounds.variables} if bounds is not None else {}
    variables = []
    for v in problem.variables:
        other = others.get(v.name, v)
        if v.choice_names:  # what has no order has no neighbourhood
            variables.append(replace(v, fixed=as_float(f"set-point {v.name}", setpoint[v.name])))
            continue
        low, high = max(v.minimum, other.minimum), min(v.maximum, other.maximum)
        center = as_float(f"set-point {v.name}", setpoint[v.name])
        if not low <= center <= high:
            allowed = f"{low:g} to {high:g} {v.unit}".rstrip() if low <= high else "nothing"
            raise ProblemError(
                f"the point's {v.name} is {center:g}, outside the bounds; {allowed} is allowed"
            )
        if v.fixed is None:
            at, continuous = v.normalize(center), replace(v, step=0.0, choices=())
            reach = (at - 2.0 * radius, at + 2.0 * radius)
            if v.scale == "log":
                least, most = (continuous.denormalize(end) for end in reach)
            else:
                half = radius * (v.maximum - v.minimum)
                least, most = center - half, center + half
            low, high = max(low, least), min(high, most)
        fixed = center if v.fixed is None and other.fixed is not None else v.fixed
        variables.append(replace(v, minimum=low, maximum=high, fixed=fixed))
    limits = problem.limits if bounds is None else _limits(problem, bounds)
    return Problem.from_dict(replace(problem, variables=tuple(variables), limits=limits).to_dict())


def _limits(problem: Problem, bounds: Problem) -> tuple[Limit, ...]:
    """Return the limits of two problems, as far as they concern the variables of the first one.

    Of two limits of one name, that of the second holds.
    """
    both = {limit.name: limit for limit in (*problem.limits, *bounds.limits)}
    known = {*problem.variable_names}
    return tuple(
        limit for limit in both.values() if all(name in known for name, _ in limit.coefficients)
    )


def _checked_weights(problem: Problem, weights: Mapping[str, float]) -> np.ndarray[Any, Any]:
    if not isinstance(weights, Mapping) or weights.keys() != set(problem.objective_names):
        raise ProblemError(
            f"weights are {weights!r:.60}; one for each of "
            f"{', '.join(problem.objective_names)} is allowed"
        )
    vector = np.array([as_float(f"weight {n}", weights[n]) for n in problem.objective_names])
    if not ((vector >= 0.0).all() and (vector <= LARGEST).all() and vector.any()):
        raise ProblemError(
            f"weights are {dict(weights)}; numbers of at least 0, not all 0, are allowed"
        )
    return vector
