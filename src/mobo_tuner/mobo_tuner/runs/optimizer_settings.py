"""The optimiser of a run, made from the settings that its journal records."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from mobo_tuner.core import Optimizer, Problem, ProblemError

OPTIMIZER_SETTINGS = ("preset", "seed", "initial_evaluations", "proximal", "model_input")
"""Of a tuner."""


def make_optimizer(problem: Problem, settings: Mapping[str, Any]) -> Optimizer:
    """The optimiser of a run that knows nothing yet.

    Args:
        problem: what is tuned.
        settings: of the tuner; those that concern the optimiser are looked at.

    Raises:
        ProblemError: they are not allowed.
    """
    try:
        choices: dict[str, Any] = {}
        if settings["initial_evaluations"]:
            choices["initial_evaluations"] = settings["initial_evaluations"]
        if settings["proximal"]:
            choices["proximal"] = "costs"
        return Optimizer(problem, preset=settings["preset"], seed=settings["seed"], **choices)
    except KeyError as error:
        raise ProblemError(f"the settings lack {error}") from None
    except TypeError as error:
        raise ProblemError(f"the settings are not as they should be: {error}") from None
