"""What a problem is made of: variables, limits, objectives, constraints, observables and contexts."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from typing import Literal, Self

import numpy as np
from numpy.typing import NDArray

Direction = Literal["minimize", "maximize"]
Scale = Literal["linear", "log"]

LIMIT_TOLERANCE = 1e-9
"""Excess of a limit, relative to the largest of its terms and ends, that is rounding."""
_AT_CHOICE = 0.25  # distance from a choice, as a share of the least one between two, at which a readback is there
_ON_GRID = 1e-9  # distance from a multiple, in steps, that is rounding


def share_of(percent: str) -> float:
    """Return the share that a text such as "10 %" names."""
    return float(percent.replace("%", "")) / 100.0


@dataclass(frozen=True)
class Variable:
    """A quantity that the tuner may change.

    Attributes:
        name: Name.
        minimum: Lower bound [`unit`].
        maximum: Upper bound [`unit`].
        unit: Unit.
        cost: Relative cost of changing it, for proximal biasing.
        step: Step of its grid, the multiples of the step [`unit`]; 0 = none.
        choices: Values that it may have, in ascending order [`unit`]; empty = any.
        scale: "log" if its ratios matter and not its differences.
        fixed: Only value that is suggested [`unit`]; None = it is not fixed.
        around: Distance of the bounds from where the machine is at the start of a run [`unit`], or a
            share of the machine's range, such as "10 %"; None = the bounds are known.
        at_present: Whether it is fixed where the machine is at the start of a run.
        approach: Distance from which a working point is approached, from the side from which its
            evaluation was [`unit`]; 0 = from wherever the machine is.
        choice_names: Names of the choices, in their order, if they stand for names without an order; else
            empty.
    """

    name: str
    minimum: float
    maximum: float
    unit: str = ""
    cost: float = 1.0
    step: float = 0.0
    choices: tuple[float, ...] = ()
    scale: Scale = "linear"
    fixed: float | None = None
    around: float | str | None = None
    at_present: bool = False
    approach: float = 0.0
    choice_names: tuple[str, ...] = ()

    def shown(self, value: float, digits: int = 6) -> str:
        """Return a value as text, with so many digits: the name of a choice that has one.

        A readback need not be exact, but what is between two choices is neither.
        """
        if self.choice_names and math.isfinite(value):
            nearest = int(np.abs(np.array(self.choices) - value).argmin())
            apart = min(b - a for a, b in pairwise(self.choices))
            if abs(self.choices[nearest] - value) <= _AT_CHOICE * apart:
                return self.choice_names[nearest]
        return f"{value:.{digits}g}"

    def rank(self, value: float) -> float:
        """Return where a plot shows a value: at the number of a choice without an order, else at the value itself."""
        if not self.choice_names or not math.isfinite(value):
            return value
        return float(np.abs(np.array(self.choices) - value).argmin())

    def number(self, value: object) -> object:
        """Return what stands for the name of a choice; anything else as it is."""
        if isinstance(value, str) and value in self.choice_names:
            return self.choices[self.choice_names.index(value)]
        return value

    @property
    def is_open(self) -> bool:
        """Whether its bounds or its value depend on where the machine is."""
        return self.around is not None or self.at_present

    @cached_property
    def values(self) -> NDArray[np.float64] | None:
        """Values that may be suggested, in ascending order [`unit`]; None if any within the bounds may."""
        if self.fixed is not None:
            return np.array([self.fixed])
        if self.choices:
            return np.array([c for c in self.choices if self.minimum <= c <= self.maximum])
        if not self.step:
            return None
        first = math.ceil(self.minimum / self.step - _ON_GRID)
        last = math.floor(self.maximum / self.step + _ON_GRID)
        # A multiple of 0.1 is the number that is written so, 0.3 and not 0.30000000000000004.
        multiples = [float(f"{k * self.step:.15g}") for k in range(first, last + 1)]
        return np.asarray(np.clip(multiples, self.minimum, self.maximum))

    @cached_property
    def places(self) -> NDArray[np.float64] | None:
        """Normalised `values`; None if there are none."""
        return None if self.values is None else np.array([self.normalize(v) for v in self.values])

    @cached_property
    def _parts(self) -> NDArray[np.float64]:
        """Places in [-1, 1] of choices without an order: equal parts of it are nearest to each."""
        count = len(self.choices)
        if count == 2:
            return np.array([-1.0, 1.0])
        return np.asarray((2.0 * np.arange(count) + 1.0) / count - 1.0)

    def normalize(self, value: float) -> float:
        """Scale a value [`unit`] so that the bounds are -1 and 1.

        Choices without an order get places that do not depend on the numbers that stand for them.
        """
        if self.choice_names:
            return float(self._parts[int(np.abs(np.array(self.choices) - value).argmin())])
        if self.scale == "log":
            if not value > 0.0:
                return -math.inf
            return (
                2.0 * math.log(value / self.minimum) / math.log(self.maximum / self.minimum) - 1.0
            )
        return 2.0 * (value - self.minimum) / (self.maximum - self.minimum) - 1.0

    def denormalize(self, x: float) -> float:
        """Return the value [`unit`] for a place in [-1, 1], inside the bounds and on the grid."""
        if self.places is not None and self.values is not None:
            return float(self.values[int(np.abs(self.places - x).argmin())])
        if self.scale == "log":
            value = self.minimum * math.pow(self.maximum / self.minimum, 0.5 * (x + 1.0))
        else:
            value = self.minimum + 0.5 * (x + 1.0) * (self.maximum - self.minimum)
        return min(max(value, self.minimum), self.maximum)

    def column(self, x: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the values [`unit`] for places ``(n,)`` in [-1, 1], on the bounds but on no grid."""
        if self.choice_names:
            return np.array([self.denormalize(float(xi)) for xi in x])
        if self.scale == "log":
            return np.asarray(self.minimum * (self.maximum / self.minimum) ** (0.5 * (x + 1.0)))
        return np.asarray(self.minimum + 0.5 * (x + 1.0) * (self.maximum - self.minimum))

    def resolved(self, present: float, low: float, high: float) -> Self:
        """Return an open variable with its bounds or value, inside the machine's limits.

        Args:
            present: Where the machine is [`unit`].
            low: Lower limit of the machine [`unit`].
            high: Upper limit of the machine [`unit`].
        """
        present = min(max(present, low), high)
        if self.at_present:
            if self.choices:
                present = min(self.choices, key=lambda choice: abs(choice - present))
            elif self.step:
                multiples = (math.floor(present / self.step), math.ceil(present / self.step))
                nearest = sorted(multiples, key=lambda k: abs(k * self.step - present))
                values = [float(f"{k * self.step:.15g}") for k in nearest]
                present = next((value for value in values if low <= value <= high), present)
            return replace(self, fixed=present, at_present=False)
        around = self.around
        if isinstance(around, str):
            around = share_of(around) * (high - low)
        assert around is not None
        return replace(
            self,
            minimum=max(self.minimum, low, present - around),
            maximum=min(self.maximum, high, present + around),
            around=None,
        )

    def nearest(self, value: float) -> float:
        """Return the allowed value that is nearest [`unit`]; the value itself if there is no grid."""
        if self.values is None:
            return value
        return float(self.values[int(np.abs(self.values - value).argmin())])

    def is_allowed(self, value: float) -> bool:
        """Return whether a value [`unit`] is inside the bounds and on the grid, to rounding."""
        if self.values is None:
            return self.minimum <= value <= self.maximum
        return math.isclose(
            self.nearest(value), value, rel_tol=_ON_GRID, abs_tol=_ON_GRID * self.step
        )


