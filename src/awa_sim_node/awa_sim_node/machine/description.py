"""What a machine can be told and what it can tell: names, units and limits."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Variable:
    """One setting of the machine.

    Attributes:
        name: The variable's name in set-points and readbacks.
        unit: Unit of the value, e.g. ``"A"``; empty where it has none.
        minimum: Lowest set-point the machine accepts, in ``unit``.
        maximum: Highest set-point the machine accepts, in ``unit``.
        initial: Where the variable stands when the machine is switched on, in ``unit``.
    """

    name: str
    unit: str
    minimum: float
    maximum: float
    initial: float


@dataclass(frozen=True)
class Diagnostic:
    """One quantity the machine measures; ``unit`` is empty where it has none."""

    name: str
    unit: str


@dataclass(frozen=True)
class MachineDescription:
    """All that must be known about a machine before it is tuned.

    Attributes:
        name: Name of the machine, as given to ``describe``.
        title: What the machine is, in a few words.
        variables: The settings, in the machine's order.
        diagnostics: The measured quantities, in the machine's order.
    """

    name: str
    title: str
    variables: tuple[Variable, ...]
    diagnostics: tuple[Diagnostic, ...]

    def variable(self, name: str) -> Variable:
        """Return the variable called ``name``; ``KeyError`` if there is none."""
        return {variable.name: variable for variable in self.variables}[name]

    def diagnostic(self, name: str) -> Diagnostic:
        """Return the diagnostic called ``name``; ``KeyError`` if there is none."""
        return {diagnostic.name: diagnostic for diagnostic in self.diagnostics}[name]
