"""The physics behind the machine, chosen by name: ``awa`` or ``toy``."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import ClassVar, Final

from awa_sim_node.machine.actuator import INSTANTANEOUS, ActuatorParameters
from awa_sim_node.machine.description import Diagnostic, MachineDescription, Variable
from awa_sim_node.machine.diagnostics import ShotNoise
from awa_sim_node.surrogate import metadata


class Model(ABC):
    """What the beam does at given actuator positions, and how the machine around it behaves.

    Attributes:
        description: Names, units and limits.
        actuators: How each variable moves.
        noise: The noise of each diagnostic in one shot, in mode ``nominal``.
    """

    description: ClassVar[MachineDescription]
    actuators: ClassVar[Mapping[str, ActuatorParameters]]
    noise: ClassVar[Mapping[str, ShotNoise]]

    @abstractmethod
    def true_values(self, positions: Mapping[str, float]) -> dict[str, float]:
        """Return the true value of every diagnostic at the given actuator positions."""


_SOLENOID = ActuatorParameters(slew_rate=8.0, time_constant=1.5, tolerance=0.1, readback_noise=0.05)
_PHASE = ActuatorParameters(slew_rate=7.0, time_constant=0.16, tolerance=0.05, readback_noise=0.02)
_GRADIENT = ActuatorParameters(
    slew_rate=1.0, time_constant=1.25, tolerance=0.05, readback_noise=0.01
)


class AwaModel(Model):
    """The AWA-like injector: the trained surrogate, with the delays and the noise of a real one.

    The delays and noises are assumptions of the size that operators report. Charge and coupler kick
    are properties of the machine here, not variables.
    """

    description = MachineDescription(
        name="awa",
        title="AWA-like photoinjector: gun, two solenoids, one linac cavity, screen at 3.1 m",
        variables=tuple(
            Variable(
                quantity.name,
                quantity.unit,
                quantity.machine_limits[0],
                quantity.machine_limits[1],
                0.5 * (quantity.machine_limits[0] + quantity.machine_limits[1]),
            )
            for quantity in metadata.SETTINGS
        ),
        diagnostics=(
            *(Diagnostic(quantity.name, quantity.unit) for quantity in metadata.OUTPUTS),
            Diagnostic("charge", "nC"),
        ),
        repetition_rate=1.0,
        shots=5,
    )
    actuators: ClassVar[Mapping[str, ActuatorParameters]] = {
        "K1": _SOLENOID,
        "K2": _SOLENOID,
        "phi1": _PHASE,
        "phi2": _PHASE,
        "G1": _GRADIENT,
        "G2": _GRADIENT,
    }
    noise: ClassVar[Mapping[str, ShotNoise]] = {
        "sigma_x": ShotNoise(0.02, 0.05),
        "sigma_y": ShotNoise(0.02, 0.05),
        "sigma_z": ShotNoise(0.05),
        "eps_x": ShotNoise(0.07),
        "eps_y": ShotNoise(0.07),
        "eps_z": ShotNoise(0.12),
        "dE": ShotNoise(0.025),
        "energy": ShotNoise(0.001),
        "transmission": ShotNoise(0.003),
        "charge": ShotNoise(0.01),
    }

    def __init__(self) -> None:
        """Load the surrogate."""
        # Imported here because it brings torch, which a mere description must not wait for.
        from awa_sim_node.surrogate import Surrogate

        self._surrogate = Surrogate.load()

    def true_values(self, positions: Mapping[str, float]) -> dict[str, float]:
        """Return the surrogate's prediction, and the bunch charge behind the gun [nC]."""
        values = self._surrogate.predict(positions)
        return {**values, "charge": metadata.DEFAULT_CHARGE}


_TOY_LIMIT: Final = 2.0


class ToyModel(Model):
    """The paper's toy problem, [Roussel2021]_ Eq. (eqn:toy_problem).

    f1 = ||x - 1|| and f2 = ||x + 1||, both to be minimised, over x1 and x2 in [-2, 2], and g = x1
    for the constrained case. Its actuators are instantaneous.
    """

    description = MachineDescription(
        name="toy",
        title="toy problem: the distances to (1, 1) and to (-1, -1)",
        variables=tuple(Variable(name, "", -_TOY_LIMIT, _TOY_LIMIT, 0.0) for name in ("x1", "x2")),
        diagnostics=tuple(Diagnostic(name, "") for name in ("f1", "f2", "g")),
        repetition_rate=100.0,
        shots=1,
    )
    actuators: ClassVar[Mapping[str, ActuatorParameters]] = {
        "x1": INSTANTANEOUS,
        "x2": INSTANTANEOUS,
    }
    noise: ClassVar[Mapping[str, ShotNoise]] = {
        "f1": ShotNoise(floor=0.01),
        "f2": ShotNoise(floor=0.01),
        "g": ShotNoise(floor=0.01),
    }

    def true_values(self, positions: Mapping[str, float]) -> dict[str, float]:
        """Return f1, f2 and g."""
        x1, x2 = positions["x1"], positions["x2"]
        return {"f1": math.hypot(x1 - 1.0, x2 - 1.0), "f2": math.hypot(x1 + 1.0, x2 + 1.0), "g": x1}


_MODELS: Final[Mapping[str, type[Model]]] = {
    model.description.name: model for model in (AwaModel, ToyModel)
}
MODEL_NAMES: Final = tuple(_MODELS)


def describe(name: str) -> MachineDescription:
    """Return the description of the machine called ``name``, quickly: nothing is loaded.

    Raises:
        ValueError: If there is no such machine.
    """
    return _model_class(name).description


def create_model(name: str) -> Model:
    """Return the model called ``name``, ready for use.

    Raises:
        ValueError: If there is no such model.
    """
    return _model_class(name)()


def _model_class(name: str) -> type[Model]:
    try:
        return _MODELS[name]
    except KeyError:
        raise ValueError(f"machine = {name!r} must be one of {', '.join(MODEL_NAMES)}") from None
