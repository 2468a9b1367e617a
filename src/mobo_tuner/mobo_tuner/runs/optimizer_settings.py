"""The optimiser of a run, made from the settings that its journal records."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from mobo_tuner.core import Optimizer, Problem, ProblemError
from mobo_tuner.core.prior_mean import PriorModel
from mobo_tuner.core.settings import CHOICES, method_of
from mobo_tuner.runs.history import PRIOR

KEPT = ("preset", "seed", "model_input", *PRIOR, *CHOICES)
"""Settings of the tuner that a resumed run keeps."""


def kept_settings(settings: Mapping[str, Any]) -> dict[str, Any]:
    """Return those of a run's settings that a run which resumes it keeps."""
    none = dict.fromkeys(PRIOR, "")  # of a run from before there were prior models
    return none | {name: settings[name] for name in KEPT if name in settings}


def make_optimizer(
    problem: Problem, settings: Mapping[str, Any], prior: PriorModel | None = None
) -> Optimizer:
    """Return the optimiser of a run before its first evaluation.

    Args:
        problem: Problem that is tuned.
        settings: Settings of the tuner, as a journal records them.
        prior: The prior model that they name, see `load_prior_model`.

    Raises:
        ProblemError: If one is missing, not allowed or does not suit the problem.
    """
    method = method_of(settings).to_dict()
    if "seed" not in settings:
        raise ProblemError("the settings lack 'seed'")
    return Optimizer(problem, seed=settings["seed"], prior_means=prior, **method)
