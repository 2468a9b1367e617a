"""What is known of a run, gathered from what a `TunerClient` tells."""

from __future__ import annotations

import math
import statistics
import time

from mobo_tuner.client import Evaluation, Front, Status
from mobo_tuner.core.problem import Problem


class RunProgress:
    """What is known of a run.

    Attributes:
        budget: Number of evaluations asked for; 0 until it is known.
        last: Evaluation that came last; None before the first.
        evaluations: Number of finished evaluations.
        failed: Number of those that are not valid.
        feasible: Number of those that are feasible.
        status: Status that the tuner published last.
        front_size: Number of points on the Pareto front.
    """

    def __init__(self, budget: int = 0) -> None:
        self.budget = budget
        self.last: Evaluation | None = None
        self.evaluations = 0
        self.failed = 0
        self.feasible = 0
        self.status = Status("unknown")
        self.front_size = 0
        self._started = time.monotonic()
        self._maximized: set[str] = set()
        self._extremes: dict[str, tuple[tuple[float, int], tuple[float, int]]] = {}
        self._suggest_seconds: list[float] = []
        self._total_seconds: list[float] = []

    def set_problem(self, problem: Problem) -> None:
        """Take over which objectives are maximised."""
        self._maximized = {o.name for o in problem.objectives if o.direction == "maximize"}

    def set_status(self, status: Status) -> None:
        """Take over what the tuner does."""
        self.status = status
        self.budget = status.budget or self.budget

    def set_front(self, front: Front) -> None:
        """Take over the size of the front."""
        self.front_size = len(front.points)

    def add(self, evaluation: Evaluation) -> None:
        """Take over one evaluation."""
        self.last = evaluation
        self.evaluations += 1
        self.failed += not evaluation.valid
        self.feasible += evaluation.feasible
        self._suggest_seconds.append(evaluation.suggest_seconds)
        self._total_seconds.append(evaluation.total_seconds)
        if evaluation.feasible:
            for name, value in evaluation.objectives.items():
                here = (value, evaluation.index)
                low, high = self._extremes.get(name, (here, here))
                self._extremes[name] = (min(low, here), max(high, here))

    def best(self, name: str) -> tuple[float, int] | None:
        """Return the best feasible value of an objective and the index of its evaluation."""
        if name not in self._extremes:
            return None
        low, high = self._extremes[name]
        return high if name in self._maximized else low

    @property
    def hypervolume(self) -> float:
        """Hypervolume of the front after the latest evaluation."""
        return self.last.hypervolume if self.last else 0.0

    @property
    def suggest_median(self) -> float:
        """Median wall time of a suggestion [s]; NaN before the first."""
        return _median(self._suggest_seconds)

    @property
    def seconds(self) -> float:
        """Time since the run was first shown [s]."""
        return time.monotonic() - self._started

    @property
    def seconds_left(self) -> float:
        """Time that the rest of the budget will take [s]; NaN before the first evaluation."""
        return max(self.budget - self.evaluations, 0) * _median(self._total_seconds)


def _median(values: list[float]) -> float:
    return statistics.median(values) if values else math.nan
