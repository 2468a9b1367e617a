"""The physics models of the machine, chosen by name: ``awa`` or ``toy``."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import ClassVar, Final

from awa_sim_node.machine.behaviour import AWA, TOY, Behaviour, Mode
from awa_sim_node.machine.description import Diagnostic, ModelDescription, Variable
from awa_sim_node.machine.diagnostics import ShotNoise
from awa_sim_node.machine.kind import Kind
from awa_sim_node.surrogate import metadata


class Model(ABC):
    """Physics of the beam for given inputs, and the properties of the machine around it.

    Attributes:
        description: Names, units and limits.
        kinds: Kind of each input: every variable, and all other inputs of the beam.
        ranges: Valid range of each input; inputs that are not named have no bounds.
        noise: Noise of each diagnostic in one shot on a good day.
        images: Groups of diagnostics that are lost together if their image cannot be evaluated.
        gun: Variable that determines the trip rate; empty if nothing trips.
        modes: Behaviour of the machine in each mode.
    """

    description: ClassVar[ModelDescription]
    kinds: ClassVar[Mapping[str, Kind]]
    ranges: ClassVar[Mapping[str, tuple[float, float]]] = {}
    noise: ClassVar[Mapping[str, ShotNoise]]
    images: ClassVar[tuple[tuple[str, ...], ...]] = ()
    gun: ClassVar[str] = ""
    modes: ClassVar[Mapping[Mode, Behaviour]]

    @abstractmethod
    def true_values(self, inputs: Mapping[str, float]) -> dict[str, float]:
        """Return the true value of every diagnostic, in the description's order."""

    def spread(self, inputs: Mapping[str, float]) -> dict[str, float]:
        """Return the model's uncertainty of each diagnostic; empty if the model is exact."""
        del inputs
        return {}


class AwaModel(Model):
    """The AWA-like injector: the trained surrogate with the noise of real instruments.

    The noise levels are those that operators report. Charge and coupler kick are properties of the
    machine, not variables.
    """

    description = ModelDescription(
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
    )
    kinds: ClassVar[Mapping[str, Kind]] = {
        "K1": Kind.SOLENOID,
        "K2": Kind.SOLENOID,
        "phi1": Kind.PHASE,
        "phi2": Kind.PHASE,
        "G1": Kind.GRADIENT,
        "G2": Kind.GRADIENT,
        "charge": Kind.CHARGE,
        "coupler_kick": Kind.FIXED,
    }
    ranges: ClassVar[Mapping[str, tuple[float, float]]] = {
        quantity.name: quantity.training_range for quantity in metadata.INPUTS
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
    images: ClassVar[tuple[tuple[str, ...], ...]] = (
        ("sigma_x", "sigma_y", "eps_x", "eps_y"),  # the screen
        ("sigma_z", "eps_z"),  # the streak of the bunch
        ("dE", "energy"),  # the spectrometer
    )
    gun: ClassVar[str] = "G1"
    modes: ClassVar[Mapping[Mode, Behaviour]] = AWA

    def __init__(self) -> None:
        """Load the surrogate."""
        # Imported here because it imports torch, which a description does not need.
        from awa_sim_node.surrogate import Surrogate

        self._surrogate = Surrogate.load()

    def true_values(self, inputs: Mapping[str, float]) -> dict[str, float]:
        """Return the surrogate's prediction, and the bunch charge behind the gun [nC]."""
        values = self._surrogate.predict(inputs)
        return {**values, "charge": inputs.get("charge", metadata.DEFAULT_CHARGE)}

    def spread(self, inputs: Mapping[str, float]) -> dict[str, float]:
        """Return the standard deviation between the members of the surrogate's ensemble."""
        return self._surrogate.spread(inputs)


_TOY_LIMIT: Final = 2.0


class ToyModel(Model):
    """The paper's toy problem, Eq. (5) of Roussel et al. 2021 (label ``eqn:toy_problem``).

    f1 = ||x - 1|| and f2 = ||x + 1||, both to be minimised, over x1 and x2 in [-2, 2], and g = x1
    for the constrained case. Its actuators are instantaneous.
    """

    description = ModelDescription(
        name="toy",
        title="toy problem: the distances to (1, 1) and to (-1, -1)",
        variables=tuple(Variable(name, "", -_TOY_LIMIT, _TOY_LIMIT, 0.0) for name in ("x1", "x2")),
        diagnostics=tuple(Diagnostic(name, "") for name in ("f1", "f2", "g")),
    )
    kinds: ClassVar[Mapping[str, Kind]] = {"x1": Kind.EXACT, "x2": Kind.EXACT}
    noise: ClassVar[Mapping[str, ShotNoise]] = {
        "f1": ShotNoise(floor=0.01),
        "f2": ShotNoise(floor=0.01),
        "g": ShotNoise(floor=0.01),
    }
    modes: ClassVar[Mapping[Mode, Behaviour]] = TOY

    def true_values(self, inputs: Mapping[str, float]) -> dict[str, float]:
        """Return f1, f2 and g."""
        x1, x2 = inputs["x1"], inputs["x2"]
        return {"f1": math.hypot(x1 - 1.0, x2 - 1.0), "f2": math.hypot(x1 + 1.0, x2 + 1.0), "g": x1}


_MODELS: Final[Mapping[str, type[Model]]] = {
    model.description.name: model for model in (AwaModel, ToyModel)
}
MODEL_NAMES: Final = tuple(_MODELS)


def describe(name: str) -> ModelDescription:
    """Return the description of the machine called ``name``, without loading its model.

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


def behaviour_of(name: str, mode: Mode) -> Behaviour:
    """Return the behaviour of the machine called ``name`` in ``mode``, without loading its model.

    Raises:
        ValueError: If there is no such machine.
    """
    return _model_class(name).modes[mode]


def kinds_of(name: str) -> Mapping[str, Kind]:
    """Return what each input of the machine called ``name`` is, quickly: nothing is loaded.

    Raises:
        ValueError: If there is no such machine.
    """
    return _model_class(name).kinds


def _model_class(name: str) -> type[Model]:
    try:
        return _MODELS[name]
    except KeyError:
        raise ValueError(f"machine = {name!r} must be one of {', '.join(MODEL_NAMES)}") from None
