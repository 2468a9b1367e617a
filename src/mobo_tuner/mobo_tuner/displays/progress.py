"""What is known of a run, gathered from what a `TunerClient` tells."""

from __future__ import annotations

import math
import time

import numpy as np

from mobo_tuner.client import Evaluation, Front, Status
from mobo_tuner.core.problem import Problem
from mobo_tuner.displays.evaluations import EvaluationTable, Flags, Floats


class RunProgress:
    """What is known of a run.

    Attributes:
        budget: Number of evaluations asked for; 0 until it is known.
        last: Evaluation that came last; None before the first.
        made: All evaluations, in the order of their arrival.
        status: Status that the tuner published last.
    """

    def __init__(self, budget: int = 0) -> None:
        self.budget = budget
        self.last: Evaluation | None = None
        self.made = EvaluationTable()
        self.status = Status("unknown")
        self._front_size = 0
        self._ranges: dict[str, tuple[float, float]] = {}
        self._started = time.monotonic()
        self._problem: Problem | None = None

    def set_problem(self, problem: Problem) -> None:
        """Take over what is tuned, by which all evaluations so far are judged again."""
        self._problem = problem

    def set_status(self, status: Status) -> None:
        """Take over what the tuner does."""
        self.status = status
        self.budget = status.budget or self.budget

    def set_front(self, front: Front) -> None:
        """Take over the size of the front, and its extremes."""
        self._front_size = len(front.points)
        self._ranges.clear()
        for name in front.points[0].objectives if front.points else ():
            values = [p.objectives.get(name, math.nan) for p in front.points]
            known = [value for value in values if math.isfinite(value)]
            if known:
                self._ranges[name] = min(known), max(known)

    def add(self, evaluation: Evaluation) -> None:
        """Take over one evaluation."""
        self.last = evaluation
        self.made.add(evaluation)

    def best(self, name: str) -> tuple[float, int] | None:
        """Return the best feasible value of an objective and the index of its evaluation."""
        values = self.made.objectives(name)
        values = np.where(self.is_feasible & np.isfinite(values), values, math.nan)
        if np.isnan(values).all():
            return None
        objectives = () if self._problem is None else self._problem.objectives
        sign = next((o.sign for o in objectives if o.name == name), 1.0)
        place = int(np.nanargmin(sign * values))
        return float(values[place]), int(self.made.numbers("index")[place])

    @property
    def evaluations(self) -> int:
        """Number of finished evaluations."""
        return len(self.made)

    @property
    def goals(self) -> dict[str, float]:
        """Values that are good enough, by objective; those without one are left out."""
        objectives = () if self._problem is None else self._problem.objectives
        return {o.name: o.goal for o in objectives if o.goal is not None}

    def is_reached(self, name: str) -> bool:
        """Return whether the best feasible value of an objective is good enough."""
        best = self.best(name)
        objectives = () if self._problem is None else self._problem.objectives
        return best is not None and any(
            o.sign * best[0] <= o.sign * o.goal
            for o in objectives
            if o.name == name and o.goal is not None
        )

    def front_range(self, name: str) -> tuple[float, float] | None:
        """Return the least and the greatest value of an objective on the front; None without one."""
        return self._ranges.get(name)

    @property
    def hypervolumes(self) -> list[float]:
        """Hypervolume after each evaluation."""
        return [*map(float, self.made.numbers("hypervolume"))]

    @property
    def failed(self) -> int:
        """Number of evaluations that failed, by the problem as it is now."""
        if self._is_current:
            return self.status.failed
        return int(np.sum(self.made.numbers("valid") == 0.0))

    @property
    def feasible(self) -> int:
        """Number of evaluations that are feasible, by the problem as it is now."""
        if self._is_current:
            return self.status.feasible
        return int(np.sum(self.is_feasible))

    @property
    def is_feasible(self) -> Flags:
        """Which evaluations are feasible, by the problem as it is now, shape (n,)."""
        made, problem = self.made, self._problem
        if not len(made):
            return np.zeros(0, dtype=bool)
        if problem is None:
            return made.numbers("feasible") > 0.0
        found = made.numbers("valid") > 0.0
        for name in problem.objective_names:
            found &= np.isfinite(made.objectives(name))
        for constraint in problem.constraints:
            values = made.diagnostics(constraint.name)
            found &= (values >= constraint.minimum) & (values <= constraint.maximum)
        return found

    @property
    def hypervolume(self) -> float:
        """Hypervolume of the front, by the problem as it is now."""
        if self._is_current:
            return self.status.hypervolume
        return self.last.hypervolume if self.last else 0.0

    @property
    def front_size(self) -> int:
        """Number of points on the Pareto front."""
        return self.status.front_size if self._is_current else self._front_size

    @property
    def suggest_median(self) -> float:
        """Median wall time of a suggestion [s]; NaN before the first."""
        return _median(self.made.numbers("suggest_seconds"))

    @property
    def seconds(self) -> float:
        """Time since the run was first shown [s]."""
        return time.monotonic() - self._started

    @property
    def seconds_left(self) -> float:
        """Time that the rest of the budget will take [s]; NaN before the first evaluation."""
        return max(self.budget - self.evaluations, 0) * _median(self.made.numbers("total_seconds"))

    @property
    def _is_current(self) -> bool:
        """Whether the status counts all evaluations that are known here."""
        return bool(self.status.run_id) and self.status.evaluations >= self.evaluations


def _median(values: Floats) -> float:
    return float(np.median(values)) if len(values) else math.nan


def contexts_text(status: Status) -> str:
    """Return the last readings of the contexts in one line; empty if there are none."""
    texts = []
    for context in status.contexts:
        text = f"{context.name} {context.value:.4g} {context.unit}".rstrip()
        if math.isnan(context.value):
            text = f"{context.name} not measured yet"
        elif context.stale:
            text += " (stale)"
        texts.append(text)
    return "; ".join(texts)
