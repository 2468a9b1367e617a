"""What a machine says of itself, and whether it suits a problem."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from mobo_tuner.core.problem import Problem, ProblemError
from mobo_tuner.core.quantities import Constraint, Objective, Observable, Variable
from mobo_tuner.core.values import listed


@dataclass(frozen=True)
class MachineFacts:
    """Variables and diagnostics of a machine.

    Attributes:
        limits: Hard limits of the variables, by name.
        diagnostics: Units of the diagnostics, by name.
        units: Units of the variables, by name.
        words: Names of the positions of selectors with what the machine takes for them, by variable.
    """

    limits: Mapping[str, tuple[float, float]]
    diagnostics: Mapping[str, str]
    units: Mapping[str, str] = field(default_factory=dict)
    words: Mapping[str, Mapping[str, float]] = field(default_factory=dict)

    def check(self, problem: Problem) -> None:
        """Check that the machine suits a problem.

        Args:
            problem: Problem.

        Raises:
            ProblemError: If the machine lacks a variable or a diagnostic, its limits are narrower than
                the bounds, it needs a variable that the problem does not set, or a unit differs.
        """
        for variable in problem.variables:
            self._check_bounds(variable)
        for name in self.limits:
            if name not in problem.variable_names:
                raise ProblemError(
                    f"the machine's variable '{name}' is missing from 'variables': "
                    f"it needs all of {listed(self.limits)}"
                )
        for variable in problem.variables:
            _check_unit("variable", variable, self.units)
            self._check_words(variable)
        self._check_formulas(problem)
        derived = {d.name for d in problem.derived}
        for kind, quantities in (
            ("objective", problem.objectives),
            ("constraint", problem.constraints),
            ("observable", problem.observables),
        ):
            for quantity in quantities:
                if quantity.name in derived:
                    continue
                if quantity.name not in self.diagnostics:
                    raise ProblemError(
                        f"{kind} '{quantity.name}' is not measured by the machine, "
                        f"which measures {listed(self.diagnostics)}"
                    )
                _check_unit(kind, quantity, self.diagnostics)

    def _check_bounds(self, variable: Variable) -> None:
        """Check that the machine has a variable, and limits that are not narrower than its bounds."""
        if variable.name not in self.limits:
            raise ProblemError(
                f"variable '{variable.name}' is not one of the machine's: {listed(self.limits)}"
            )
        if variable.is_open:
            return
        low, high = self.limits[variable.name]
        ends = [("min", variable.minimum), ("max", variable.maximum)]
        for key, value in ends if variable.fixed is None else [("fixed", variable.fixed)]:
            if not low <= value <= high:
                raise ProblemError(
                    f"variables.{variable.name}.{key} is {value:g} {variable.unit}".rstrip()
                    + f", outside the machine's limits of {low:g} to {high:g}"
                )

    def _check_words(self, variable: Variable) -> None:
        """Check that the machine takes for the choices of a variable what the problem says, if it has names."""
        words = self.words.get(variable.name, {})
        for name, value in zip(variable.choice_names, variable.choices, strict=False):
            if words and words.get(name) != value:
                known = ", ".join(f"{word} = {number:g}" for word, number in words.items())
                raise ProblemError(
                    f"variables.{variable.name} has the choice '{name}' = {value:g}, but the machine takes "
                    f"{known}; set choices and values so"
                )

    def _check_formulas(self, problem: Problem) -> None:
        """Check that the machine measures what the derived quantities consist of, and not themselves."""
        for derived in problem.derived:
            if derived.name in self.diagnostics:
                raise ProblemError(
                    f"derived.{derived.name} is called as a diagnostic of the machine; another name "
                    "is allowed"
                )
            for name in derived.names:
                if name not in self.diagnostics and name not in problem.variable_names:
                    raise ProblemError(
                        f"derived.{derived.name}.formula uses '{name}', which is neither a variable nor "
                        f"measured by the machine, which measures {listed(self.diagnostics)}"
                    )


def _check_unit(
    kind: str, quantity: Variable | Objective | Constraint | Observable, units: Mapping[str, str]
) -> None:
    unit = units.get(quantity.name, "")
    if quantity.unit and unit and quantity.unit != unit:
        raise ProblemError(
            f"the unit of the {kind} '{quantity.name}' is '{quantity.unit}', "
            f"but the machine gives it in '{unit}'"
        )
