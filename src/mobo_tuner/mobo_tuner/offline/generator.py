"""The optimiser as a generator of gest-api, for the loops of libEnsemble, optimas and Xopt."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, NamedTuple

from gest_api import Generator
from gest_api.vocs import VOCS

from mobo_tuner.core import Optimizer, Problem, ProblemError
from mobo_tuner.core.optimizer import LARGEST_BATCH
from mobo_tuner.core.quantities import Variable
from mobo_tuner.core.values import as_float, as_integer, describe, listed
from mobo_tuner.offline.vocs import measured_names, problem_of, vocs_of

ID = "_id"
"""Key of a suggested point's identifier, by gest-api."""


class _Result(NamedTuple):
    """One evaluated point."""

    id: int | None
    setpoint: dict[str, float]
    outputs: dict[str, float]


class MoboGenerator(Generator):  # type: ignore[misc]  # gest-api has no types
    """Suggests points and ingests their evaluations, in any order and in batches of any size.

    Args:
        vocs: Problem as a VOCS, or as a `Problem`, which can say more: units, limits between variables,
            a truncation box.
        references: Reference point of a VOCS, by objective; those left out are inferred from the
            evaluations.
        batch_size: Number of points that `suggest` returns where none is asked for.
        preset: Preset of the optimiser, see `Optimizer`.
        seed: Seed of every random choice.
        overrides: Single choices in place of the preset's, see `core.settings.OptimizerSettings`.

    Raises:
        ProblemError: If the VOCS has something that a problem cannot have, or a choice is not allowed;
            it is a `ValueError`.

    Attributes:
        vocs: Problem as a VOCS.
        optimizer: Optimiser, which has the front, the hypervolume and the models.

    Examples:
        >>> from gest_api.vocs import VOCS
        >>> vocs = VOCS(
        ...     variables={"x": [0.0, 1.0]}, objectives={"f": "MINIMIZE", "g": "MINIMIZE"}
        ... )
        >>> generator = MoboGenerator(vocs, references={"f": 1.0, "g": 1.0})
        >>> points = generator.suggest(4)
        >>> for point in points:
        ...     point.update(f=point["x"], g=1.0 - point["x"] ** 0.5)
        >>> generator.ingest(points)
        >>> 0.0 < generator.optimizer.hypervolume < 5.0 / 6.0
        True
    """

    returns_id = True

    def __init__(
        self,
        vocs: VOCS | Problem,
        references: Mapping[str, float] = {},
        batch_size: int = 1,
        preset: str = "default",
        seed: int = 0,
        **overrides: Any,
    ) -> None:
        super().__init__(vocs)
        if isinstance(vocs, Problem) and references:
            raise ProblemError(
                "references are given, and a Problem, which has its own; one of the two is allowed"
            )
        problem = vocs if isinstance(vocs, Problem) else problem_of(vocs, references)
        self.vocs = vocs_of(vocs) if isinstance(vocs, Problem) else vocs
        self.optimizer = Optimizer(problem, preset, seed, **overrides)
        self._named = not isinstance(vocs, Problem)  # whether points have the words of the VOCS
        self._batch_size = as_integer("batch_size", batch_size, 1, LARGEST_BATCH)
        self._outputs = measured_names(problem)
        self._fixed = {v.name: v.fixed for v in problem.variables if v.fixed is not None}
        self._next_id = 0
        self._suggested: dict[int, dict[str, float]] = {}

    def _validate_vocs(self, vocs: VOCS | Problem) -> None:
        if not isinstance(vocs, Problem):
            problem_of(vocs)

    def suggest(self, num_points: int | None = None) -> list[dict[str, Any]]:
        """Return points to evaluate, each with every variable, every constant and an `_id`.

        Args:
            num_points: Number of points; None for the size of a batch.

        Raises:
            ProblemError: If the number is not an integer from 1 to `LARGEST_BATCH`.
        """
        points: list[dict[str, Any]] = []
        constants = {name: constant.value for name, constant in self.vocs.constants.items()}
        count = self._batch_size if num_points is None else num_points
        count = as_integer("num_points", count, 1, LARGEST_BATCH)
        for setpoint in self.optimizer.ask(count):
            self._suggested[self._next_id] = setpoint
            words = self.optimizer.problem.chosen(setpoint) if self._named else {}
            points.append({**setpoint, **words, **constants, ID: self._next_id})
            self._next_id += 1
        return points

    def ingest(self, results: Sequence[Mapping[str, Any]]) -> None:
        """Learn evaluated points, also such as were never suggested.

        A point of which no objective and no constraint has a finite value counts as failed.

        Args:
            results: For each point its variables, its outputs and, if it was suggested, its `_id`; a
                suggested point is also known by its variables.

        Raises:
            ProblemError: If the results are not a list of mappings, an `_id` is unknown or was ingested
                before, a variable is missing or a value is not a number; nothing is learned then.
        """
        if isinstance(results, Mapping) or not isinstance(results, Iterable):
            raise ProblemError(f"the results must be a list of points, not {describe(results)}")
        read = [self._read(result) for result in results]
        known = [result.id for result in read if result.id is not None]
        for each in known:
            if each not in self._suggested or known.count(each) > 1:
                raise ProblemError(f"{ID} is {each}; no pending point has it, or two results do")
        for result in read:
            identifier = result.id
            if identifier is None:
                same = (
                    i for i, s in self._suggested.items() if s == result.setpoint and i not in known
                )
                identifier = next(same, None)
            if identifier is not None:
                suggested = self._suggested.pop(identifier)
                if suggested != result.setpoint and suggested in self.optimizer.pending:
                    self.optimizer.cancel(suggested)
            self.optimizer.tell(result.setpoint, result.outputs)

    def _read(self, result: Mapping[str, Any]) -> _Result:
        """Return one result with its numbers as floats, if it fits the problem."""
        if not isinstance(result, Mapping):
            raise ProblemError(f"a result must be a mapping of names, not {describe(result)}")
        problem = self.optimizer.problem
        setpoint = {
            v.name: _number(v, result.get(v.name, self._fixed.get(v.name)))
            for v in problem.variables
        }
        for name in problem.setpoint_names:
            if name not in setpoint and result.get(name) is not None:  # of the fidelity
                setpoint[name] = as_float(name, result[name])
        problem.normalize(setpoint)
        setpoint |= problem.fidelity_of(setpoint)
        outputs = {
            name: as_float(name, result[name])
            for name in self._outputs
            if result.get(name) is not None
        }
        number = as_float(ID, math.nan if result.get(ID) is None else result[ID])
        if number >= 0.0 and not number.is_integer():
            raise ProblemError(f"{ID} is {number:g}; an integer is allowed")
        return _Result(int(number) if number >= 0.0 else None, setpoint, outputs)


def _number(variable: Variable, value: object) -> float:
    """Return the value of a variable as a number, which may stand for a word.

    Raises:
        ProblemError: If it is neither a number nor one of the variable's words.
    """
    number = variable.number(value)
    if isinstance(number, str) and variable.choice_names:
        raise ProblemError(
            f"{variable.name} is {number!r:.60}; allowed are {listed(variable.choice_names)}"
        )
    return as_float(variable.name, number)
