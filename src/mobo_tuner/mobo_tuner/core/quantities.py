"""What a problem is made of: variables, objectives, constraints and observables."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

Direction = Literal["minimize", "maximize"]


@dataclass(frozen=True)
class Variable:
    """A quantity that the tuner may change.

    Attributes:
        name: Name.
        minimum: Lower bound [`unit`].
        maximum: Upper bound [`unit`].
        unit: Unit.
        cost: Relative cost of changing it, for proximal biasing.
    """

    name: str
    minimum: float
    maximum: float
    unit: str = ""
    cost: float = 1.0

    def normalize(self, value: float) -> float:
        """Scale a value [`unit`] so that the bounds are -1 and 1."""
        return 2.0 * (value - self.minimum) / (self.maximum - self.minimum) - 1.0


@dataclass(frozen=True)
class Objective:
    """A diagnostic to be minimised or maximised.

    Attributes:
        name: Name.
        reference: Component of the reference point [`unit`]: a reading that is worse earns no
            hypervolume. An infinite one is inferred from the data (`Problem.with_references`).
        direction: Whether it is minimised or maximised.
        unit: Unit.
        truncation: Side ``(A, B)`` of the truncation box [`unit`], or None.
        invalid: Readings that mean that nothing was measured [`unit`].
    """

    name: str
    reference: float
    direction: Direction = "minimize"
    unit: str = ""
    truncation: tuple[float, float] | None = None
    invalid: tuple[float, ...] = ()

    @property
    def sign(self) -> float:
        """+1 for an objective that is minimised, -1 for one that is maximised."""
        return 1.0 if self.direction == "minimize" else -1.0


@dataclass(frozen=True)
class Constraint:
    """A limit on a diagnostic: ``minimum <= value <= maximum``.

    Attributes:
        name: Name of the diagnostic.
        minimum: Lower limit [`unit`].
        maximum: Upper limit [`unit`].
        unit: Unit.
        critical: Whether no single shot may violate it: the machine ends an evaluation that does.
        invalid: Readings that mean that nothing was measured [`unit`].
    """

    name: str
    minimum: float = -math.inf
    maximum: float = math.inf
    unit: str = ""
    critical: bool = False
    invalid: tuple[float, ...] = ()

    def is_met(self, value: float) -> bool:
        """Return whether a measured value meets the limit; NaN does not."""
        return self.minimum <= value <= self.maximum


@dataclass(frozen=True)
class Observable:
    """A diagnostic that is recorded, neither optimised nor limited.

    Attributes:
        name: Name.
        unit: Unit.
        invalid: Readings that mean that nothing was measured [`unit`].
    """

    name: str
    unit: str = ""
    invalid: tuple[float, ...] = ()
