"""How a run chooses its candidates: every choice by name, and two recipes that make them all."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, fields, replace
from typing import Any, Literal, get_args

import numpy as np

from mobo_tuner.core.gaussian_process_settings import (
    GaussianProcessSettings,
    MeanName,
    TrainingName,
    TransformName,
)
from mobo_tuner.core.initial_design import Design
from mobo_tuner.core.kernels import KernelName
from mobo_tuner.core.problem import ProblemError

AcquisitionName = Literal["ehvi", "ucb_hvi", "ei", "ucb"]
MaximizerName = Literal["multi_start", "particle_swarm"]
PresetName = Literal["default", "paper"]


@dataclass(frozen=True)
class OptimizerSettings:
    """Every choice of the optimiser.

    Attributes:
        initial_evaluations: points of the initial design; 0 = twice the number of variables plus two.
        initial_design: how they are drawn.
        acquisition: "ehvi" or "ucb_hvi"; "ei" or "ucb" where there is a single objective or `weights`.
        beta: weight of the uncertainty in "ucb_hvi" and "ucb".
        weights: one for each objective: optimise their weighted sum instead of the hypervolume.
        proximal: precision matrix of proximal biasing in normalised space: one number for all variables, one
            for each, or the full matrix; "costs" takes the variables' costs; None switches it off.
        maximizer: how the acquisition function is maximised.
        suggestion_seconds: time budget of one suggestion [s]; None = as long as it takes, which is
            what makes a run reproducible.
        refit_every: valid evaluations between two trainings of the hyperparameters; 0 = every one at
            first, then whenever there are 4 % more.
        kernel, mean, noise, training, transform, length_scales, variance: of every Gaussian process,
            see `GaussianProcessSettings`.
    """

    initial_evaluations: int = 0
    initial_design: Design = "latin_hypercube"
    acquisition: AcquisitionName = "ehvi"
    beta: float = 0.01
    weights: tuple[float, ...] | None = None
    proximal: Any = None
    maximizer: MaximizerName = "multi_start"
    suggestion_seconds: float | None = None
    refit_every: int = 0
    kernel: KernelName = "matern52"
    mean: MeanName | float = "auto"
    noise: Literal["learned"] | float = "learned"
    training: TrainingName = "lbfgs"
    transform: TransformName = "none"
    length_scales: float | tuple[float, ...] | None = None
    variance: float | None = None

    def __post_init__(self) -> None:
        """Refuse what cannot be meant.

        Raises:
            ProblemError: a choice is unknown or out of range.
        """
        for name, choices in _CHOICES.items():
            if getattr(self, name) not in choices:
                raise ProblemError(
                    f"{name} is {getattr(self, name)!r}; allowed are {', '.join(choices)}"
                )
        _check_count("initial_evaluations", self.initial_evaluations, 0)
        _check_count("refit_every", self.refit_every, 0)
        if not (isinstance(self.beta, int | float) and 0.0 <= self.beta < np.inf):
            raise ProblemError(f"beta is {self.beta!r}; a number of at least 0 is allowed")
        if self.suggestion_seconds is not None and not self.suggestion_seconds > 0.0:
            raise ProblemError(
                f"suggestion_seconds is {self.suggestion_seconds!r}; a number above 0 is allowed"
            )
        self.gaussian_process  # noqa: B018 - its own checks

    def to_dict(self) -> dict[str, Any]:
        """The settings as plain data for JSON."""
        values = asdict(self)
        if isinstance(self.proximal, np.ndarray):
            values["proximal"] = self.proximal.tolist()
        return values

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> OptimizerSettings:
        """Inverse of `to_dict`, also after a passage through JSON."""
        tuples = {n: tuple(v) for n, v in values.items() if isinstance(v, list) and n != "proximal"}
        return cls(**{**values, **tuples})

    @property
    def gaussian_process(self) -> GaussianProcessSettings:
        """The part that concerns every Gaussian process.

        Raises:
            ProblemError: a choice is not allowed.
        """
        try:
            return GaussianProcessSettings(
                kernel=self.kernel,
                mean=self.mean,
                noise=self.noise,
                training=self.training,
                transform=self.transform,
                length_scales=self.length_scales,
                variance=self.variance,
                prior="none" if self.training == "adam" else "weak",
            )
        except ValueError as error:
            raise ProblemError(str(error)) from None


def _check_count(name: str, value: object, least: int) -> None:
    if isinstance(value, bool) or not isinstance(value, int) or value < least:
        raise ProblemError(f"{name} is {value!r}; a whole number of at least {least} is allowed")


_CHOICES: dict[str, Sequence[str]] = {
    "acquisition": get_args(AcquisitionName),
    "initial_design": get_args(Design),
    "maximizer": get_args(MaximizerName),
}

PRESETS: dict[str, OptimizerSettings] = {
    "default": OptimizerSettings(),
    # [Roussel2021]_, section subsec:convergence: 20 Latin-hypercube points, anisotropic RBF, prior mean at the
    # reference point (text after Eq. (eqn:EHVI)), Adam with 5000 steps and then 1000 every 10 observations,
    # UCB-HVI with beta = 0.01, particle swarm of 64 individuals over 10 generations.
    "paper": OptimizerSettings(
        initial_evaluations=20,
        acquisition="ucb_hvi",
        maximizer="particle_swarm",
        refit_every=10,
        kernel="rbf",
        mean="reference",
        training="adam",
    ),
}


def make_settings(preset: str, overrides: dict[str, Any]) -> OptimizerSettings:
    """The settings of a preset, with single choices replaced.

    Raises:
        ProblemError: the preset or a choice is unknown, or its value is not allowed.
    """
    if preset not in PRESETS:
        raise ProblemError(f"preset is {preset!r}; allowed are {', '.join(PRESETS)}")
    names = [field.name for field in fields(OptimizerSettings)]
    for name in overrides:
        if name not in names:
            raise ProblemError(
                f"'{name}' is no choice of the optimiser; allowed are {', '.join(names)}"
            )
    return replace(PRESETS[preset], **overrides)
