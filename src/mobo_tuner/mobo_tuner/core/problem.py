"""The problem: what may be changed, what is wanted, and what must hold.

This is the only place that scales set-points to ``[-1, 1]`` and changes the sign of a maximised
objective: everything else in the core minimises, as [Roussel2021]_ does.

.. [Roussel2021] R. Roussel, A. Hanuka, A. Edelen, "Multiobjective Bayesian optimization for online
   accelerator tuning", Phys. Rev. Accel. Beams 24, 062801 (2021).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mobo_tuner.core.derived import Derived, Reading, Result
from mobo_tuner.core.domain import Domain, EmptyDomainError
from mobo_tuner.core.fidelity import Fidelity
from mobo_tuner.core.one_hot import OneHot
from mobo_tuner.core.problem_definition import (
    FIDELITY,
    SECTIONS,
    Quantities,
    definition_of,
    read_definition,
)
from mobo_tuner.core.quantities import Constraint, Context, Limit, Objective, Observable, Variable
from mobo_tuner.core.values import (
    LARGEST,
    ProblemError,
    as_float,
    as_number,
    check_names,
    describe,
    listed,
)
from mobo_tuner.errors import FileError
from mobo_tuner.files import load_yaml
from mobo_tuner.names import topic_token

__all__ = [
    "FARTHEST",
    "FIDELITY",
    "LARGEST",
    "ONE_FIDELITY",
    "SECTIONS",
    "Array",
    "Constraint",
    "Context",
    "Limit",
    "Objective",
    "Observable",
    "Problem",
    "ProblemError",
    "Variable",
    "as_float",
    "rows_apart",
]

Array = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

FARTHEST = 1e5
"""Largest distance of a set-point from the bounds, in units of the variable's range: the models
cannot tell what lies farther away from one another."""
ONE_FIDELITY = "but a machine has one fidelity only; 'mobo.py campaign' optimises simulations, which have several"
"""Reason why a problem with several fidelities is not tuned on a machine."""
_LARGEST_READING = 9.8e37  # SCPI instruments give 9.9e37 for infinity and 9.91e37 for no number
_APART = 5.0  # ranges of all other readings
_LEAST_OTHERS = 3  # readings that say that another one is far from all
_SINGLE_PRECISION = 1e-6  # relative difference of a sentinel that passed through 32 bits


@dataclass(frozen=True)
class Problem:
    """Variables, objectives, constraints, observables and contexts, in the order in which they were given.

    The field calls it VOCS. Build one with :meth:`from_yaml` or :meth:`from_dict`, which check it.

    Example:
        >>> problem = Problem.from_dict(
        ...     {
        ...         "variables": {"K1": {"min": 400.0, "max": 550.0, "unit": "A"}},
        ...         "objectives": {"sigma_x": {"reference": 25.0, "unit": "mm"}},
        ...         "constraints": {"transmission": {"min": 0.98}},
        ...     }
        ... )
        >>> problem.variables[0].maximum
        550.0
        >>> problem.constraints[0].is_met(0.95)
        False
    """

    variables: tuple[Variable, ...]
    objectives: tuple[Objective, ...]
    constraints: tuple[Constraint, ...] = ()
    observables: tuple[Observable, ...] = ()
    limits: tuple[Limit, ...] = ()
    derived: tuple[Derived, ...] = ()
    context: tuple[Context, ...] = ()
    fidelity: Fidelity | None = None

    @classmethod
    def from_yaml(cls, path: str | Path) -> Problem:
        """Read a ROS parameter file, or a file with the mapping alone.

        Args:
            path: File.

        Raises:
            ProblemError: If the file cannot be read or does not define a problem.
        """
        try:
            content = load_yaml(path)
        except FileError as error:
            raise ProblemError(str(error)) from None
        return cls.from_dict(content)

    @classmethod
    def from_dict(cls, mapping: Mapping[str, Any]) -> Problem:
        """Build a problem from nested mappings, as in a parameter file.

        Args:
            mapping: Content of a ROS parameter file, or the sections alone.

        Raises:
            ProblemError: If a key is unknown or missing, or a value has the wrong type or is not
                allowed.
        """
        problem = cls(*read_definition(mapping))
        if not problem.measured_diagnostics:
            raise ProblemError(
                "all objectives and constraints are derived from variables alone; at least one that "
                "is measured is needed"
            )
        if problem.fidelity and any(c.safe for c in problem.constraints):
            raise ProblemError(
                "'fidelity' is given, and a constraint that is safe; one of the two is allowed: what is "
                "safe is a machine's, which has one fidelity only"
            )
        measured = {*problem.required_diagnostics, *(o.name for o in problem.observables)}
        for variable in problem.variables:
            if variable.name in measured:
                raise ProblemError(
                    f"'{variable.name}' is a variable and an objective, constraint or observable: "
                    "a name can stand for one quantity only, and a variable is limited by its min and max"
                )
        problem._check_tokens()
        for objective in problem.objectives:
            if problem.largest_reading < abs(objective.reference) < math.inf:
                raise ProblemError(
                    f"objectives.{objective.name}.reference is {objective.reference:g}; with "
                    f"{len(problem.objectives)} objectives at most {problem.largest_reading:g} in "
                    "magnitude is allowed, so that the hypervolume is a finite number"
                )
            if objective.goal is not None and not abs(objective.goal) < problem.largest_reading:
                raise ProblemError(
                    f"objectives.{objective.name}.goal is {objective.goal:g}; less than "
                    f"{problem.largest_reading:g} in magnitude is allowed, so that a reference can be worse"
                )
        if problem.open_variables:
            return problem
        try:
            _ = problem.domain
        except EmptyDomainError:
            names = listed(f"limits.{limit.name}" for limit in problem.limits)
            raise ProblemError(
                f"no set-point within the bounds and on the grids meets {names}: widen them"
            ) from None
        return problem

    def to_dict(self) -> dict[str, dict[str, Any]]:
        """Return the mapping from which :meth:`from_dict` builds an equal problem."""
        return definition_of(
            Quantities(
                self.variables,
                self.objectives,
                self.constraints,
                self.observables,
                self.limits,
                self.derived,
                self.context,
                self.fidelity,
            )
        )

    def _check_tokens(self) -> None:
        """Check that every name has a topic of its own."""
        names = dict.fromkeys(
            [
                *self.setpoint_names,
                *self.required_diagnostics,
                *(o.name for o in self.observables),
                *(d.name for d in self.derived),
            ]
        )
        tokens: dict[str, str] = {}
        for name in names:
            other = tokens.setdefault(topic_token(name), name)
            if other != name:
                raise ProblemError(
                    f"'{name}' and '{other}' would share the topic plot/{topic_token(name)}; names that differ "
                    "in more than their separators are allowed"
                )

    @property
    def variable_names(self) -> tuple[str, ...]:
        """Names of the variables, in order."""
        return tuple(v.name for v in self.variables)

    @property
    def setpoint_names(self) -> tuple[str, ...]:
        """Names of what a set-point has: the variables, then those of the fidelity."""
        return self.variable_names + (self.fidelity.names if self.fidelity else ())

    @property
    def objective_names(self) -> tuple[str, ...]:
        """Names of the objectives, in order."""
        return tuple(o.name for o in self.objectives)

    @property
    def units(self) -> dict[str, str]:
        """Unit of every quantity that has one."""
        quantities: tuple[Constraint | Derived | Observable | Objective | Variable, ...] = (
            *(self.fidelity.variables if self.fidelity else ()),
            *self.derived,
            *self.constraints,
            *self.observables,
            *self.objectives,
            *self.variables,
        )
        return {quantity.name: quantity.unit for quantity in quantities if quantity.unit}

    @property
    def required_diagnostics(self) -> tuple[str, ...]:
        """Diagnostics without which an evaluation is invalid: objectives and constrained ones."""
        return tuple(dict.fromkeys([*self.objective_names, *(c.name for c in self.constraints)]))

    @property
    def measured_diagnostics(self) -> tuple[str, ...]:
        """Diagnostics of the machine of which `required_diagnostics` consist or are derived."""
        parts = {d.name: d.names for d in self.derived}
        names = [part for n in self.required_diagnostics for part in parts.get(n, (n,))]
        return tuple(dict.fromkeys(name for name in names if name not in self.variable_names))

    @property
    def known_before(self) -> frozenset[str]:
        """Derived quantities that depend on variables alone, so that their values say of no measurement."""
        variables = set(self.variable_names)
        return frozenset(d.name for d in self.derived if variables.issuperset(d.names))

    def derive(
        self, where: Mapping[str, float], readings: Mapping[str, Reading]
    ) -> dict[str, Result]:
        """Return the derived quantities; one that was measured in place of its parts is left out.

        Args:
            where: Where the machine was, every variable in its unit.
            readings: Mean and standard deviation of the diagnostics by name, NaN where unknown.
        """
        known = {**readings, **{name: (value, 0.0) for name, value in where.items()}}
        return {
            d.name: d.of(known)
            for d in self.derived
            if d.name not in readings or any(name in readings for name in d.names)
        }

    @property
    def has_references(self) -> bool:
        """Whether every objective has its component of the reference point."""
        return all(math.isfinite(o.reference) for o in self.objectives)

    def with_references(
        self, objectives: Array, valid: BoolArray, feasible: BoolArray, initial: int
    ) -> Problem:
        """Return the problem with the components of the reference point that were left out.

        Each is a tenth of the readings' range worse than the worst feasible reading or, if none is
        feasible, the worst valid one. One reading of each that is many ranges of all others away from these
        does not count. The readings are those of the initial design and of as few
        evaluations after it as are needed to measure every objective, so that the result is final.

        Args:
            objectives: Minimised objectives of the evaluations so far ``(n, P)``, NaN where not measured.
            valid: Whether each evaluation is valid ``(n,)``.
            feasible: Whether each evaluation is feasible ``(n,)``.
            initial: Number of evaluations of the initial design.

        Returns:
            The problem; the same one if nothing was left out, or too little was measured so far.
        """
        if self.has_references:
            return self
        for count in range(initial, len(objectives) + 1):
            rows = feasible[:count] if feasible[:count].any() else valid[:count]
            readings = objectives[:count][rows]
            if np.isfinite(readings).any(axis=0).all():
                readings = _without_wild(readings)
                worst, best = np.nanmax(readings, axis=0), np.nanmin(readings, axis=0)
                break
        else:
            return self
        margin = 0.1 * np.where(worst > best, worst - best, np.maximum(np.abs(worst), 1e-30))
        # With a reference better than a goal, nothing could improve.
        goals = [-math.inf if o.goal is None else o.sign * o.goal for o in self.objectives]
        end = np.maximum(worst, goals)
        # Where a goal is far from all readings, their range may be less than its last digit.
        reference = np.where(end + margin > end, end + margin, end + 0.1 * np.abs(end))
        inferred = np.minimum(reference, self.largest_reading).tolist()
        return replace(
            self,
            objectives=tuple(
                o.with_reference(o.sign * r) if math.isinf(o.reference) else o
                for o, r in zip(self.objectives, inferred, strict=True)
            ),
        )

    @property
    def largest_reading(self) -> float:
        """Largest magnitude of a reading, so that the hypervolume, a product of P of them, is finite."""
        return float(min(LARGEST, 10.0 ** (290.0 / len(self.objectives))))

    def variable(self, name: str) -> Variable | None:
        """Return the variable of a name; None if there is none."""
        return self._by_name.get(name)

    def shown(self, name: str, value: float, digits: int = 6) -> str:
        """Return the value of a quantity as text: the name of a choice that has one, else so many digits."""
        variable = self._by_name.get(name)
        return f"{value:.{digits}g}" if variable is None else variable.shown(value, digits)

    def chosen(self, setpoint: Mapping[str, float]) -> dict[str, str]:
        """Return the names of the choices in a set-point, by their variables."""
        return {
            v.name: v.shown(setpoint[v.name])
            for v in self.variables
            if v.choice_names and math.isfinite(setpoint.get(v.name, math.nan))
        }

    @cached_property
    def _by_name(self) -> dict[str, Variable]:
        return {v.name: v for v in self.variables}

    def is_reading(self, name: str, value: float) -> bool:
        """Return whether a value of a diagnostic was measured: it is finite and not a sentinel."""
        if not abs(value) <= min(self.largest_reading, _LARGEST_READING):
            return False
        quantities: list[Objective | Constraint | Observable] = [
            *self.objectives,
            *self.constraints,
            *self.observables,
        ]
        sentinels = [s for q in quantities if q.name == name for s in q.invalid]
        return not any(math.isclose(value, s, rel_tol=_SINGLE_PRECISION) for s in sentinels)

    @property
    def reference_point(self) -> Array:
        """Reference point of the minimised objectives ``(P,)``."""
        return np.array([o.sign * o.reference for o in self.objectives])

    @property
    def truncation_lower(self) -> Array:
        """Lower corner A of the truncation box of the minimised objectives ``(P,)``; -inf if none."""
        return np.array(
            [
                -math.inf if o.truncation is None else min(o.sign * t for t in o.truncation)
                for o in self.objectives
            ]
        )

    def normalize(self, setpoint: Mapping[str, float]) -> Array:
        """Return a set-point in physical units scaled to ``[-1, 1]``, ``(d,)``.

        Args:
            setpoint: Value of each variable, in its unit; its fidelity, if any, is no part of the result.

        Raises:
            ProblemError: If a variable is missing or unknown, or its value is not a finite number or
                farther from the bounds than `FARTHEST`, or the fidelity is not within its range.
        """
        if not isinstance(setpoint, Mapping):
            raise ProblemError(f"the set-point must be a mapping, not {describe(setpoint)}")
        check_names("the set-point", setpoint, self.setpoint_names)
        values = []
        for variable in self.variables:
            if variable.name not in setpoint:
                raise ProblemError(f"the set-point lacks the variable '{variable.name}'")
            value = as_number(f"set-point {variable.name}", setpoint[variable.name])
            if variable.scale == "log" and not value > 0.0:
                raise ProblemError(
                    f"set-point {variable.name} is {value:g}; with scale log it must be greater than 0"
                )
            x = variable.normalize(value)
            if abs(x) > 2.0 * FARTHEST:
                raise ProblemError(
                    f"set-point {variable.name} is {value:g}, which is too far from its bounds "
                    f"{variable.minimum:g} to {variable.maximum:g}: {FARTHEST:g} times the range "
                    "is allowed"
                )
            values.append(x)
        self.fidelity_of(setpoint)
        return np.array(values)

    def denormalize(self, x: Array) -> dict[str, float]:
        """Return the set-point inside the bounds, in physical units, for ``x`` ``(d,)`` in ``[-1, 1]``.

        Its fidelity is the highest.
        """
        places = zip(self.variables, x, strict=True)
        return {v.name: v.denormalize(float(xi)) for v, xi in places} | self.fidelity_of({})

    def fidelity_of(self, setpoint: Mapping[str, float]) -> dict[str, float]:
        """Return the fidelity of a set-point, the highest where it says nothing; empty if there are none.

        Raises:
            ProblemError: If a value is not within its range.
        """
        return self.fidelity.of(setpoint) if self.fidelity else {}

    @property
    def open_variables(self) -> tuple[str, ...]:
        """Names of the variables whose bounds or value depend on where the machine is."""
        return tuple(v.name for v in self.variables if v.is_open)

    def resolved(
        self, present: Mapping[str, float], limits: Mapping[str, tuple[float, float]]
    ) -> Problem:
        """Return the problem with the bounds and values of its open variables.

        Args:
            present: Where the machine is, in physical units.
            limits: Limits of the machine's variables; no bound is beyond them.

        Raises:
            ProblemError: If an open variable is unknown there, or nothing is left of its range.
        """
        resolved = []
        for v in self.variables:
            if v.is_open:
                if v.name not in limits or not math.isfinite(present.get(v.name, math.nan)):
                    raise ProblemError(f"the machine does not say where its '{v.name}' is")
                v = v.resolved(present[v.name], *limits[v.name])
            resolved.append(v)
        return Problem.from_dict(replace(self, variables=tuple(resolved)).to_dict())

    def resolved_as(self, other: Problem) -> Problem:
        """Return the problem with the bounds and values that its open variables have in another one.

        Raises:
            ProblemError: If the other one lacks such a variable.
        """
        known = {v.name: v for v in other.variables}
        resolved = []
        for v in self.variables:
            if v.is_open:
                if v.name not in known:
                    raise ProblemError(f"the variable '{v.name}' is new; its bounds are needed")
                v = replace(
                    v,
                    minimum=known[v.name].minimum,
                    maximum=known[v.name].maximum,
                    fixed=known[v.name].fixed,
                    around=None,
                    at_present=False,
                )
            resolved.append(v)
        return Problem.from_dict(replace(self, variables=tuple(resolved)).to_dict())

    @cached_property
    def one_hot(self) -> OneHot | None:
        """How models see the unordered variables; None if there are none of more than two choices.

        Of two choices, each is as far from the other as with an order.
        """
        places = [
            np.array([v.normalize(c) for c in v.choices]) if len(v.choice_names) > 2 else None
            for v in self.variables
        ]
        return OneHot(places) if any(p is not None for p in places) else None

    @cached_property
    def domain(self) -> Domain:
        """Normalised set-points that may be suggested.

        Raises:
            EmptyDomainError: If there is none.
        """
        places = [v.places for v in self.variables]
        unordered = [bool(v.choice_names) for v in self.variables]
        if not self.limits:
            return Domain(places, unordered=unordered)
        half = np.array([0.5 * (v.maximum - v.minimum) for v in self.variables])
        middle = np.array([v.minimum for v in self.variables]) + half
        by_name = [dict(limit.coefficients) for limit in self.limits]
        weights = np.array([[c.get(n, 0.0) for n in self.variable_names] for c in by_name])
        ends = np.array([[limit.minimum, limit.maximum] for limit in self.limits])
        scaled, ends = weights * half, ends - (weights @ middle)[:, None]
        size = np.abs(scaled).max(axis=1, keepdims=True)
        lower, upper = (ends / size).T
        return Domain(places, scaled / size, lower, upper, unordered)

    def columns(self, x: Array) -> dict[str, Array]:
        """Return set-points ``x`` ``(n, d)`` in ``[-1, 1]`` as one array ``(n,)`` per variable, in its unit."""
        return {v.name: v.column(x[:, j]) for j, v in enumerate(self.variables)}

    def is_feasible(self, values: Mapping[str, float]) -> bool:
        """Return whether measured `values` meet every constraint."""
        return all(c.is_met(values.get(c.name, math.nan)) for c in self.constraints)


def rows_apart(y: Array, most: int, least_rest: int) -> NDArray[np.intp]:
    """Return the rows of the few readings ``(n,)`` that are many ranges of all others away from these.

    One of them would be ruled out by the others; two or more hide each other.

    Args:
        y: Readings ``(n,)``.
        most: Highest number of rows, which are at most half of all.
        least_rest: Least number of others.
    """
    order = np.argsort(np.abs(y - np.median(y)), kind="stable")
    for count in range(min(most, len(y) // 2, len(y) - least_rest), 0, -1):
        rest, apart = y[order[:-count]], y[order[-count:]]
        deviation = np.abs(rest - np.median(rest))
        nearest = np.abs(apart - np.median(rest)).min()
        # Where readings span decades, the next one is as far from the rest as the rest's last one from its median.
        is_tail = nearest * np.median(deviation) <= np.square(deviation.max())
        if nearest > _APART * np.ptp(rest) and not is_tail:
            return np.sort(order[-count:])
    return order[:0]


def _without_wild(readings: Array) -> Array:
    """Return readings ``(n, P)`` with NaN for the one of each column that is far from all others, if any.

    Where all others are alike, the one that differs is what is looked for.
    """
    kept = readings.copy()
    for column in kept.T:
        finite = np.flatnonzero(np.isfinite(column))
        rows = finite[rows_apart(column[finite], 1, _LEAST_OTHERS)]
        others = np.setdiff1d(finite, rows)
        if len(rows) and np.ptp(column[others]) > 0.0:
            column[rows] = np.nan
    return kept
