"""What happened in a run, step by step, as its journal tells it: enough to live through it again.

Nothing in a journal is trusted: what is not as it should be is named in one sentence.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from mobo_tuner.core.dataset import Measured
from mobo_tuner.core.problem import Problem, ProblemError
from mobo_tuner.runs.journal import JournalError, Record

SOURCES = ("initial", "model", "operator")
SETPOINT, READBACK = "setpoint", "readback"  # what the models of a tuner learn from
_FIGURES = ("stamp", "hypervolume", "suggest_seconds", "machine_seconds", "total_seconds")


@dataclass(frozen=True)
class Told:
    """An evaluation: where it was, where that came from, and what the optimiser was told of it.

    `readbacks` are empty where the optimiser was not told of them.
    """

    index: int
    source: str
    setpoint: Mapping[str, float]
    outputs: Mapping[str, Measured | None]
    readbacks: Mapping[str, float]


@dataclass(frozen=True)
class Changed:
    """Another problem or budget from the evaluation `index` on."""

    index: int
    problem: Problem
    budget: int


@dataclass(frozen=True)
class History:
    """A run from its start.

    Attributes:
        run_id: its name.
        problem: with which it began.
        settings: of the tuner when it began.
        steps: evaluations and changes in their order.
        waiting: set-points of operators that were not evaluated yet, in their order.
        records: of the journal that tell all this, but for the start.
    """

    run_id: str
    problem: Problem
    settings: Mapping[str, Any]
    steps: tuple[Told | Changed, ...]
    waiting: tuple[Mapping[str, float], ...]
    records: tuple[Record, ...]

    @classmethod
    def from_records(cls, records: Sequence[Record]) -> History:
        """Build it from the records of a journal; those of other kinds are passed over.

        Raises:
            JournalError: a record is not as it should be.
        """
        start = records[0]
        problem = _checked("the start record", lambda: _problem(start))
        settings = start.get("settings")
        if not isinstance(settings, dict) or not isinstance(start.get("run_id"), str):
            raise JournalError("the start record of the journal lacks run_id or settings")
        settings.setdefault("model_input", SETPOINT)  # journals before there was a choice lack it
        if settings["model_input"] not in (SETPOINT, READBACK):
            raise JournalError(
                f"model_input is {settings['model_input']!r:.40} in the start record of the journal"
            )
        history = _Builder(problem, settings["model_input"])
        kept = []
        for number, record in enumerate(records[1:], start=2):
            where = f"record {number}, {record['type']!r:.20},"
            if _checked(where, lambda r=record: history.add(r)):  # type: ignore[misc]
                kept.append(record)
        return cls(
            run_id=start["run_id"],
            problem=problem,
            settings=settings,
            steps=tuple(history.steps),
            waiting=tuple(history.waiting),
            records=tuple(kept),
        )

    @property
    def evaluations(self) -> list[Told]:
        """The evaluations in their order."""
        return [step for step in self.steps if isinstance(step, Told)]

    @property
    def changes(self) -> list[Changed]:
        """The changes in their order."""
        return [step for step in self.steps if isinstance(step, Changed)]

    @property
    def last_problem(self) -> Problem:
        """What was tuned in the end."""
        changes = self.changes
        return changes[-1].problem if changes else self.problem

    @property
    def budget(self) -> int:
        """Evaluations that were allowed in the end; 0 where that is not known."""
        changes = self.changes
        return changes[-1].budget if changes else _whole(self.settings.get("budget", 0))


def told_outputs(
    problem: Problem, diagnostics: Mapping[str, tuple[float, float]], error_code: int
) -> dict[str, Measured | None]:
    """What the diagnostics of an evaluation teach; those of a failed one teach nothing."""
    hidden = problem.required_diagnostics if error_code else ()
    return {name: pair for name, pair in diagnostics.items() if name not in hidden}


def told_readbacks(
    problem: Problem, readbacks: Mapping[str, float], model_input: str
) -> dict[str, float]:
    """What the readbacks of an evaluation teach: nothing where the models learn from set-points."""
    if model_input == SETPOINT:
        return {}
    return {name: readbacks[name] for name in problem.variable_names if name in readbacks}


class _Builder:
    """Puts steps together and checks that each follows from those before."""

    def __init__(self, problem: Problem, model_input: str) -> None:
        self.steps: list[Told | Changed] = []
        self.waiting: list[Mapping[str, float]] = []
        self._problem = problem
        self._model_input = model_input
        self._count = 0

    def add(self, record: Record) -> bool:
        """Take up one record; return whether it is of a kind that matters.

        Raises:
            ValueError, TypeError, KeyError, AttributeError, OverflowError: it cannot be right.
        """
        if record["type"] == "evaluation":
            self._add_evaluation(record)
        elif record["type"] == "change":
            self._add_change(record)
        elif record["type"] == "queued":
            self.waiting.append(self._setpoint(record))
        else:
            return False
        return True

    def _add_evaluation(self, record: Record) -> None:
        if _whole(record["index"]) != self._count:
            raise ValueError(f"its index is {record['index']!r:.20} instead of {self._count}")
        if record["source"] not in SOURCES:
            raise ValueError(f"its source is {record['source']!r:.40}")
        setpoint = self._setpoint(record)
        diagnostics = {
            _name(name): _pair(value) for name, value in _mapping(record["diagnostics"]).items()
        }
        for name in ("valid", "feasible"):
            if not isinstance(record[name], bool):
                raise ValueError(f"{name} is {record[name]!r:.40}")
        for name in _FIGURES:
            _known(record[name])
        readbacks = {name: _known(v) for name, v in _mapping(record["readbacks"]).items()}
        if not isinstance(record["error_msg"], str):
            raise ValueError(f"error_msg is {record['error_msg']!r:.40}")
        record.setdefault("attempts", 1)  # journals before it was counted lack it
        _whole(record["attempts"])
        outputs = told_outputs(self._problem, diagnostics, _whole(record["error_code"]))
        if record["source"] == "operator" and setpoint in self.waiting:
            # Those before it in the queue were dropped.
            del self.waiting[: self.waiting.index(setpoint) + 1]
        told = told_readbacks(self._problem, readbacks, self._model_input)
        self.steps.append(Told(self._count, record["source"], setpoint, outputs, told))
        self._count += 1

    def _add_change(self, record: Record) -> None:
        problem = _problem(record)
        if set(problem.variable_names) != set(self._problem.variable_names):
            raise ValueError("its variables are others than those of the start")
        if _whole(record["index"]) != self._count:
            raise ValueError(f"its index is {record['index']!r:.20} instead of {self._count}")
        self._problem = problem
        self.steps.append(Changed(self._count, problem, _whole(record["budget"])))

    def _setpoint(self, record: Record) -> dict[str, float]:
        setpoint = _mapping(record["setpoint"])
        self._problem.normalize(setpoint)
        return {name: float(value) for name, value in setpoint.items()}


def _checked(where: str, build: Callable[[], Any]) -> Any:
    try:
        return build()
    except ProblemError as error:
        raise JournalError(f"{where} of the journal is not as it should be: {error}") from None
    except (AttributeError, KeyError, OverflowError, TypeError, ValueError) as error:
        what = f"it lacks {error}" if isinstance(error, KeyError) else error
        raise JournalError(f"{where} of the journal is not as it should be: {what}") from None


def _problem(record: Record) -> Problem:
    return Problem.from_dict(record["problem"])


def _mapping(value: Any) -> Mapping[str, Any]:
    if not isinstance(value, dict):
        raise ValueError(f"{value!r:.40} stands where names and values should")
    return value


def _name(value: str) -> str:
    if len(value) > 1000:
        raise ValueError(f"the name {value[:40]!r}... is too long")
    return value


def _pair(value: Any) -> tuple[float, float]:
    """Mean and standard deviation; null stands for what is not known."""
    if not isinstance(value, list) or len(value) != 2:
        raise ValueError(f"{value!r:.40} stands where a mean and a standard deviation should")
    return _known(value[0]), _known(value[1])


def _known(value: Any) -> float:
    return math.nan if value is None else _number(value)


def _number(value: Any) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise ValueError(f"{value!r:.40} stands where a number should")
    return float(value)


def _whole(value: Any) -> int:
    if isinstance(value, bool) or not isinstance(value, int) or not 0 <= value < 2**31:
        raise ValueError(f"{value!r:.40} stands where a whole number of at least 0 should")
    return value
