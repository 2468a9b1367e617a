"""What is known of a run, gathered from the tuner's topics."""

from __future__ import annotations

import math
import statistics
import time

from mobo_msgs_py.msg import Evaluation, Objective, ParetoFront, Problem, TunerStatus


class RunProgress:
    """What is known of a run, gathered from its messages.

    Attributes:
        run_id: its name; messages of other runs are left aside.
        budget: evaluations asked for; 0 until it is known.
        last: the latest evaluation.
        evaluations, failed, feasible: how many are finished, and of what kind.
        status: what the tuner said last.
        front_size: points on the Pareto front.
    """

    def __init__(self, run_id: str, budget: int = 0) -> None:
        self.run_id = run_id
        self.budget = budget
        self.last: Evaluation | None = None
        self.evaluations = 0
        self.failed = 0
        self.feasible = 0
        self.status = TunerStatus()
        self.front_size = 0
        self.started = time.monotonic()
        self._directions: dict[str, int] = {}
        self._extremes: dict[str, tuple[tuple[float, int], tuple[float, int]]] = {}
        self._suggest_seconds: list[float] = []
        self._seen: set[int] = set()

    def set_problem(self, problem: Problem) -> None:
        """Take over which objectives are maximised."""
        if problem.run_id == self.run_id:
            self._directions = {item.name: item.direction for item in problem.objectives}

    def set_status(self, status: TunerStatus) -> None:
        """Take over what the tuner does."""
        if status.run_id == self.run_id:
            self.status = status
            self.budget = status.budget or self.budget

    def set_front(self, front: ParetoFront) -> None:
        """Take over the size of the front."""
        if front.run_id == self.run_id:
            self.front_size = len(front.points)

    def add(self, evaluation: Evaluation) -> bool:
        """Take over one evaluation; return whether it is new."""
        if evaluation.run_id != self.run_id or evaluation.index in self._seen:
            return False
        self._seen.add(evaluation.index)
        self.last = evaluation
        self.evaluations += 1
        self.failed += not evaluation.valid
        self.feasible += evaluation.feasible
        self._suggest_seconds.append(evaluation.suggest_seconds)
        if evaluation.feasible:
            for item in evaluation.objectives:
                here = (item.value, evaluation.index)
                low, high = self._extremes.get(item.name, (here, here))
                self._extremes[item.name] = (min(low, here), max(high, here))
        return True

    def best(self, name: str) -> tuple[float, int] | None:
        """The best feasible value of an objective so far, and of which evaluation it is."""
        if name not in self._extremes:
            return None
        low, high = self._extremes[name]
        return high if self._directions.get(name) == Objective.MAXIMIZE else low

    @property
    def hypervolume(self) -> float:
        """Of the front after the latest evaluation."""
        return float(self.last.hypervolume) if self.last else 0.0

    @property
    def suggest_median(self) -> float:
        """Median wall time of a suggestion [s]; NaN before the first."""
        return statistics.median(self._suggest_seconds) if self._suggest_seconds else math.nan
