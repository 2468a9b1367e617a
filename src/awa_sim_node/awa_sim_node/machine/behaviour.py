"""Behaviour of a machine: all its parameters, and three modes with their default values."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from enum import StrEnum
from typing import Final

from awa_sim_node.machine.actuator import ActuatorParameters
from awa_sim_node.machine.beam_parameters import BeamParameters
from awa_sim_node.machine.drift import DriftParameters
from awa_sim_node.machine.interlock import InterlockParameters
from awa_sim_node.machine.jitter import JitterParameters
from awa_sim_node.machine.parameter import ParameterInfo, info_of
from awa_sim_node.machine.trips import TripParameters


class Mode(StrEnum):
    """Set of default values for the behaviour parameters.

    ``ideal`` has no randomness and no faults, but realistic motion; ``nominal`` is a good day;
    ``rough`` is a bad day.
    """

    IDEAL = "ideal"
    NOMINAL = "nominal"
    ROUGH = "rough"


@dataclass(frozen=True)
class Behaviour:
    """All parameters of a machine's behaviour, in groups.

    The full name of a parameter is its group and its name, e.g. ``drift_phase``.
    """

    beam: BeamParameters
    solenoid: ActuatorParameters
    phase: ActuatorParameters
    gradient: ActuatorParameters
    jitter: JitterParameters
    drift: DriftParameters
    trip: TripParameters
    interlock: InterlockParameters

    @property
    def values(self) -> dict[str, float]:
        """Value of every parameter by its full name, in order."""
        return {
            f"{group.name}_{item.name}": getattr(getattr(self, group.name), item.name)
            for group in fields(self)
            for item in fields(getattr(self, group.name))
        }

    def changed(self, values: Mapping[str, float]) -> Behaviour:
        """Return a behaviour with some parameters changed.

        Args:
            values: New values by full name.

        Raises:
            ValueError: If a parameter is unknown or not allowed.
        """
        infos = self.infos
        for name, value in values.items():
            if name not in infos:
                raise ValueError(f"parameter {name!r} must be one of {', '.join(infos)}")
            infos[name].check(name, value)
        groups = {}
        for group in fields(self):
            own = getattr(self, group.name)
            changes = {
                item.name: values[f"{group.name}_{item.name}"]
                for item in fields(own)
                if f"{group.name}_{item.name}" in values
            }
            try:
                groups[group.name] = replace(own, **changes)
            except ValueError as error:  # two parameters contradict each other
                raise ValueError(f"{group.name}_{error}") from None
        return replace(self, **groups)

    @property
    def infos(self) -> dict[str, ParameterInfo]:
        """Meaning, range and source of every parameter by its full name."""
        return {
            f"{group.name}_{item.name}": info_of(item)
            for group in fields(self)
            for item in fields(getattr(self, group.name))
        }


_IDEAL: Final = Behaviour(
    beam=BeamParameters(
        repetition_rate=1.0,
        shots=5,
        charge=40.0,
        coupler_kick=1.2,
        noise_scale=0.0,
        dropout=0.0,
        invalid_image=0.0,
        charge_window=0.0,
        retakes=0.0,
        loss_limit=0.0,
    ),
    solenoid=ActuatorParameters(
        slew_rate=8.0, time_constant=1.5, tolerance=0.1, readback_noise=0.0, hysteresis=0.0
    ),
    phase=ActuatorParameters(
        slew_rate=7.0, time_constant=0.16, tolerance=0.05, readback_noise=0.0, hysteresis=0.0
    ),
    gradient=ActuatorParameters(
        slew_rate=1.0, time_constant=1.25, tolerance=0.05, readback_noise=0.0, hysteresis=0.0
    ),
    jitter=JitterParameters(charge=0.0, timing=0.0, phase=0.0, gradient=0.0),
    drift=DriftParameters(charge=0.0, phase=0.0, gradient=0.0, correlation_time=3600.0),
    trip=TripParameters(
        rate=0.0,
        threshold=72.0,
        steepness=0.75,
        recovery_min=30.0,
        recovery_max=60.0,
        patience=600.0,
    ),
    interlock=InterlockParameters(shots=0),
)
_NOMINAL: Final = _IDEAL.changed(
    {
        "beam_noise_scale": 1.0,
        "beam_dropout": 0.005,
        "beam_invalid_image": 0.01,
        "beam_charge_window": 0.1,
        "beam_retakes": 4.0,
        "beam_loss_limit": 0.9,
        "solenoid_readback_noise": 0.05,
        "phase_readback_noise": 0.02,
        "gradient_readback_noise": 0.01,
        "jitter_charge": 0.02,
        "jitter_timing": 0.37,
        "jitter_phase": 0.2,
        "jitter_gradient": 0.002,
        "drift_charge": 0.03,
        "drift_phase": 0.2,
        "drift_gradient": 0.002,
        "trip_rate": 1.0,
        "interlock_shots": 100,
    }
)
_ROUGH: Final = _NOMINAL.changed(
    {
        "beam_noise_scale": 1.5,
        "beam_dropout": 0.01,
        "beam_invalid_image": 0.03,
        "solenoid_slew_rate": 5.0,
        "solenoid_time_constant": 2.0,
        "solenoid_readback_noise": 0.1,
        "solenoid_hysteresis": 0.5,
        "phase_slew_rate": 5.0,
        "gradient_time_constant": 1.5,
        "jitter_charge": 0.1,
        "jitter_phase": 0.3,
        "drift_charge": 0.05,
        "drift_phase": 0.5,
        "drift_gradient": 0.003,
        "drift_correlation_time": 1800.0,
        "trip_rate": 3.0,
        "trip_patience": 0.0,
        "interlock_shots": 20,
    }
)

AWA: Final[Mapping[Mode, Behaviour]] = {
    Mode.IDEAL: _IDEAL,
    Mode.NOMINAL: _NOMINAL,
    Mode.ROUGH: _ROUGH,
}
"""The modes of the AWA injector."""

_TOY: Final = _IDEAL.changed({"beam_repetition_rate": 100.0, "beam_shots": 1})
TOY: Final[Mapping[Mode, Behaviour]] = {
    Mode.IDEAL: _TOY,
    Mode.NOMINAL: _TOY.changed({"beam_noise_scale": 1.0}),
    Mode.ROUGH: _TOY.changed({"beam_noise_scale": 3.0, "beam_dropout": 0.01}),
}
"""The modes of the toy problem, which has no beam loss and no gun trips."""