@dataclass(frozen=True)
class Limit:
    """A limit on a weighted sum of variables: ``minimum <= sum <= maximum``.

    Attributes:
        name: Name of the sum.
        coefficients: Coefficient of each variable in it, by name.
        minimum: Lower end.
        maximum: Upper end.
    """

    name: str
    coefficients: tuple[tuple[str, float], ...]
    minimum: float = -math.inf
    maximum: float = math.inf

    def is_met(self, setpoint: Mapping[str, float]) -> bool:
        """Return whether a set-point meets the limit, to rounding."""
        terms = [coefficient * setpoint[name] for name, coefficient in self.coefficients]
        ends = [abs(end) for end in (self.minimum, self.maximum) if math.isfinite(end)]
        slack = LIMIT_TOLERANCE * max(*map(abs, terms), *ends)
        return self.minimum - slack <= math.fsum(terms) <= self.maximum + slack


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
        goal: Value that is good enough [`unit`], one side of the truncation box, which ends at the reference; None
            if the box was given as such.
        invalid: Readings that mean that nothing was measured [`unit`].
    """

    name: str
    reference: float
    direction: Direction = "minimize"
    unit: str = ""
    truncation: tuple[float, float] | None = None
    invalid: tuple[float, ...] = ()
    goal: float | None = None

    def with_reference(self, reference: float) -> Objective:
        """Return the objective with another reference [`unit`]; a goal keeps its truncation box in step."""
        box = (
            self.truncation
            if self.goal is None
            else (min(self.goal, reference), max(self.goal, reference))
        )
        return replace(self, reference=reference, truncation=box)

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
        safe: Probability with which the models must believe that a suggestion meets it; 0 = any.
    """

    name: str
    minimum: float = -math.inf
    maximum: float = math.inf
    unit: str = ""
    critical: bool = False
    invalid: tuple[float, ...] = ()
    safe: float = 0.0

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


@dataclass(frozen=True)
class Context:
    """A diagnostic on which the others depend and that nobody sets, such as a temperature.

    Attributes:
        name: Name of the observable.
        minimum: Lower end of the range in which it is expected [`unit`]; infinite = as measured so far.
        maximum: Upper end of the range.
        unit: Unit.
    """

    name: str
    minimum: float = -math.inf
    maximum: float = math.inf
    unit: str = ""
