"""The method of a run: every choice of the optimiser by name, and two presets that make them all."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields
from typing import Any

import numpy as np

from mobo_tuner.core.acquisition import ACQUISITION_FUNCTIONS
from mobo_tuner.core.acquisition_optimizer import MAXIMIZERS, Maximizer, make_maximizer
from mobo_tuner.core.arrays import FloatArray
from mobo_tuner.core.gaussian_process_settings import GaussianProcessSettings
from mobo_tuner.core.initial_design import DESIGNS
from mobo_tuner.core.problem import LARGEST, Problem, ProblemError
from mobo_tuner.core.proximal import ProximalBiasing
from mobo_tuner.errors import ParameterError
from mobo_tuner.parameter_spec import parameter, unknown

COSTS = "costs"
SCHEDULE = "schedule"


@dataclass(frozen=True)
class OptimizerSettings(GaussianProcessSettings):
    """Every choice of the optimiser; those of its Gaussian processes are inherited.

    The fields say what they mean; docs/parameters.md lists them.

    Attributes:
        maximizer_settings: Settings of the maximiser, by name; its defaults fill what is not given.

    Raises:
        ParameterError: If a choice is not allowed, or two do not go together.
    """

    initial_evaluations: int = parameter(
        0,
        "Points of the initial design; 0 = the number of variables plus two, less with a prior mean that is a "
        "model, more if a reference is left out or with several fidelities.",
        minimum=0,
        maximum=10_000,
    )
    initial_design: str = parameter(
        "latin_hypercube", "How the points of the initial design are drawn.", choices=DESIGNS
    )
    acquisition: str = parameter(
        "ehvi",
        "Acquisition function; ei and ucb need a single objective or weights.",
        choices=ACQUISITION_FUNCTIONS,
    )
    beta: str | float = parameter(
        0.01,
        "Weight of the uncertainty in ucb_hvi and ucb; `schedule` lets it grow with the "
        "evaluations.",
        choices=(SCHEDULE,),
        minimum=0.0,
    )
    drift: str = parameter(
        "none",
        "Whether the machine changes with time, which is then an input of the models: never, by the "
        "evidence (`auto`), or yes (`on`). Front, hypervolume and suggestions are those of now, after a "
        "sudden change, too.",
        choices=("none", "auto", "on"),
    )
    drift_time: float = parameter(
        0.0,
        "Time in which a drifting machine changes noticeably [s], about which the models learn more; "
        "0 = that of a hundred evaluations.",
        minimum=0.0,
        maximum=1e9,
    )
    weights: tuple[float, ...] | None = parameter(
        None,
        "One weight for each objective, in the problem's order and the inverse of its unit: ei and "
        "ucb minimise the weighted sum of the minimised objectives.",
        minimum=0.0,
        maximum=LARGEST,
    )
    proximal: str | float | tuple[float, ...] | None = parameter(
        None,
        "Precision of proximal biasing, where a variable spans 2: one number for all variables, "
        "one for each, the full matrix row by row, or the variables' costs; null = off.",
        choices=(COSTS,),
        matrix=True,
    )
    exploration: float = parameter(
        0.02,
        "Chance that there is something as good as all that was found where the models, which may be "
        "certain and wrong, expect nothing: a point far from all others is measured where a suggestion "
        "promises less, and while the front does not move. 0 = never.",
        minimum=0.0,
        maximum=1.0,
    )
    trust_distance: float = parameter(
        0.0,
        "First distance, as a share of each variable's range, from what was measured and safe within which "
        "the next set-point must be: the first one is where the machine is, and the distance grows with each "
        "safe evaluation. 0 = anywhere, or 0.05 if a constraint must be `safe`.",
        minimum=0.0,
        maximum=1.0,
    )
    maximizer: str = parameter(
        "multi_start", "How the acquisition function is maximised.", choices=MAXIMIZERS
    )
    maximizer_settings: Mapping[str, Any] = field(default_factory=dict)
    suggestion_seconds: float | None = parameter(
        None,
        "Time budget of one suggestion [s]; null = as long as it takes, which is what makes a run "
        "reproducible.",
        minimum=1e-9,
        maximum=86_400.0,
    )
    refit_every: int = parameter(
        0,
        "Valid evaluations between two trainings of the hyperparameters; 0 = every one at first, "
        "then whenever there are 4 % more.",
        minimum=0,
        maximum=10_000,
    )

    def __post_init__(self) -> None:
        """Check every choice, and fill in the settings of the maximiser."""
        super().__post_init__()
        ACQUISITION_FUNCTIONS.find(self.acquisition)
        if not isinstance(self.maximizer_settings, Mapping):
            raise ParameterError(
                f"maximizer_settings is {self.maximizer_settings!r}; names and values are allowed"
            )
        maximizer = make_maximizer(self.maximizer, self.maximizer_settings)
        object.__setattr__(self, "maximizer_settings", asdict(maximizer))

    @property
    def gaussian_process(self) -> GaussianProcessSettings:
        """The choices for every Gaussian process."""
        names = [f.name for f in fields(GaussianProcessSettings)]
        return GaussianProcessSettings(**{name: getattr(self, name) for name in names})

    def make_maximizer(self) -> Maximizer:
        """Return the maximiser with its settings."""
        return make_maximizer(self.maximizer, self.maximizer_settings)

    def proximal_precision(self, problem: Problem) -> FloatArray | None:
        """Return Lambda of proximal biasing as a scalar `()`, `(d,)` or `(d, d)`; None if it is off.

        Raises:
            ProblemError: If it does not suit the variables.
        """
        if self.proximal is None:
            return None
        if isinstance(self.proximal, str):
            return np.array([v.cost for v in problem.variables])
        d = len(problem.variables)
        precision = np.array(self.proximal)
        if precision.shape not in ((), (d,), (d * d,)):
            raise ProblemError(
                f"proximal is {self.proximal!r}; '{COSTS}', one number, {d} or {d} by {d} are "
                f"allowed for {d} variables"
            )
        return precision.reshape(d, d) if precision.shape == (d * d,) and d > 1 else precision

    def check_problem(self, problem: Problem) -> None:
        """Check that the choices suit a problem.

        Raises:
            ProblemError: If a choice does not.
        """
        n = len(problem.objectives)
        single = ACQUISITION_FUNCTIONS.find(self.acquisition).single_objective
        if single and n > 1 and self.weights is None:
            raise ProblemError(
                f"acquisition is '{self.acquisition}', which takes a single objective; with {n} "
                "objectives weights must be given"
            )
        if self.weights is not None and (
            not single or len(self.weights) != n or not any(self.weights)
        ):
            raise ProblemError(
                f"weights is {self.weights!r}; one for each of {n} objectives, not all 0, is "
                "allowed, with an acquisition function of a single objective"
            )
        d = len(problem.variables)
        try:
            self.held_shape(self.make_kernel(problem.one_hot.width if problem.one_hot else d))
        except ValueError as error:
            raise ProblemError(f"kernel is '{self.kernel}': {error}") from None
        precision = self.proximal_precision(problem)
        if precision is not None:
            try:
                ProximalBiasing(np.zeros(d), precision)
            except ValueError as error:
                raise ProblemError(f"proximal is {self.proximal!r}: {error}") from None


CHOICES = tuple(f.name for f in fields(OptimizerSettings))
"""Names of all choices."""

PRESETS: dict[str, OptimizerSettings] = {
    "default": OptimizerSettings(),
    # [Roussel2021]_, section subsec:convergence: 20 Latin-hypercube points, anisotropic RBF, prior mean at the
    # reference point (text after Eq. (3), eqn:EHVI), Adam with 5000 steps and then 1000 every 10 observations,
    # UCB-HVI with beta = 0.01, particle swarm of 64 individuals over 10 generations.
    "paper": OptimizerSettings(
        initial_evaluations=20,
        acquisition="ucb_hvi",
        exploration=0.0,
        maximizer="particle_swarm",
        refit_every=10,
        kernel="rbf",
        mean="reference",
        training="adam",
        prior="none",
        transform="none",
    ),
}


def make_settings(preset: str, overrides: Mapping[str, Any]) -> OptimizerSettings:
    """Return the settings of a preset, with single choices replaced.

    Args:
        preset: Name of the preset.
        overrides: Choices by name; of `maximizer_settings` some may be given.

    Raises:
        ProblemError: If the preset or a choice is unknown, or its value is not allowed.
    """
    if not isinstance(preset, str) or preset not in PRESETS:
        raise ProblemError(f"preset is {preset!r}; allowed are {', '.join(PRESETS)}")
    for name in overrides:
        if name not in CHOICES:
            raise ProblemError(unknown(name, CHOICES, "the choices of the optimiser"))
    base = PRESETS[preset]
    choices = {name: getattr(base, name) for name in CHOICES} | dict(overrides)
    if "maximizer" in overrides and "maximizer_settings" not in overrides:
        choices["maximizer_settings"] = {}
    try:
        return OptimizerSettings(**choices)
    except ParameterError as error:
        raise ProblemError(str(error)) from None


def method_of(values: Mapping[str, Any]) -> OptimizerSettings:
    """Return the choices that stand among other values, such as the settings that a journal records.

    Args:
        values: Preset and choices by name; a choice that is missing is the preset's.

    Raises:
        ProblemError: If the preset is missing, or a choice is not allowed.
    """
    if "preset" not in values:
        raise ProblemError("the settings lack 'preset'")
    return make_settings(values["preset"], {n: values[n] for n in CHOICES if n in values})
