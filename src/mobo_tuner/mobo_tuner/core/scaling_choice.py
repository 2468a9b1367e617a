"""The choice of an output's prior mean and transform."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from mobo_tuner.core.arrays import FloatArray
from mobo_tuner.core.gaussian_process_settings import GaussianProcessSettings, MeanFunction
from mobo_tuner.core.output_scaling import (
    OutputScaling,
    has_heavy_tail,
    has_heavy_tail_about,
    is_constant,
)
from mobo_tuner.core.output_transform import Logarithm, SignedLogarithm, Transform

# What a transform must be better by, in the log density of left-out observations.
_CLEARLY_BETTER: Mapping[type, float] = {Logarithm: 3.0, SignedLogarithm: 1.0}
_LEAST_WIDTH = 1e-150
# The same of the reference point as prior mean, where observations are noisy.
_CLEARLY_BETTER_IN_NOISE = 3.0
_FUNCTION, _SCALED = "function", "scaled function"  # prior means that are given
_LEAST_SCALED = 5  # observations from which on a factor is learned
_HANDICAPS = {_SCALED: 1.0}  # of the log density, for what an offset does not have: a factor


@dataclass(frozen=True)
class ScalingChoice:
    """The prior means and transforms that the settings of a model allow, and what one is worth.

    Attributes:
        settings: Settings of the model.
        reference: Component of the reference point; None if there is none.
        mean: Function from inputs `(n, d)` to outputs `(n,)`; None if none is given.
        mean_gradient: Its gradient, from inputs `(m, d)` to `(m, d)`; None for central differences.
        limit: Limit to keep, about which a logarithm may be taken; None if there is none or another one.

    Raises:
        ValueError: If the reference is missing or not finite, or a gradient is given without a mean.
    """

    settings: GaussianProcessSettings
    reference: float | None
    mean: MeanFunction | None
    mean_gradient: MeanFunction | None
    limit: float | None = None

    def __post_init__(self) -> None:
        """Check what goes together."""
        if self.mean is None and self.mean_gradient is not None:
            raise ValueError("mean_gradient needs a mean function")
        if self.reference is not None:
            if not math.isfinite(self.reference):
                raise ValueError(f"reference must be finite, got {self.reference}")
            object.__setattr__(self, "reference", float(self.reference))
        elif self.mean is None and self.settings.mean == "reference":
            raise ValueError("reference must be given with mean='reference'")

    def allowed(self, x: FloatArray, y: FloatArray) -> list[tuple[str, OutputScaling]]:
        """Return the scalings of these outputs that the settings allow, by name; at least one."""
        settings, reference = self.settings, self.reference
        given: list[tuple[str, OutputScaling]] = []
        if self.mean is not None:
            kinds = ((_FUNCTION, False), (_SCALED, True))
            for name, scaled in kinds if len(y) >= _LEAST_SCALED else kinds[:1]:
                scaling = OutputScaling.of(
                    x, y, mean=self.mean, mean_gradient=self.mean_gradient, scaled=scaled
                )
                given.append((name, scaling))
            if given[0][1].explains(x, y):
                return given[:1]
        offsets: dict[str, float | None]
        if settings.mean == "auto":
            offsets = {"data": None}
            if reference is not None and not (len(y) > 1 and is_constant(y)):
                offsets["reference"] = reference
        elif isinstance(settings.mean, str):
            offsets = {settings.mean: None if settings.mean == "data" else reference}
        else:
            offsets = {"constant": float(settings.mean)}
        plain = [(name, OutputScaling.of(x, y, offset=offset)) for name, offset in offsets.items()]
        transform = self._transform(y)
        if transform is None:
            return given + plain
        suffix = "signed log" if isinstance(transform, SignedLogarithm) else "log"
        transformed = [
            (f"{name} {suffix}", OutputScaling.of(x, y, offset=at, transform=transform))
            for name, offset in offsets.items()
            if offset is None or offset > 0.0 or isinstance(transform, SignedLogarithm)
            for at in (None if offset is None else float(transform.apply(np.array([offset]))[0]),)
        ]
        never_plain = transformed and settings.transform == "log"
        return given + (transformed if never_plain else plain + transformed)

    def _transform(self, y: FloatArray) -> Transform | None:
        """Return the transform that may suit the outputs; None for none."""
        chosen = self.settings.transform
        if chosen == "auto" and self.limit is not None:
            width = float(np.median(np.abs(y - self.limit)))
            heavy = width > _LEAST_WIDTH and has_heavy_tail_about(y, self.limit)
            return SignedLogarithm(self.limit, width) if heavy else None
        if chosen == "none" or not (y > 0.0).all():
            return None
        if chosen == "auto" and not has_heavy_tail(y):
            return None
        return Logarithm(float(np.log(y.min())))

    @staticmethod
    def score(name: str, scaling: OutputScaling, log_density: float, noisy: bool) -> float:
        """Return what a scaling is worth; the highest one is chosen.

        Around the reference point, which is far from most readings, the variance of the model is large,
        so that the luckiest readings are believed too readily: where there is noise, it must be clearly better.

        Args:
            name: Name of the scaling.
            scaling: Scaling.
            log_density: Log density of all observations, each predicted from all others.
            noisy: Whether the observations are noisy.
        """
        better = _CLEARLY_BETTER.get(type(scaling.transform), 0.0)
        lucky = _CLEARLY_BETTER_IN_NOISE * (noisy and name.startswith("reference"))
        return log_density - better - lucky - _HANDICAPS.get(name, 0.0)

    def restored(self, name: str, state: Mapping[str, Any]) -> OutputScaling:
        """Return the scaling of a name that `OutputScaling.get_state` came from.

        Raises:
            ValueError: If a number is out of range.
        """
        given = name in (_FUNCTION, _SCALED)
        return OutputScaling.from_state(
            state, self.mean if given else None, self.mean_gradient if given else None
        )
