"""The problem: what may be changed, what is wanted, and what must hold.

This is the one place where set-points are scaled to ``[-1, 1]`` and where a maximised objective is
turned round: everything else in the core minimises, as [Roussel2021]_ does.

.. [Roussel2021] R. Roussel, A. Hanuka, A. Edelen, "Multiobjective Bayesian optimization for online
   accelerator tuning", Phys. Rev. Accel. Beams 24, 062801 (2021).
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from mobo_tuner.errors import FileError, UserError
from mobo_tuner.files import load_yaml

__all__ = [
    "Array",
    "Constraint",
    "Objective",
    "Observable",
    "Problem",
    "ProblemError",
    "Variable",
]

Direction = Literal["minimize", "maximize"]
Array = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

LARGEST = 1e38
"""Largest magnitude of a number in a problem. A reading above it is a sentinel, such as the largest
float of single or double precision, and means that nothing was measured."""
FARTHEST = 1e5
"""Largest distance of a set-point from the bounds, in units of the variable's range: the models
cannot tell what lies farther away from one another."""
_SINGLE_PRECISION = 1e-6  # relative difference of a sentinel that passed through 32 bits
_FINEST = 1e-12  # least range of a variable, relative to its bounds

SECTIONS = ("variables", "objectives", "constraints", "observables")
_NAME = re.compile(r"(?!.*__)[A-Za-z][A-Za-z0-9_]*")


class ProblemError(UserError):
    """A problem, a choice of its optimiser or a value told to it that is not allowed."""


@dataclass(frozen=True)
class Variable:
    """A quantity that the tuner may change, between `minimum` and `maximum` in `unit`.

    `cost` is the relative cost [1] of changing it, for proximal biasing.
    """

    name: str
    minimum: float
    maximum: float
    unit: str = ""
    cost: float = 1.0

    def normalize(self, value: float) -> float:
        """Scale a value in `unit` so that the bounds are -1 and 1."""
        return 2.0 * (value - self.minimum) / (self.maximum - self.minimum) - 1.0


@dataclass(frozen=True)
class Objective:
    """A diagnostic to be minimised or maximised.

    `reference` is its component of the reference point, in `unit`: a measured value that is worse
    earns no hypervolume. An infinite one is inferred from the data (`Problem.with_references`).
    `truncation` is its side ``(A, B)`` of the truncation box, in `unit`. A reading that is one of
    `invalid` means that nothing was measured.
    """

    name: str
    reference: float
    direction: Direction = "minimize"
    unit: str = ""
    truncation: tuple[float, float] | None = None
    invalid: tuple[float, ...] = ()

    @property
    def sign(self) -> float:
        """+1 where it is minimised, -1 where it is maximised."""
        return 1.0 if self.direction == "minimize" else -1.0


@dataclass(frozen=True)
class Constraint:
    """A limit on a diagnostic: ``minimum <= value <= maximum``, in `unit`.

    A `critical` one may not be violated by a single shot: the machine ends the evaluation that does.
    A reading that is one of `invalid` means that nothing was measured.
    """

    name: str
    minimum: float = -math.inf
    maximum: float = math.inf
    unit: str = ""
    critical: bool = False
    invalid: tuple[float, ...] = ()

    def is_met(self, value: float) -> bool:
        """Whether a measured `value` meets the limit; NaN does not."""
        return self.minimum <= value <= self.maximum


@dataclass(frozen=True)
class Observable:
    """A diagnostic that is recorded, neither optimised nor limited.

    A reading that is one of `invalid` means that nothing was measured.
    """

    name: str
    unit: str = ""
    invalid: tuple[float, ...] = ()


@dataclass(frozen=True)
class Problem:
    """Variables, objectives, constraints and observables, in the order in which they were given.

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

    @classmethod
    def from_yaml(cls, path: str | Path) -> Problem:
        """Read a ROS parameter file, or a file that holds the bare mapping.

        Raises:
            ProblemError: the file cannot be read, or what it holds is not a problem.
        """
        try:
            content = load_yaml(path)
        except FileError as error:
            raise ProblemError(str(error)) from None
        return cls.from_dict(content)

    @classmethod
    def from_dict(cls, mapping: Mapping[str, Any]) -> Problem:
        """Build a problem from nested mappings, as in a parameter file.

        Raises:
            ProblemError: a key is unknown or missing, or a value is of the wrong type or not allowed.
        """
        parameters = _problem_parameters(mapping)
        _reject_unknown("the problem", parameters, SECTIONS)
        sections = {name: _section(parameters, name) for name in SECTIONS}
        for name in ("variables", "objectives"):
            if not sections[name]:
                raise ProblemError(f"'{name}' is missing or empty: at least one is needed")
        problem = cls(
            variables=tuple(_variable(n, m) for n, m in sections["variables"].items()),
            objectives=tuple(_objective(n, m) for n, m in sections["objectives"].items()),
            constraints=tuple(_constraint(n, m) for n, m in sections["constraints"].items()),
            observables=tuple(_observable(n, m) for n, m in sections["observables"].items()),
        )
        measured = {*problem.objective_names, *(o.name for o in problem.observables)}
        for variable in problem.variables:
            if variable.name in measured:
                raise ProblemError(
                    f"'{variable.name}' is a variable and an objective or observable: "
                    "a name can stand for one quantity only"
                )
        for objective in problem.objectives:
            if problem.largest_reading < abs(objective.reference) < math.inf:
                raise ProblemError(
                    f"objectives.{objective.name}.reference is {objective.reference:g}; with "
                    f"{len(problem.objectives)} objectives at most {problem.largest_reading:g} in "
                    "magnitude is allowed, so that the hypervolume is a finite number"
                )
        return problem

    def to_dict(self) -> dict[str, dict[str, dict[str, Any]]]:
        """The mapping from which :meth:`from_dict` builds an equal problem."""
        return {
            "variables": {
                v.name: {"min": v.minimum, "max": v.maximum, "unit": v.unit, "cost": v.cost}
                for v in self.variables
            },
            "objectives": {
                o.name: {"direction": o.direction}
                | ({"reference": o.reference} if math.isfinite(o.reference) else {})
                | {"unit": o.unit}
                | ({"truncation": list(o.truncation)} if o.truncation else {})
                | _invalid_entry(o)
                for o in self.objectives
            },
            "constraints": {
                c.name: {
                    key: value
                    for key, value in (("min", c.minimum), ("max", c.maximum))
                    if math.isfinite(value)
                }
                | {"unit": c.unit}
                | ({"critical": True} if c.critical else {})
                | _invalid_entry(c)
                for c in self.constraints
            },
            "observables": {o.name: {"unit": o.unit} | _invalid_entry(o) for o in self.observables},
        }

    @property
    def variable_names(self) -> tuple[str, ...]:
        """Names of the variables, in order."""
        return tuple(v.name for v in self.variables)

    @property
    def objective_names(self) -> tuple[str, ...]:
        """Names of the objectives, in order."""
        return tuple(o.name for o in self.objectives)

    @property
    def units(self) -> dict[str, str]:
        """Unit of every quantity that has one."""
        quantities: tuple[Constraint | Observable | Objective | Variable, ...] = (
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
    def has_references(self) -> bool:
        """Whether every objective has its component of the reference point."""
        return all(math.isfinite(o.reference) for o in self.objectives)

    def with_references(
        self, objectives: Array, valid: BoolArray, feasible: BoolArray, initial: int
    ) -> Problem:
        """Return the problem with the components of the reference point that were left out.

        Each is a tenth of the readings' range worse than the worst reading that is feasible, or valid
        where none is. The readings are those of the initial design, and of as few evaluations after
        it as it takes to measure every objective; so the answer stays what it is.

        Args:
            objectives: Minimised objectives of the evaluations so far ``(n, P)``, NaN where not measured.
            valid: Which evaluations are valid ``(n,)``.
            feasible: Which of them are feasible ``(n,)``.
            initial: Number of evaluations of the initial design.

        Returns:
            The problem itself where nothing was left out, or too little was measured so far.
        """
        if self.has_references:
            return self
        for count in range(initial, len(objectives) + 1):
            rows = feasible[:count] if feasible[:count].any() else valid[:count]
            readings = objectives[:count][rows]
            if np.isfinite(readings).any(axis=0).all():
                worst, best = np.nanmax(readings, axis=0), np.nanmin(readings, axis=0)
                break
        else:
            return self
        margin = 0.1 * np.where(worst > best, worst - best, np.maximum(np.abs(worst), 1e-30))
        inferred = np.minimum(worst + margin, self.largest_reading).tolist()
        return replace(
            self,
            objectives=tuple(
                replace(o, reference=o.sign * r) if math.isinf(o.reference) else o
                for o, r in zip(self.objectives, inferred, strict=True)
            ),
        )

    @property
    def largest_reading(self) -> float:
        """Largest magnitude of a reading: the hypervolume is a product of as many as objectives."""
        return float(min(LARGEST, 10.0 ** (290.0 / len(self.objectives))))

    def is_reading(self, name: str, value: float) -> bool:
        """Whether a value of a diagnostic was measured: finite, and not a sentinel."""
        if not abs(value) <= self.largest_reading:
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
        """Reference point of the minimised objectives, shape ``(P,)``."""
        return np.array([o.sign * o.reference for o in self.objectives])

    @property
    def truncation_lower(self) -> Array:
        """Lower corner A of the minimised objectives' truncation box, shape ``(P,)``; -inf if none."""
        return np.array(
            [
                -math.inf if o.truncation is None else min(o.sign * t for t in o.truncation)
                for o in self.objectives
            ]
        )

    def normalize(self, setpoint: Mapping[str, float]) -> Array:
        """Scale a set-point in physical units to ``[-1, 1]``, shape ``(d,)``.

        Raises:
            ProblemError: a variable is missing or unknown, its value is not a finite number, or it is
                farther from the bounds than `FARTHEST`.
        """
        if not isinstance(setpoint, Mapping):
            raise ProblemError(f"the set-point must be a mapping, not {_describe(setpoint)}")
        _reject_unknown("the set-point", setpoint, self.variable_names)
        values = []
        for variable in self.variables:
            if variable.name not in setpoint:
                raise ProblemError(f"the set-point lacks the variable '{variable.name}'")
            value = _number(f"set-point {variable.name}", setpoint[variable.name])
            x = variable.normalize(value)
            if abs(x) > 2.0 * FARTHEST:
                raise ProblemError(
                    f"set-point {variable.name} is {value:g}, which is too far from its bounds "
                    f"{variable.minimum:g} to {variable.maximum:g}: {FARTHEST:g} times the range "
                    "is allowed"
                )
            values.append(x)
        return np.array(values)

    def denormalize(self, x: Array) -> dict[str, float]:
        """Turn ``x`` in ``[-1, 1]``, shape ``(d,)``, into a set-point inside the bounds."""
        return {
            v.name: min(
                max(v.minimum + 0.5 * (float(xi) + 1.0) * (v.maximum - v.minimum), v.minimum),
                v.maximum,
            )
            for v, xi in zip(self.variables, x, strict=True)
        }

    def columns(self, x: Array) -> dict[str, Array]:
        """Set-points ``x`` in ``[-1, 1]``, shape ``(n, d)``, as one array ``(n,)`` per variable."""
        return {
            v.name: v.minimum + 0.5 * (x[:, j] + 1.0) * (v.maximum - v.minimum)
            for j, v in enumerate(self.variables)
        }

    def is_feasible(self, values: Mapping[str, float]) -> bool:
        """Whether measured `values` meet every constraint."""
        return all(c.is_met(values.get(c.name, math.nan)) for c in self.constraints)

    def check_machine(
        self,
        limits: Mapping[str, tuple[float, float]],
        diagnostics: Mapping[str, str],
        variable_units: Mapping[str, str],
    ) -> None:
        """Check that a machine can play this problem.

        Args:
            limits: the machine's variables with their hard limits.
            diagnostics: the names of what it measures, with their units.
            variable_units: the units of its variables.

        Raises:
            ProblemError: it lacks a variable or a diagnostic, its limits are narrower than the
                bounds, it needs a variable that the problem does not set, or it speaks of one of
                them in another unit.
        """
        for variable in self.variables:
            if variable.name not in limits:
                raise ProblemError(
                    f"variable '{variable.name}' is not one of the machine's: {_list(limits)}"
                )
            low, high = limits[variable.name]
            for key, value in (("min", variable.minimum), ("max", variable.maximum)):
                if not low <= value <= high:
                    raise ProblemError(
                        f"variables.{variable.name}.{key} is {value:g} {variable.unit}".rstrip()
                        + f", outside the machine's limits of {low:g} to {high:g}"
                    )
        for name in limits:
            if name not in self.variable_names:
                raise ProblemError(
                    f"the machine's variable '{name}' is missing from 'variables': "
                    f"it needs all of {_list(limits)}"
                )
        for variable in self.variables:
            _check_unit("variable", variable, variable_units)
        for kind, quantities in (
            ("objective", self.objectives),
            ("constraint", self.constraints),
            ("observable", self.observables),
        ):
            for quantity in quantities:
                if quantity.name not in diagnostics:
                    raise ProblemError(
                        f"{kind} '{quantity.name}' is not measured by the machine, "
                        f"which measures {_list(diagnostics)}"
                    )
                _check_unit(kind, quantity, diagnostics)


def _problem_parameters(mapping: Mapping[str, Any]) -> Mapping[str, Any]:
    """The problem's own mapping, out of a ROS parameter file's ``/**`` section where it is one."""
    if not isinstance(mapping, Mapping):
        raise ProblemError(f"the problem must be a mapping, not {_describe(mapping)}")
    section = mapping.get("/**")
    if section is None:
        return mapping
    if not isinstance(section, Mapping) or "ros__parameters" not in section:
        raise ProblemError("the section '/**' must hold 'ros__parameters'")
    parameters = section["ros__parameters"]
    if not isinstance(parameters, Mapping):
        raise ProblemError("'ros__parameters' of the section '/**' must be a mapping")
    return parameters


def _section(parameters: Mapping[str, Any], name: str) -> Mapping[str, Mapping[str, Any]]:
    section = parameters.get(name)
    if section is None:
        return {}
    if not isinstance(section, Mapping):
        raise ProblemError(f"'{name}' must be a mapping of names, not {_describe(section)}")
    for key, entry in section.items():
        if not isinstance(key, str) or not _NAME.fullmatch(key):
            raise ProblemError(
                f"'{key}' in '{name}' is no name: letters, digits and single underscores are "
                "allowed, and a letter comes first"
            )
        if entry is not None and not isinstance(entry, Mapping):
            raise ProblemError(f"'{name}.{key}' must be a mapping, not {_describe(entry)}")
    return {key: entry or {} for key, entry in section.items()}


def _variable(name: str, entry: Mapping[str, Any]) -> Variable:
    where = f"variables.{name}"
    _reject_unknown(where, entry, ("min", "max", "unit", "cost"))
    low = _number(f"{where}.min", _required(where, entry, "min"))
    high = _number(f"{where}.max", _required(where, entry, "max"))
    if not low < high:
        raise ProblemError(f"{where}.min is {low:g}, which must be less than its max of {high:g}")
    if high - low < max(_FINEST * max(abs(low), abs(high)), 1.0 / LARGEST):
        raise ProblemError(
            f"{where}.max is {high!r}, too near to its min of {low!r}: a range of at least "
            f"{_FINEST:g} of the bounds, and of {1.0 / LARGEST:g}, is allowed"
        )
    cost = _number(f"{where}.cost", entry.get("cost", 1.0))
    if cost < 0.0:
        raise ProblemError(f"{where}.cost is {cost:g}, which must not be negative")
    return Variable(name, low, high, _text(f"{where}.unit", entry.get("unit", "")), cost)


def _objective(name: str, entry: Mapping[str, Any]) -> Objective:
    where = f"objectives.{name}"
    _reject_unknown(where, entry, ("direction", "reference", "unit", "truncation", "invalid"))
    direction = entry.get("direction", "minimize")
    if direction not in ("minimize", "maximize"):
        raise ProblemError(
            f"{where}.direction is {direction!r}; 'minimize' and 'maximize' are allowed"
        )
    reference = math.inf if direction == "minimize" else -math.inf
    if entry.get("reference") is not None:
        reference = _number(f"{where}.reference", entry["reference"])
    truncation = None
    if entry.get("truncation") is not None:
        truncation = _interval(f"{where}.truncation", entry["truncation"])
        if math.isinf(reference):
            raise ProblemError(f"{where}.reference is missing: a truncation box needs one")
        if not truncation[0] <= reference <= truncation[1]:
            raise ProblemError(
                f"{where}.reference is {reference:g}, outside its truncation box "
                f"[{truncation[0]:g}, {truncation[1]:g}]"
            )
    unit = _text(f"{where}.unit", entry.get("unit", ""))
    return Objective(name, reference, direction, unit, truncation, _invalid(where, entry))


def _constraint(name: str, entry: Mapping[str, Any]) -> Constraint:
    where = f"constraints.{name}"
    _reject_unknown(where, entry, ("min", "max", "unit", "critical", "invalid"))
    if "min" not in entry and "max" not in entry:
        raise ProblemError(f"{where} needs 'min', 'max' or both")
    low = _number(f"{where}.min", entry["min"]) if "min" in entry else -math.inf
    high = _number(f"{where}.max", entry["max"]) if "max" in entry else math.inf
    if not low < high:
        raise ProblemError(f"{where}.min is {low:g}, which must be less than its max of {high:g}")
    critical = entry.get("critical", False)
    if not isinstance(critical, bool):
        raise ProblemError(f"{where}.critical must be true or false, not {_describe(critical)}")
    unit = _text(f"{where}.unit", entry.get("unit", ""))
    return Constraint(name, low, high, unit, critical, _invalid(where, entry))


def _observable(name: str, entry: Mapping[str, Any]) -> Observable:
    where = f"observables.{name}"
    _reject_unknown(where, entry, ("unit", "invalid"))
    unit = _text(f"{where}.unit", entry.get("unit", ""))
    return Observable(name, unit, _invalid(where, entry))


def _invalid(where: str, entry: Mapping[str, Any]) -> tuple[float, ...]:
    values = entry.get("invalid")
    if values is None:
        return ()
    if isinstance(values, str) or not isinstance(values, Sequence):
        raise ProblemError(f"{where}.invalid must be a list of numbers, not {_describe(values)}")
    return tuple(_number(f"{where}.invalid", value) for value in values)


def _invalid_entry(quantity: Objective | Constraint | Observable) -> dict[str, list[float]]:
    return {"invalid": list(quantity.invalid)} if quantity.invalid else {}


def _interval(where: str, value: object) -> tuple[float, float]:
    if isinstance(value, str) or not isinstance(value, Sequence) or len(value) != 2:
        raise ProblemError(f"{where} must be two numbers [A, B], not {_describe(value)}")
    low, high = (_number(where, v) for v in value)
    if not low < high:
        raise ProblemError(f"{where} is [{low:g}, {high:g}], upside down: A must be less than B")
    return low, high


def _required(where: str, entry: Mapping[str, Any], key: str) -> object:
    if entry.get(key) is None:
        raise ProblemError(f"{where}.{key} is missing")
    return entry[key]


def _number(where: str, value: object) -> float:
    number = as_float(where, value)
    if not math.isfinite(number):
        raise ProblemError(f"{where} must be a finite number, not {number}")
    if abs(number) > LARGEST:
        raise ProblemError(f"{where} is {number:g}; at most {LARGEST:g} in magnitude is allowed")
    return number


def as_float(where: str, value: object) -> float:
    """Return a number of any type as a float, NaN and infinity included.

    Raises:
        ProblemError: If it is not a number: text, a truth value, an array or a list for instance.
    """
    is_scalar = not isinstance(value, np.ndarray) or value.ndim == 0
    if isinstance(value, str | bytes | bytearray | bool | np.bool_) or not is_scalar:
        raise ProblemError(f"{where} must be a number, not {_describe(value)}")
    try:
        return float(value)  # type: ignore[arg-type]
    except (TypeError, ValueError):
        raise ProblemError(f"{where} must be a number, not {_describe(value)}") from None
    except OverflowError:
        raise ProblemError(f"{where} must be a finite number, not {_describe(value)}") from None


def _text(where: str, value: object) -> str:
    if value is None:
        return ""
    if not isinstance(value, str):
        raise ProblemError(f"{where} must be text, not {_describe(value)}")
    return value


def _reject_unknown(where: str, entry: Mapping[str, Any], allowed: Sequence[str]) -> None:
    for key in entry:
        if key not in allowed:
            raise ProblemError(f"'{key}' is unknown in {where}; allowed are {_list(allowed)}")


def _describe(value: object) -> str:
    if isinstance(value, str):
        return f"the text {value[:40]!r}"
    if value is None:
        return "empty"
    kinds = {bool: "a truth value", list: "a list", dict: "a mapping"}
    kind = kinds.get(type(value), "the value")
    try:
        return f"{kind} ({str(value)[:40]})"
    except ValueError:  # Python writes no integer of more than 4300 digits
        return f"{kind} of more than 4300 digits"


def _check_unit(
    kind: str,
    quantity: Variable | Objective | Constraint | Observable,
    units: Mapping[str, str],
) -> None:
    unit = units.get(quantity.name, "")
    if quantity.unit and unit and quantity.unit != unit:
        raise ProblemError(
            f"the unit of the {kind} '{quantity.name}' is '{quantity.unit}', "
            f"but the machine gives it in '{unit}'"
        )


def _list(names: Iterable[str]) -> str:
    return ", ".join(names)
