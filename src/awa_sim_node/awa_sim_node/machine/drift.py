"""Slow drift of phases, gradients and charge: one Ornstein-Uhlenbeck process each."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from awa_sim_node.machine.kind import Kind
from awa_sim_node.machine.parameter import ParameterGroup, parameter


@dataclass(frozen=True)
class DriftParameters(ParameterGroup):
    """Parameters of the drift. It acts on the beam, but the readbacks do not show it."""

    charge: float = parameter(
        "standard deviation of the drift of the bunch charge, as a fraction", 0.0, 0.5
    )
    phase: float = parameter(
        "standard deviation of the drift of each cavity's phase [deg]", 0.0, 5.0
    )
    gradient: float = parameter(
        "standard deviation of the drift of each cavity's gradient, as a fraction", 0.0, 0.1
    )
    correlation_time: float = parameter(
        "time in which the correlation of a drift falls to 1/e [s]", 1.0, 1e6
    )


class Drift:
    """Independent Ornstein-Uhlenbeck processes that start at zero.

    dx = -x dt / tau + s sqrt(2 / tau) dW is advanced by its exact solution over a time t,
    x -> x exp(-t / tau) + s sqrt(1 - exp(-2 t / tau)) N(0, 1), so that its statistics do not depend
    on how often it is read (Gillespie, Phys. Rev. E 54, 2084 (1996)).
    """

    def __init__(
        self, parameters: DriftParameters, kinds: Mapping[str, Kind], rng: np.random.Generator
    ) -> None:
        """Start the drift of each input at time 0.

        Args:
            parameters: Parameters of the drift.
            kinds: Kind of each input.
            rng: Random number generator.
        """
        sizes = {
            Kind.CHARGE: parameters.charge,
            Kind.PHASE: parameters.phase,
            Kind.GRADIENT: parameters.gradient,
        }
        drifting = {name: sizes[kind] for name, kind in kinds.items() if sizes.get(kind, 0.0) > 0.0}
        self._names = tuple(drifting)
        self._stddevs = np.array(list(drifting.values()))
        self._tau = parameters.correlation_time
        self._values = np.zeros(len(drifting))
        self._rng = rng
        self._time = 0.0

    def at(self, time: float) -> dict[str, float]:
        """Return the drift of each input that drifts, in degrees or as a fraction.

        Args:
            time: Time since the machine was switched on [s]; must not be earlier than in the
                previous call.
        """
        elapsed = time - self._time
        if self._names and elapsed > 0.0:
            spread = self._stddevs * math.sqrt(-math.expm1(-2.0 * elapsed / self._tau))
            kept = math.exp(-elapsed / self._tau) * self._values
            self._values = kept + spread * self._rng.standard_normal(len(self._names))
            self._time = time
        return dict(zip(self._names, self._values.tolist(), strict=True))
