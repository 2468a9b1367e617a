"""The choices for a Gaussian process."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from typing import Any, Self

import numpy as np

from mobo_tuner.core.arrays import FloatArray
from mobo_tuner.core.context_kernel import Contextual
from mobo_tuner.core.kernels import KERNELS, Kernel
from mobo_tuner.core.values import LARGEST
from mobo_tuner.errors import ParameterError
from mobo_tuner.parameter_spec import check_fields, parameter

MeanFunction = Callable[[FloatArray], FloatArray]


@dataclass(frozen=True)
class GaussianProcessSettings:
    """Choices for one `GaussianProcess`; given hyperparameters are held, the others are trained.

    The fields say what they mean; docs/parameters.md lists them.

    Raises:
        ParameterError: If a choice is not allowed, or two do not go together.
    """

    kernel: str = parameter("matern52_full", "Kernel of the models.", choices=KERNELS)
    mean: str | float = parameter(
        "auto",
        "Prior mean: the mean of the data, the reference point, whichever of the two predicts "
        "left-out evaluations better (`auto`), or a number in the output's unit.",
        choices=("auto", "data", "reference"),
        minimum=-LARGEST,
        maximum=LARGEST,
    )
    noise: str | float = parameter(
        "learned",
        "Standard deviation of one measurement in the output's unit, beside the one that comes "
        "with it.",
        choices=("learned",),
        minimum=0.0,
        maximum=LARGEST,
    )
    minimum_noise: float = parameter(
        1e-9,
        "Least noise variance, as a share of the variance of the output.",
        minimum=1e-14,
        maximum=1.0,
    )
    length_scales: float | tuple[float, ...] | None = parameter(
        None,
        "Held length-scales, one for all variables or one for each, where a variable spans 2; "
        "null trains them.",
        minimum=1e-6,
        maximum=1e6,
    )
    precision: tuple[float, ...] | None = parameter(
        None,
        "Held precision matrix of kernel rbf_full, row by row, where a variable spans 2; null "
        "trains it.",
        matrix=True,
    )
    variance: float | None = parameter(
        None,
        "Held signal variance in the output's unit squared; null trains it.",
        minimum=1e-300,
        maximum=1e76,
    )
    training: str = parameter(
        "lbfgs",
        "Training of the hyperparameters: a quasi-Newton method with restarts, or the paper's "
        "Adam with a fixed number of steps.",
        choices=("lbfgs", "adam"),
    )
    prior: str = parameter(
        "weak",
        "Priors of the hyperparameters; none maximises the likelihood alone.",
        choices=("weak", "none"),
    )
    restarts: int = parameter(
        1,
        "Random starts of a training with lbfgs, beside the last optimum.",
        minimum=0,
        maximum=100,
    )
    adam_rate: float = parameter(0.001, "Learning rate of adam.", minimum=1e-12, maximum=1.0)
    adam_steps: int = parameter(
        5000, "Steps of adam in the first training.", minimum=0, maximum=1_000_000
    )
    adam_retraining_steps: int = parameter(
        1000, "Steps of adam in every later training.", minimum=0, maximum=1_000_000
    )
    transform: str = parameter(
        "auto",
        "Model the logarithm of an output whose values are all positive: never, always, or "
        "(`auto`) where some are far larger than most and it predicts left-out evaluations clearly better; "
        "with `auto` also a signed logarithm about the limit of a diagnostic that has one.",
        choices=("none", "log", "auto"),
    )

    def __post_init__(self) -> None:
        """Check every choice, then those that depend on each other."""
        check_fields(self)
        KERNELS.find(self.kernel)
        if self.precision is not None:
            if self.length_scales is not None:
                raise ParameterError("precision and length_scales are given; one is allowed")
            if not _is_positive_definite(self.precision):
                raise ParameterError(
                    f"precision is {self.precision}; the rows of a symmetric positive definite "
                    "matrix are allowed"
                )

    def make_kernel(self, d: int, contexts: int = 0) -> Kernel:
        """Return the kernel for d inputs, of which nobody sets the last `contexts`."""
        kernel = KERNELS.find(self.kernel)
        return Contextual(kernel(d - contexts), contexts) if contexts else kernel(d)

    def held_shape(self, kernel: Kernel) -> FloatArray | None:
        """Return the shape parameters `(k,)` that are held; None if they are trained.

        The scales of inputs that nobody sets are not among them: they are always trained.

        Raises:
            ValueError: If the length-scales or the precision matrix do not suit the kernel.
        """
        kernel = kernel.settable if isinstance(kernel, Contextual) else kernel
        if self.precision is not None:
            size = math.isqrt(len(self.precision))
            if size != kernel.d:
                raise ValueError(
                    f"precision must be a {kernel.d} by {kernel.d} matrix for {kernel.d} inputs, "
                    f"got {size} rows"
                )
            return kernel.from_precision(np.reshape(self.precision, (size, size)))
        if self.length_scales is not None:
            return kernel.from_length_scales(np.ravel(np.asarray(self.length_scales)))
        return None

    def to_dict(self) -> dict[str, Any]:
        """Return the settings as plain data for JSON."""
        return asdict(self)

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> Self:
        """Return the settings that `to_dict` came from, also after a conversion to JSON and back."""
        return cls(**values)


def _is_positive_definite(entries: tuple[float, ...]) -> bool:
    """Return whether the entries of a matrix, row by row, make a positive definite one."""
    size = math.isqrt(len(entries))
    if size * size != len(entries):
        return False
    matrix = np.reshape(entries, (size, size))
    return bool(np.allclose(matrix, matrix.T) and np.linalg.eigvalsh(matrix)[0] > 0.0)
