"""All actuators of a machine together."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from awa_sim_node.machine.actuator import INSTANTANEOUS, Actuator
from awa_sim_node.machine.behaviour import Behaviour
from awa_sim_node.machine.description import MachineDescription, Variable
from awa_sim_node.machine.kind import Kind


class Actuators:
    """The actuators by the names of the variables, in the machine's order."""

    def __init__(
        self, description: MachineDescription, kinds: Mapping[str, Kind], behaviour: Behaviour
    ) -> None:
        """Create the actuators, at rest at the initial set-point."""
        parameters = {
            Kind.SOLENOID: behaviour.solenoid,
            Kind.PHASE: behaviour.phase,
            Kind.GRADIENT: behaviour.gradient,
            Kind.EXACT: INSTANTANEOUS,
        }
        self._description = description
        self._actuators = {
            variable.name: Actuator(parameters[kinds[variable.name]], variable.initial)
            for variable in description.variables
        }

    def __getitem__(self, name: str) -> Actuator:
        """Return the actuator of a variable."""
        return self._actuators[name]

    @property
    def targets(self) -> dict[str, float]:
        """Where each was told to be."""
        return {name: actuator.target for name, actuator in self._actuators.items()}

    @property
    def strengths(self) -> dict[str, float]:
        """What the beam feels of each."""
        return {name: actuator.strength for name, actuator in self._actuators.items()}

    @property
    def settled(self) -> dict[str, bool]:
        """Whether each rests on its target."""
        return {name: actuator.settled for name, actuator in self._actuators.items()}

    @property
    def all_settled(self) -> bool:
        """Whether all rest on their targets."""
        return all(actuator.settled for actuator in self._actuators.values())

    @property
    def ramping(self) -> bool:
        """Whether the reference of any is still on its way."""
        return any(actuator.ramping for actuator in self._actuators.values())

    @property
    def time_to_ramped(self) -> float:
        """Time until none of them ramps [s]."""
        return max(actuator.time_to_ramped for actuator in self._actuators.values())

    @property
    def time_to_settled(self) -> float:
        """Time until all are settled [s]."""
        return max(actuator.time_to_settled for actuator in self._actuators.values())

    @property
    def time_to_next_event(self) -> float:
        """Time until one of them has ramped or settled [s]; infinite when all rest."""
        return min(
            (
                actuator.time_to_ramped if actuator.ramping else actuator.time_to_settled
                for actuator in self._actuators.values()
                if not actuator.settled
            ),
            default=math.inf,
        )

    def readbacks(self, rng: np.random.Generator) -> dict[str, float]:
        """Return each position as its own instrument shows it."""
        return {name: actuator.readback(rng) for name, actuator in self._actuators.items()}

    def set(self, targets: Mapping[str, float]) -> None:
        """Start moving."""
        for name, target in targets.items():
            self._actuators[name].set(target)

    def hold(self) -> None:
        """Stop all where they are."""
        for actuator in self._actuators.values():
            actuator.hold()

    def step(self, dt: float) -> None:
        """Advance all by ``dt`` >= 0 seconds."""
        for actuator in self._actuators.values():
            actuator.step(dt)

    def checked(self, setpoint: Mapping[str, float], partial: bool = False) -> dict[str, float]:
        """Return the set-point in the machine's order.

        Raises:
            ValueError: If a variable is unknown, not finite or outside its limits, or missing
                where ``partial`` is false.
        """
        variables = self._description.variables
        names = ", ".join(variable.name for variable in variables)
        unknown = sorted(set(setpoint) - set(self._actuators))
        if unknown:
            raise ValueError(
                f"set-point names {unknown[0]!r}, but the machine's variables are {names}"
            )
        missing = [variable.name for variable in variables if variable.name not in setpoint]
        if missing and not partial:
            raise ValueError(
                f"set-point lacks {missing[0]!r}; it must name all of the variables {names}"
            )
        return {v.name: _within(v, setpoint[v.name]) for v in variables if v.name in setpoint}


def _within(variable: Variable, value: float) -> float:
    """Return ``value`` as a float; ValueError if it is outside the limits of ``variable``."""
    number = float(value)
    if not variable.minimum <= number <= variable.maximum:
        unit = f" {variable.unit}" if variable.unit else ""
        raise ValueError(
            f"set-point {variable.name} = {number:g}{unit} is outside the machine's limits, "
            f"{variable.minimum:g} to {variable.maximum:g}{unit}"
        )
    return number
