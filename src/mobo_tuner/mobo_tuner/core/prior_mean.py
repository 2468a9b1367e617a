"""Prior means: what is known of an output before anything is measured, such as a surrogate of the machine."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from mobo_tuner.core.gaussian_process_settings import MeanFunction
from mobo_tuner.core.problem import LARGEST, Array, Problem, ProblemError

PriorMean = Callable[[Mapping[str, Array]], Array]
"""Predicts one quantity in its own unit, shape ``(n,)``, from one array ``(n,)`` per variable."""


def mean_functions(
    problem: Problem, prior_means: Mapping[str, PriorMean] | None
) -> dict[str, MeanFunction]:
    """Return prior means of modelled outputs, by name, as functions of normalised inputs.

    Args:
        problem: Problem whose quantities are modelled.
        prior_means: Prior means in the quantities' units, by name.

    Raises:
        ProblemError: If one is given for a quantity that is not modelled, or is not a function that
            returns numbers.
    """
    if prior_means is not None and not isinstance(prior_means, Mapping):
        raise ProblemError(f"prior_means must be a mapping of names, not {prior_means!r:.60}")
    functions = {n: _mean_function(problem, n, f) for n, f in (prior_means or {}).items()}
    for name, function in functions.items():
        if name not in problem.required_diagnostics:
            raise ProblemError(
                f"a prior mean is given for '{name}'; allowed are "
                f"{', '.join(problem.required_diagnostics)}"
            )
        function(np.zeros((2, len(problem.variables))))
    return functions


def _mean_function(problem: Problem, name: str, prior_mean: PriorMean) -> MeanFunction:
    """Return the prior mean of an output as it is modelled."""
    sign = next((o.sign for o in problem.objectives if o.name == name), 1.0)
    if not callable(prior_mean):
        raise ProblemError(f"the prior mean of '{name}' must be a function")

    def mean(x: Array) -> Array:
        predicted = prior_mean(problem.columns(x[:, : len(problem.variables)]))
        try:
            values = np.asarray(predicted, dtype=float)
        except (TypeError, ValueError):
            values = np.empty(0)
        if values.shape != (len(x),) or not (np.abs(values) <= LARGEST).all():
            raise ProblemError(
                f"the prior mean of '{name}' must return {len(x)} finite numbers for as many "
                f"set-points, not {predicted!r:.60}"
            )
        return sign * values

    return mean
