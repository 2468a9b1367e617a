"""What may be chosen about a Gaussian process."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any, Literal, get_args

import numpy as np

from mobo_tuner.core.kernels import KernelName
from mobo_tuner.core.linear_algebra import FloatArray

MeanFunction = Callable[[FloatArray], FloatArray]
MeanName = Literal["data", "reference", "auto"]
TrainingName = Literal["lbfgs", "adam"]
TransformName = Literal["none", "log", "auto"]
PriorName = Literal["weak", "none"]


@dataclass(frozen=True)
class GaussianProcessSettings:
    """Choices for one `GaussianProcess`; given hyperparameters are held, the others are trained.

    Attributes:
        kernel: covariance function, see `kernels`.
        mean: prior mean: of the data, at the reference point (`[Roussel2021]_`, text after Eq.
            (eqn:EHVI)), whichever of the two predicts left-out observations better ("auto"; the
            data mean where there is no reference), a constant in the output's units, or a function
            from inputs `(n, d)` to outputs `(n,)`.
        mean_gradient: gradient of a mean function, from inputs `(m, d)` to `(m, d)`; central
            differences without it.
        noise: "learned", or the standard deviation of one observation in the output's units.
            Standard deviations given with the observations are added in quadrature to either.
        minimum_noise: least noise variance, as a share of the variance of the outputs.
        length_scales: held length-scales in normalised inputs: one for all or one for each; None to
            train them.
        precision: held precision matrix, rows of `(d, d)`, for kernel "rbf_full"; None to train it.
        variance: held signal variance s^2 in the output's units squared; None to train it.
        training: "lbfgs" (analytic gradient, restarts) or "adam" with a fixed number of steps, as
            in the paper.
        prior: "weak" priors of the hyperparameters, or "none" for plain maximum likelihood.
        restarts: random starts beside the warm one, for "lbfgs".
        adam_rate: learning rate of "adam".
        adam_steps: number of steps of "adam" in the first training.
        adam_retraining_steps: number of steps in every later one.
        transform: "log" models the logarithm of an output as long as all its observations are
            positive; "auto" does so where left-out observations are clearly better predicted;
            "none" never.
    """

    kernel: KernelName = "matern52"
    mean: MeanName | float | MeanFunction = "data"
    mean_gradient: MeanFunction | None = None
    noise: Literal["learned"] | float = "learned"
    minimum_noise: float = 1e-9
    length_scales: float | tuple[float, ...] | None = None
    precision: tuple[tuple[float, ...], ...] | None = None
    variance: float | None = None
    training: TrainingName = "lbfgs"
    prior: PriorName = "weak"
    restarts: int = 1
    adam_rate: float = 0.001
    adam_steps: int = 5000
    adam_retraining_steps: int = 1000
    transform: TransformName = "none"

    def __post_init__(self) -> None:
        """Refuse what cannot be meant, with a ValueError that names the setting."""
        for name, choices in _CHOICES.items():
            if getattr(self, name) not in choices:
                raise ValueError(
                    f"{name} must be one of {', '.join(choices)}, got {getattr(self, name)!r}"
                )
        self._check_mean()
        if self.noise != "learned":
            _check_number("noise", self.noise, least=0.0)
        _check_number("minimum_noise", self.minimum_noise, least=1e-14, most=1.0)
        if self.variance is not None:
            _check_number("variance", self.variance, least=np.finfo(float).tiny)
        _check_number("adam_rate", self.adam_rate, least=np.finfo(float).tiny)
        for name in ("restarts", "adam_steps", "adam_retraining_steps"):
            value = getattr(self, name)
            if isinstance(value, bool) or not isinstance(value, int) or value < 0:
                raise ValueError(f"{name} must be a whole number of at least 0, got {value!r}")
        self._check_shape()

    def _check_mean(self) -> None:
        if callable(self.mean):
            if self.transform != "none":
                raise ValueError(
                    f"transform must be 'none' with a mean function, got {self.transform!r}"
                )
            return
        if self.mean_gradient is not None:
            raise ValueError("mean_gradient needs a mean function")
        if isinstance(self.mean, str):
            if self.mean not in get_args(MeanName):
                raise ValueError(
                    f"mean must be {', '.join(get_args(MeanName))}, a number or a function, "
                    f"got {self.mean!r}"
                )
        else:
            _check_number("mean", self.mean)

    def _check_shape(self) -> None:
        if self.precision is not None:
            if self.kernel != "rbf_full" or self.length_scales is not None:
                raise ValueError("precision needs kernel 'rbf_full' and excludes length_scales")
            try:
                matrix = np.array(self.precision, dtype=np.float64)
            except (TypeError, ValueError):
                matrix = np.empty(0)
            if not (
                matrix.ndim == 2
                and matrix.shape[0] == matrix.shape[1]
                and np.isfinite(matrix).all()
                and np.allclose(matrix, matrix.T)
                and np.linalg.eigvalsh(matrix)[0] > 0.0
            ):
                raise ValueError("precision must be a symmetric positive definite square matrix")
        if self.length_scales is not None:
            scales = (
                self.length_scales
                if isinstance(self.length_scales, Sequence)
                else (self.length_scales,)
            )
            for scale in scales:
                _check_number("length_scales", scale, least=1e-6, most=1e6)
            if self.kernel == "rbf_isotropic" and len(scales) != 1:
                raise ValueError(
                    f"length_scales of kernel 'rbf_isotropic' must be one number, got {len(scales)}"
                )

    @property
    def mean_function(self) -> MeanFunction | None:
        """The prior mean where it is a function."""
        return self.mean if callable(self.mean) else None

    def to_dict(self) -> dict[str, Any]:
        """The settings as plain data; a mean function appears as the word "function"."""
        values = asdict(
            replace(self, mean=0.0, mean_gradient=None) if callable(self.mean) else self
        )
        del values["mean_gradient"]
        if callable(self.mean):
            values["mean"] = "function"
        return values

    @classmethod
    def from_dict(
        cls,
        values: dict[str, Any],
        mean: MeanFunction | None = None,
        mean_gradient: MeanFunction | None = None,
    ) -> GaussianProcessSettings:
        """Inverse of `to_dict`, also through JSON; a mean function must be given again."""
        values = dict(values)
        if values.get("mean") == "function":
            if mean is None:
                raise ValueError("mean must be given: the settings were made with a mean function")
            values.update(mean=mean, mean_gradient=mean_gradient)
        for name in ("length_scales", "precision"):
            if isinstance(values.get(name), list):
                values[name] = tuple(tuple(v) if isinstance(v, list) else v for v in values[name])
        return cls(**values)


_CHOICES: dict[str, tuple[str, ...]] = {
    "kernel": get_args(KernelName),
    "training": get_args(TrainingName),
    "prior": get_args(PriorName),
    "transform": get_args(TransformName),
}


def _check_number(name: str, value: object, least: float = -np.inf, most: float = np.inf) -> None:
    if (
        isinstance(value, bool)
        or not isinstance(value, int | float | np.number)
        or not (np.isfinite(value) and least <= value <= most)
    ):
        bounds = f" of at least {least:g}" if np.isfinite(least) else ""
        bounds += f" and at most {most:g}" if np.isfinite(most) else ""
        raise ValueError(f"{name} must be a finite number{bounds}, got {value!r}")
