"""The evaluations of a run in little memory, for displays that stay open for days."""

from __future__ import annotations

from array import array
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal, overload

import numpy as np
import numpy.typing as npt

from mobo_tuner.client import Evaluation

Floats = npt.NDArray[np.float64]
Flags = npt.NDArray[np.bool_]

Number = Literal[
    "index",
    "attempts",
    "stamp",
    "valid",
    "feasible",
    "non_dominated",
    "hypervolume",
    "hypervolume_measured",
    "error_code",
    "suggest_seconds",
    "machine_seconds",
    "total_seconds",
]
"""Fields of an evaluation that are one number each."""

_NUMBERS: Mapping[Number, Callable[[float], Any]] = {
    "index": int,
    "attempts": int,
    "stamp": float,
    "valid": bool,
    "feasible": bool,
    "non_dominated": bool,
    "hypervolume": float,
    "hypervolume_measured": float,
    "error_code": int,
    "suggest_seconds": float,
    "machine_seconds": float,
    "total_seconds": float,
}
_PLACES = {name: place for place, name in enumerate(_NUMBERS)}


@dataclass(frozen=True)
class _Layout:
    """What the numbers of an evaluation mean; most evaluations of a run share one layout."""

    run_id: str
    source: str
    setpoint: tuple[str, ...]
    readbacks: tuple[str, ...]
    diagnostics: tuple[str, ...]
    objectives: tuple[str, ...]
    units: tuple[tuple[str, str], ...]

    @classmethod
    def of(cls, evaluation: Evaluation) -> _Layout:
        """Return the layout of an evaluation."""
        return cls(
            run_id=evaluation.run_id,
            source=evaluation.source,
            setpoint=(*evaluation.setpoint,),
            readbacks=(*evaluation.readbacks,),
            diagnostics=(*evaluation.diagnostics,),
            objectives=(*evaluation.objectives,),
            units=(*evaluation.units.items(),),
        )

    @property
    def names(self) -> tuple[tuple[str, str], ...]:
        """Kind and name of each number after those of `_NUMBERS`."""
        return (
            *(("setpoint", name) for name in self.setpoint),
            *(("readbacks", name) for name in self.readbacks),
            *(("objectives", name) for name in self.objectives),
            *(("diagnostics", name) for name in self.diagnostics),
            *(("stddevs", name) for name in self.diagnostics),
        )


class EvaluationTable(Sequence[Evaluation]):
    """Evaluations in the order of their arrival.

    Their numbers are in one array, 8 bytes each; an `Evaluation` is made when it is asked for.
    """

    def __init__(self) -> None:
        self._numbers = array("d")
        self._starts = array("Q")  # of each evaluation in `_numbers`
        self._kinds = array("L")  # layout of each evaluation
        self._layouts: list[_Layout] = []
        self._known: dict[_Layout, int] = {}  # position in `_layouts`
        self._errors: dict[int, str] = {}  # by the position of the evaluation
        self._positions: dict[int, int] = {}  # by the index of the evaluation

    def add(self, evaluation: Evaluation) -> None:
        """Add an evaluation."""
        layout = _Layout.of(evaluation)
        self._positions[evaluation.index] = len(self)
        if layout not in self._known:
            self._known[layout] = len(self._layouts)
            self._layouts.append(layout)
        if evaluation.error_msg:
            self._errors[len(self)] = evaluation.error_msg
        self._kinds.append(self._known[layout])
        self._starts.append(len(self._numbers))
        self._numbers.extend(float(getattr(evaluation, name)) for name in _NUMBERS)
        for values in (evaluation.setpoint, evaluation.readbacks, evaluation.objectives):
            self._numbers.extend(values.values())
        for part in (0, 1):
            self._numbers.extend(pair[part] for pair in evaluation.diagnostics.values())

    def position(self, index: int | None) -> int | None:
        """Return the position of the evaluation with an index; None if there is none."""
        return None if index is None else self._positions.get(index)

    def numbers(self, field: Number) -> Floats:
        """Return a field of every evaluation, shape (n,); True is 1."""
        return self._taken(np.full(len(self), _PLACES[field]))

    def objectives(self, name: str) -> Floats:
        """Return an objective of every evaluation, shape (n,), in its unit; NaN = not measured."""
        return self._named("objectives", name)

    def diagnostics(self, name: str) -> Floats:
        """Return the mean of a diagnostic of every evaluation, shape (n,), in its unit; NaN = not measured."""
        return self._named("diagnostics", name)

    def __len__(self) -> int:
        return len(self._starts)

    @overload
    def __getitem__(self, position: int) -> Evaluation: ...

    @overload
    def __getitem__(self, position: slice) -> list[Evaluation]: ...

    def __getitem__(self, position: int | slice) -> Evaluation | list[Evaluation]:
        if isinstance(position, slice):
            return [self._made(i) for i in range(*position.indices(len(self)))]
        return self._made(range(len(self))[position])

    def _made(self, position: int) -> Evaluation:
        """Return the evaluation at a position."""
        layout = self._layouts[self._kinds[position]]
        start = self._starts[position]
        end = start + len(_NUMBERS) + len(layout.names)
        numbers = iter(self._numbers[start:end])
        fields: dict[str, Any] = {name: kind(next(numbers)) for name, kind in _NUMBERS.items()}
        fields["source"] = layout.source

        def values(names: tuple[str, ...]) -> dict[str, float]:
            return {name: next(numbers) for name in names}

        setpoint, readbacks = values(layout.setpoint), values(layout.readbacks)
        objectives, means = values(layout.objectives), values(layout.diagnostics)
        return Evaluation(
            **fields,
            run_id=layout.run_id,
            error_msg=self._errors.get(position, ""),
            setpoint=setpoint,
            readbacks=readbacks,
            objectives=objectives,
            diagnostics={name: (mean, next(numbers)) for name, mean in means.items()},
            units=dict(layout.units),
        )

    def _named(self, kind: str, name: str) -> Floats:
        wanted = (kind, name)
        places = [
            len(_NUMBERS) + layout.names.index(wanted) if wanted in layout.names else -1
            for layout in self._layouts
        ]
        if not places:
            return np.empty(0)
        found = np.array(places)[np.array(self._kinds)]
        return np.where(found < 0, np.nan, self._taken(np.maximum(found, 0)))

    def _taken(self, places: npt.NDArray[np.int64]) -> Floats:
        """Return the number at a place of each evaluation."""
        return np.frombuffer(self._numbers)[np.array(self._starts, dtype=np.int64) + places]
