"""Jitter from shot to shot: the laser's energy and timing, and the fields of the cavities."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from awa_sim_node.machine.kind import Kind
from awa_sim_node.machine.parameter import SOURCED, ParameterGroup, parameter


@dataclass(frozen=True)
class JitterParameters(ParameterGroup):
    """Parameters of the jitter. It acts on the beam, but the readbacks do not show it."""

    charge: float = parameter(
        "standard deviation of the bunch charge, as a fraction", 0.0, 0.5, SOURCED
    )
    timing: float = parameter(
        "standard deviation of the laser timing, common to all phases [deg]", 0.0, 5.0, SOURCED
    )
    phase: float = parameter(
        "standard deviation of each cavity's phase, without that of the laser [deg]", 0.0, 5.0
    )
    gradient: float = parameter(
        "standard deviation of each cavity's gradient, as a fraction", 0.0, 0.1
    )


class Jitter:
    """Random deviations of the model's inputs in one shot."""

    def __init__(self, parameters: JitterParameters, kinds: Mapping[str, Kind]) -> None:
        """Prepare the jitter.

        Args:
            parameters: Parameters of the jitter.
            kinds: Kind of each input.
        """
        self._timing = parameters.timing
        sizes = {
            Kind.CHARGE: parameters.charge,
            Kind.PHASE: parameters.phase,
            Kind.GRADIENT: parameters.gradient,
        }
        self._sizes = {name: sizes[kind] for name, kind in kinds.items() if kind in sizes}
        self._phases = [name for name, kind in kinds.items() if kind is Kind.PHASE]

    def draw(self, rng: np.random.Generator) -> dict[str, float]:
        """Return the deviation of each input that jitters, in degrees or as a fraction."""
        numbers = rng.standard_normal(1 + len(self._sizes))
        deviations = {
            name: size * float(number)
            for (name, size), number in zip(self._sizes.items(), numbers[1:], strict=True)
        }
        for name in self._phases:
            deviations[name] += self._timing * float(numbers[0])
        return deviations
