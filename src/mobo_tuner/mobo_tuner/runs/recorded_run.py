"""A run as its journal tells it: the arrays from which reports are made."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mobo_tuner.core import Optimizer, ProblemError
from mobo_tuner.core.fidelity import Spent
from mobo_tuner.core.problem import Array, Problem
from mobo_tuner.runs.history import History
from mobo_tuner.runs.journal import JournalError, JsonRecord, read_journal
from mobo_tuner.runs.records import EvaluationRecord
from mobo_tuner.runs.replay import restore
from mobo_tuner.runs.saved_state import SavedState

BoolArray = NDArray[np.bool_]

_REPLAYED = 150  # evaluations and changes that are replayed exactly, which takes some seconds
UNFINISHED = "unfinished"  # stop reason of a run without an end: it continues, or was killed


@dataclass(frozen=True)
class RecordedRun:
    """A run of n evaluations in P objectives, judged by the problem at its end.

    Attributes:
        history: What happened.
        optimizer: Optimiser as it was at the end. Without its saved state, the models of a long run are
            trained once, at the end, so that they may differ a little from those of the run. Those of a run
            with a prior model do without it: who reads a run does not run what it names.
    """

    history: History
    optimizer: Optimizer

    @classmethod
    def from_records(
        cls, records: Sequence[JsonRecord], saved: SavedState | None = None
    ) -> RecordedRun:
        """Build it from the records of a journal and the optimiser's saved state, if there is one.

        Raises:
            JournalError: If a record is not valid or the run cannot have happened.
        """
        history = History.from_records(records)
        try:
            retrain = len(history.steps) <= _REPLAYED
            return cls(history, restore(history, saved, retrain=retrain, with_prior=False))
        except ProblemError as error:
            raise JournalError(f"the run of the journal cannot have happened: {error}") from None

    @classmethod
    def load(cls, run_dir: Path) -> RecordedRun:
        """Read it from a run's folder, of which only the journal is needed.

        Raises:
            JournalError: If the journal cannot be read or is not valid.
        """
        return cls.from_records(read_journal(run_dir), SavedState.read(run_dir))

    @property
    def run_id(self) -> str:
        """Name of the run."""
        return self.history.run_id

    @property
    def problem(self) -> Problem:
        """Problem at the end, with the reference point that was inferred, if any."""
        return self.optimizer.problem

    @property
    def settings(self) -> Mapping[str, Any]:
        """Settings of the tuner."""
        return self.history.settings

    @property
    def started(self) -> float:
        """When it started [s since the epoch]; NaN if unknown."""
        return self.history.start.stamp

    @property
    def finished(self) -> float:
        """When it ended [s since the epoch]; NaN if unknown or if it did not."""
        return self.history.end.stamp if self.history.end else math.nan

    @property
    def stop_reason(self) -> str:
        """Reason of the end, as in `Tune.Result`, or ``unfinished``."""
        return self.history.end.stop_reason if self.history.end else UNFINISHED

    @property
    def error_msg(self) -> str:
        """One sentence after an error; empty otherwise."""
        return self.history.end.error_msg if self.history.end else ""

    @cached_property
    def evaluations(self) -> list[EvaluationRecord]:
        """Records of the evaluations; the index of each is its place."""
        return self.history.evaluations

    @cached_property
    def indices(self) -> NDArray[np.int64]:
        """Indices of the evaluations ``(n,)``."""
        return np.arange(len(self.evaluations))

    @cached_property
    def setpoints(self) -> Array:
        """Set-points as they were asked for, in the variables' units ``(n, d)``."""
        names = self.problem.variable_names
        rows = [[e.setpoint[name] for name in names] for e in self.evaluations]
        return np.array(rows, dtype=float).reshape(len(rows), len(names))

    @cached_property
    def objectives(self) -> Array:
        """Objectives as measured, in their own units ``(n, P)``; NaN if not measured."""
        columns = [self.readings(name)[0] for name in self.problem.objective_names]
        return np.column_stack(columns)

    def readings(self, name: str) -> tuple[Array, Array]:
        """Return means and standard deviations of a diagnostic ``(n,)``; NaN if not measured or unknown."""
        unknown = (math.nan, math.nan)
        pairs = [e.diagnostics.get(name, unknown) for e in self.evaluations]
        means, stddevs = np.array(pairs, dtype=float).reshape(len(pairs), 2).T
        return means, stddevs

    @cached_property
    def initial(self) -> BoolArray:
        """Which evaluations are of the initial design ``(n,)``."""
        return np.array([e.source == "initial" for e in self.evaluations], dtype=bool)

    @cached_property
    def valid(self) -> BoolArray:
        """Which evaluations neither failed nor were withdrawn ``(n,)``."""
        return self.optimizer.dataset.valid

    @cached_property
    def failed(self) -> BoolArray:
        """Which evaluations failed ``(n,)``."""
        return self.optimizer.dataset.failed

    @cached_property
    def withdrawn(self) -> BoolArray:
        """Which evaluations an operator withdrew as a whole ``(n,)``."""
        return self.optimizer.dataset.forgotten

    @cached_property
    def cheaper(self) -> BoolArray:
        """Which evaluations are of a lower fidelity than the highest ``(n,)``."""
        return ~self.optimizer.dataset.highest

    @cached_property
    def infeasible(self) -> BoolArray:
        """Which evaluations of the highest fidelity are incomplete or break a constraint ``(n,)``."""
        return self.valid & ~self.feasible & ~self.cheaper

    @cached_property
    def spent(self) -> list[Spent]:
        """What was evaluated at each fidelity, the cheapest first; empty without fidelities."""
        fidelity = self.problem.fidelity
        return fidelity.spent(e.setpoint for e in self.evaluations) if fidelity else []

    @cached_property
    def feasible(self) -> BoolArray:
        """Which evaluations are complete and meet every constraint ``(n,)``."""
        return self.optimizer.dataset.feasible

    @cached_property
    def pareto_front(self) -> list[dict[str, Any]]:
        """Pareto front as `Optimizer.pareto_front` gives it: readings, or the models' means."""
        return self.optimizer.pareto_front()

    @cached_property
    def front(self) -> NDArray[np.int64]:
        """Indices of the evaluations on the Pareto front ``(k,)``."""
        return np.array([point["index"] for point in self.pareto_front], dtype=np.int64)

    @cached_property
    def front_objectives(self) -> Array:
        """Objectives of the front, in their own units ``(k, P)``."""
        names = self.problem.objective_names
        rows = [[point["objectives"][name] for name in names] for point in self.pareto_front]
        return np.array(rows, dtype=float).reshape(len(rows), len(names))

    @property
    def signs(self) -> Array:
        """Factors by which the objectives are multiplied to be minimised ``(P,)``."""
        return np.array([o.sign for o in self.problem.objectives])

    @cached_property
    def is_noisy(self) -> bool:
        """Whether the hypervolume was ever not that of the readings as they are."""
        return bool((self.hypervolumes != self.hypervolumes_measured).any())

    @cached_property
    def hypervolumes(self) -> Array:
        """Hypervolume after each evaluation, as the tuner told it then ``(n,)``."""
        return self._column("hypervolume")

    @cached_property
    def hypervolumes_measured(self) -> Array:
        """Hypervolume of the complete readings after each evaluation ``(n,)``."""
        return self._column("hypervolume_measured")

    @property
    def hypervolume(self) -> float:
        """Hypervolume of the front at the end; 0 before the first evaluation."""
        if self._ends_with_evaluation:
            return float(self.hypervolumes[-1])
        return self.optimizer.hypervolume

    @property
    def hypervolume_measured(self) -> float:
        """Hypervolume of the complete readings as they are, at the end."""
        if self._ends_with_evaluation:
            return float(self.hypervolumes_measured[-1])
        return self.optimizer.hypervolume_measured

    @property
    def _ends_with_evaluation(self) -> bool:
        """Whether the last hypervolume that was told is that of the problem at the end."""
        steps = self.history.steps
        return bool(steps) and isinstance(steps[-1], EvaluationRecord)

    @cached_property
    def suggest_seconds(self) -> Array:
        """Time of each suggestion ``(n,)`` [s]."""
        return self._column("suggest_seconds")

    @cached_property
    def machine_seconds(self) -> Array:
        """Time that the machine spent on each evaluation ``(n,)`` [s]."""
        return self._column("machine_seconds")

    @property
    def overhead_seconds(self) -> Array:
        """Time of each evaluation beyond the suggestion and the machine ``(n,)`` [s]."""
        return self._column("total_seconds") - self.suggest_seconds - self.machine_seconds

    def _column(self, name: str) -> Array:
        return np.array([getattr(e, name) for e in self.evaluations], dtype=float)
