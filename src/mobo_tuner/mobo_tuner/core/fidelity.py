"""Fidelities of a simulation: what may be chosen cheaper than the best, and what each choice costs."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import product
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mobo_tuner.core.derived import Derived
from mobo_tuner.core.quantities import Variable
from mobo_tuner.core.values import ProblemError, as_number, listed

MOST_LEVELS = 64
"""Largest number of fidelities of a problem."""
_MOST_VALUES = 5  # of a variable that has more of them, or a range
_SAME = 1e-9  # distance of two fidelities that is rounding, relative to the range


@dataclass(frozen=True)
class Cost(Derived):
    """Cost of one evaluation: a formula over the variables of the fidelity, in any unit."""

    @property
    def _where(self) -> str:
        return "fidelity.cost"


class Spent(NamedTuple):
    """What was evaluated at one fidelity.

    Attributes:
        level: Value of each variable of the fidelity.
        evaluations: Number of evaluations.
        cost: Cost of all of them, in evaluations at the highest fidelity.
    """

    level: dict[str, float]
    evaluations: int
    cost: float


@dataclass(frozen=True)
class Fidelity:
    """The variables of a fidelity, such as the number of particles, and the cost of an evaluation.

    A level is one value of each variable. The highest is that of all targets: what is wanted of the
    objectives is wanted there.

    Attributes:
        variables: Variables.
        targets: Value of each at the highest fidelity, one end of its range.
        cost: Cost of an evaluation.

    Raises:
        ProblemError: If there are too many levels, or the cost is not one.
    """

    variables: tuple[Variable, ...]
    targets: tuple[float, ...]
    cost: Cost

    def __post_init__(self) -> None:
        for name in self.cost.names:
            if name not in self.names:
                raise ProblemError(f"fidelity.cost uses '{name}'; allowed are {listed(self.names)}")
        count = math.prod(len(each) for each in self._values)
        if count > MOST_LEVELS:
            raise ProblemError(
                f"fidelity has {count} levels, all combinations of its variables; at most {MOST_LEVELS} are allowed"
            )
        for level, cost in zip(self.levels, self._costs, strict=True):
            where = ", ".join(f"{name} = {value:g}" for name, value in level.items())
            if not 0.0 < cost < math.inf:
                raise ProblemError(
                    f"fidelity.cost is {cost:g} at {where}; a number greater than 0 is allowed"
                )
            if level != self.highest and not cost < self._costs[-1]:
                raise ProblemError(
                    f"fidelity.cost is {cost:g} at {where}; less than the {self._costs[-1]:g} of the highest "
                    "fidelity is allowed"
                )

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the variables."""
        return tuple(v.name for v in self.variables)

    @property
    def highest(self) -> dict[str, float]:
        """The highest fidelity: the target of each variable."""
        return dict(zip(self.names, self.targets, strict=True))

    @cached_property
    def levels(self) -> tuple[dict[str, float], ...]:
        """Levels that may be chosen, the cheapest first and the highest last."""
        combined = [dict(zip(self.names, level, strict=True)) for level in product(*self._values)]
        return (*sorted((v for v in combined if v != self.highest), key=self._cost), self.highest)

    @cached_property
    def shares(self) -> NDArray[np.float64]:
        """Cost of each level as a share of that of the highest, ``(m,)``."""
        return np.asarray(self._costs / self._costs[-1])

    def share(self, level: Mapping[str, float]) -> float:
        """Return the cost of an evaluation as a share of one at the highest fidelity."""
        return float(self._cost(level) / self._costs[-1])

    def spent(self, setpoints: Iterable[Mapping[str, float]]) -> list[Spent]:
        """Return what evaluations at some set-points cost, by fidelity, the cheapest first.

        Raises:
            ProblemError: If a value of a set-point is not within its range.
        """
        counts = Counter(tuple(self.of(setpoint).items()) for setpoint in setpoints)
        spent = [Spent(dict(n), count, count * self.share(dict(n))) for n, count in counts.items()]
        return sorted(spent, key=lambda each: self.share(each.level))

    def lack(self, level: Mapping[str, float]) -> NDArray[np.float64]:
        """Return how far each variable is from its target, as a share of its range, ``(f,)``."""
        return np.array(
            [
                0.5 * abs(v.normalize(level[v.name]) - v.normalize(target))
                for v, target in zip(self.variables, self.targets, strict=True)
            ]
        )

    def is_highest(self, level: Mapping[str, float]) -> bool:
        """Return whether a fidelity is the highest one, to rounding."""
        return bool((self.lack(level) <= _SAME).all())

    def of(self, setpoint: Mapping[str, float]) -> dict[str, float]:
        """Return the fidelity of a set-point; what it leaves out is at its target.

        Raises:
            ProblemError: If a value is not within its range.
        """
        level = self.highest
        for variable in self.variables:
            if variable.name in setpoint:
                where = f"set-point {variable.name}"
                value = level[variable.name] = as_number(where, setpoint[variable.name])
                if not abs(variable.normalize(value)) <= 1.0 + _SAME:
                    raise ProblemError(
                        f"{where} is {value:g}; {variable.minimum:g} to {variable.maximum:g} is allowed"
                    )
        return level

    def _cost(self, level: Mapping[str, float]) -> float:
        return self.cost.of({name: (value, 0.0) for name, value in level.items()}).value

    @cached_property
    def _costs(self) -> NDArray[np.float64]:
        return np.array([self._cost(level) for level in self.levels])

    @cached_property
    def _values(self) -> Sequence[Sequence[float]]:
        """Values of each variable that are chosen from, the target among them."""
        chosen = []
        for variable, target in zip(self.variables, self.targets, strict=True):
            values = variable.values
            if values is None:
                places = np.linspace(-1.0, 1.0, _MOST_VALUES)
                values = np.array([variable.denormalize(x) for x in places])
            elif not variable.choices and len(values) > _MOST_VALUES:
                values = values[np.linspace(0, len(values) - 1, _MOST_VALUES).round().astype(int)]
            chosen.append(sorted({*values.tolist(), target}))
        return chosen
