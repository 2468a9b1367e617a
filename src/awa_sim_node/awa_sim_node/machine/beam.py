"""One shot of the beam: its inputs, its true values, and the values that the instruments show."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from awa_sim_node.machine.beam_parameters import BeamParameters
from awa_sim_node.machine.diagnostics import ShotNoise
from awa_sim_node.machine.drift import Drift, DriftParameters
from awa_sim_node.machine.jitter import Jitter, JitterParameters
from awa_sim_node.machine.kind import Kind
from awa_sim_node.machine.models import Model

CHARGE = "charge"
TRANSMISSION = "transmission"


class ShotStatus(StrEnum):
    """Validity of a shot."""

    GOOD = "good"
    RETAKEN = "retaken"  # the charge was too far from its target
    DROPPED = "dropped"  # the instruments returned no data
    LOST = "lost"  # the transmission was too low


@dataclass(frozen=True)
class Shot:
    """One shot.

    Attributes:
        time: Simulated time since the machine was switched on [s].
        status: Validity of the shot.
        inputs: Every input of the model, including drift and jitter.
        truth: True value of every diagnostic, for tests only.
        measured: Measured value of every diagnostic; NaN if it was not measured.
    """

    time: float
    status: ShotStatus
    inputs: Mapping[str, float]
    truth: Mapping[str, float]
    measured: Mapping[str, float]


class Beam:
    """Source of shots: jitter and drift act on the model's inputs, the instruments add noise."""

    def __init__(
        self,
        model: Model,
        parameters: BeamParameters,
        jitter: JitterParameters,
        drift: DriftParameters,
        rng: np.random.Generator,
    ) -> None:
        """Prepare the beam.

        Args:
            model: Physics model of the machine.
            parameters: Parameters of the beam and its measurement.
            jitter: Parameters of the jitter from shot to shot.
            drift: Parameters of the drift.
            rng: Random number generator of the drift.
        """
        self._model = model
        self._parameters = parameters
        self._jitter = Jitter(jitter, model.kinds)
        self._drift = Drift(drift, model.kinds, rng)
        scale = parameters.noise_scale
        self._noise = {
            name: ShotNoise(scale * noise.fraction, scale * noise.floor)
            for name, noise in model.noise.items()
        }
        self._has_charge = CHARGE in model.kinds
        self._inputs: dict[str, float] = {}
        self._truth: dict[str, float] = {}

    @property
    def latest_inputs(self) -> Mapping[str, float]:
        """Inputs of the model in the latest shot; empty before the first."""
        return self._inputs

    def shot(self, time: float, strengths: Mapping[str, float], rng: np.random.Generator) -> Shot:
        """Take a shot.

        Args:
            time: Time of the shot [s]; not earlier than that of the previous shot.
            strengths: Value of each actuator that the beam feels.
            rng: Random number generator of jitter and noise.
        """
        inputs = self._felt(time, strengths, rng)
        if inputs != self._inputs:
            self._inputs, self._truth = inputs, self._model.true_values(inputs)
        truth = self._truth
        measured = {name: self._noise[name].shot(value, rng) for name, value in truth.items()}
        # Always drawn, so that the random numbers of later shots do not depend on this one's status.
        chances = rng.random(1 + len(self._model.images))
        status = self._status(measured, float(chances[0]))
        missing: set[str] = set()
        if status is ShotStatus.DROPPED:
            missing.update(measured)
        elif status is ShotStatus.LOST:
            missing.update(set(measured) - {CHARGE, TRANSMISSION})
        for image, chance in zip(self._model.images, chances[1:], strict=True):
            if chance < self._parameters.invalid_image:
                missing.update(image)
        measured |= dict.fromkeys(sorted(missing), math.nan)
        return Shot(time, status, inputs, truth, measured)

    def _felt(
        self, time: float, strengths: Mapping[str, float], rng: np.random.Generator
    ) -> dict[str, float]:
        """Return the model's inputs, clipped to the ranges of the model."""
        drift, jitter = self._drift.at(time), self._jitter.draw(rng)
        inputs = dict(strengths)
        if self._has_charge:
            inputs[CHARGE] = self._parameters.charge
            inputs["coupler_kick"] = self._parameters.coupler_kick
        for name, kind in self._model.kinds.items():
            if kind is Kind.PHASE:
                inputs[name] += drift.get(name, 0.0) + jitter.get(name, 0.0)
            elif kind in (Kind.GRADIENT, Kind.CHARGE):
                inputs[name] *= (1.0 + drift.get(name, 0.0)) * (1.0 + jitter.get(name, 0.0))
        for name, (low, high) in self._model.ranges.items():
            inputs[name] = min(max(inputs[name], low), high)
        return inputs

    def _status(self, measured: Mapping[str, float], chance: float) -> ShotStatus:
        parameters = self._parameters
        if chance < parameters.dropout:
            return ShotStatus.DROPPED
        if self._has_charge and parameters.charge_window > 0.0:
            off = abs(measured[CHARGE] / parameters.charge - 1.0)
            if off > parameters.charge_window:
                return ShotStatus.RETAKEN
        if TRANSMISSION in measured and measured[TRANSMISSION] < parameters.loss_limit:
            return ShotStatus.LOST
        return ShotStatus.GOOD
