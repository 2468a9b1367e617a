"""One shot of the beam: what it felt, what it truly was, and what the instruments made of it."""

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
    """What became of a shot."""

    GOOD = "good"
    RETAKEN = "retaken"  # the charge was too far from its target
    DROPPED = "dropped"  # the instruments gave nothing
    LOST = "lost"  # too little of the beam arrived


@dataclass(frozen=True)
class Shot:
    """One shot.

    Attributes:
        time: When, in simulated time since the machine was switched on [s].
        status: What became of it.
        inputs: What the beam felt: every input of the model, drift and jitter included.
        truth: The true value of every diagnostic, for tests only.
        measured: What was measured of every diagnostic; NaN where nothing was.
    """

    time: float
    status: ShotStatus
    inputs: Mapping[str, float]
    truth: Mapping[str, float]
    measured: Mapping[str, float]


class Beam:
    """Makes shots: jitter and drift act through the model, and the instruments add their noise."""

    def __init__(
        self,
        model: Model,
        parameters: BeamParameters,
        jitter: JitterParameters,
        drift: DriftParameters,
        rng: np.random.Generator,
    ) -> None:
        """Prepare the beam; ``rng`` is the source of the drift."""
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
        """What the beam felt in the latest shot; empty before the first."""
        return self._inputs

    def shot(self, time: float, strengths: Mapping[str, float], rng: np.random.Generator) -> Shot:
        """Take a shot.

        Args:
            time: Of the shot [s]; not earlier than that of the one before.
            strengths: What the actuators are set to, as the beam feels it.
            rng: Source of jitter and noise.
        """
        inputs = self._felt(time, strengths, rng)
        if inputs != self._inputs:
            self._inputs, self._truth = inputs, self._model.true_values(inputs)
        truth = self._truth
        measured = {name: self._noise[name].shot(value, rng) for name, value in truth.items()}
        # Drawn whether needed or not, so that one shot's fate does not shift the chance of the next.
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
        """Return what the beam feels, within the ranges in which the model answers."""
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
