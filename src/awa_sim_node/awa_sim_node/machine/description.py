"""Description of a machine: names, units and limits of its variables and diagnostics."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Variable:
    """One variable of the machine.

    Attributes:
        name: Name in set-points and readbacks.
        unit: Unit of the value, e.g. ``"A"``; empty if it has none.
        minimum: Lowest set-point that the machine accepts, in ``unit``.
        maximum: Highest set-point that the machine accepts, in ``unit``.
        initial: Value when the machine is switched on, in ``unit``.
    """

    name: str
    unit: str
    minimum: float
    maximum: float
    initial: float


@dataclass(frozen=True)
class Diagnostic:
    """One quantity that the machine measures.

    Attributes:
        name: Name of the quantity.
        unit: Unit of the value; empty if it has none.
    """

    name: str
    unit: str


@dataclass(frozen=True)
class ModelDescription:
    """Static description of a machine.

    Attributes:
        name: Name of the machine, as passed to ``describe``.
        title: Short description for people.
        variables: Variables, in the machine's order.
        diagnostics: Diagnostics, in the machine's order.
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
