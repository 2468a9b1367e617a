"""All actuators of a machine together."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from awa_sim_node.machine.actuator import INSTANTANEOUS, Actuator
from awa_sim_node.machine.behaviour import Behaviour
from awa_sim_node.machine.description import ModelDescription, Variable
from awa_sim_node.machine.kind import Kind


class Actuators:
    """All actuators of a machine by the names of their variables, in the machine's order."""

    def __init__(
        self, description: ModelDescription, kinds: Mapping[str, Kind], behaviour: Behaviour
    ) -> None:
        """Create the actuators at rest at the initial set-point.

        Args:
            description: Description of the machine.
            kinds: Kind of each variable.
            behaviour: Parameters of the machine's behaviour.
        """
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
        """Set-point of each actuator."""
        return {name: actuator.target for name, actuator in self._actuators.items()}

    @property
    def strengths(self) -> dict[str, float]:
        """Value of each actuator that the beam feels."""
        return {name: actuator.strength for name, actuator in self._actuators.items()}

    @property
    def settled(self) -> dict[str, bool]:
        """Whether each actuator is settled on its target."""
        return {name: actuator.settled for name, actuator in self._actuators.items()}

    @property
    def all_settled(self) -> bool:
        """Whether all actuators are settled."""
        return all(actuator.settled for actuator in self._actuators.values())

    @property
    def ramping(self) -> bool:
        """Whether any actuator is ramping."""
        return any(actuator.ramping for actuator in self._actuators.values())

    @property
    def time_to_ramped(self) -> float:
        """Time until no actuator is ramping [s]."""
        return max(actuator.time_to_ramped for actuator in self._actuators.values())

    @property
    def time_to_settled(self) -> float:
        """Time until all actuators are settled [s]."""
        return max(actuator.time_to_settled for actuator in self._actuators.values())

    @property
    def time_to_next_event(self) -> float:
        """Time until an actuator has ramped or settled [s]; infinite if all are settled."""
        return min(
            (
                actuator.time_to_ramped if actuator.ramping else actuator.time_to_settled
                for actuator in self._actuators.values()
                if not actuator.settled
            ),
            default=math.inf,
        )

    def readbacks(self, rng: np.random.Generator) -> dict[str, float]:
        """Return the position of each actuator with the noise of its instrument."""
        return {name: actuator.readback(rng) for name, actuator in self._actuators.items()}

    def set(self, targets: Mapping[str, float]) -> None:
        """Start moving to the targets; actuators that are not named are unaffected."""
        for name, target in targets.items():
            self._actuators[name].set(target)

    def hold(self) -> None:
        """Stop all actuators at their positions."""
        for actuator in self._actuators.values():
            actuator.hold()

    def step(self, dt: float) -> None:
        """Advance all actuators by ``dt`` >= 0 seconds."""
        for actuator in self._actuators.values():
            actuator.step(dt)

    def checked(self, setpoint: Mapping[str, float], partial: bool = False) -> dict[str, float]:
        """Return the checked set-point in the machine's order.

        Args:
            setpoint: Value of each variable, in its unit.
            partial: Whether variables may be missing.

        Raises:
            ValueError: If a variable is unknown, not finite or outside its limits, or missing
                although ``partial`` is false.
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
