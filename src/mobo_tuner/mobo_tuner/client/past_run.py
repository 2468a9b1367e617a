"""A run of the past from its folder: its problem, its evaluations and its front."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from mobo_tuner.client.values import Evaluation, Front, Point
from mobo_tuner.core.problem import Problem
from mobo_tuner.runs.history import History
from mobo_tuner.runs.journal import read_journal
from mobo_tuner.runs.records import EvaluationRecord

SUMMARY_FILE = "summary.json"


class PastRun(NamedTuple):
    """A run that nobody changes any more, or one as it is now.

    Attributes:
        problem: Problem at its end.
        evaluations: All its evaluations.
        front: Its front: that of its report, or that of the readings if it has none.
        changes: Numbers of evaluations when its problem was changed.
    """

    problem: Problem
    evaluations: list[Evaluation]
    front: Front
    changes: tuple[int, ...]


def read_run(folder: Path) -> PastRun:
    """Read a run.

    Raises:
        JournalError: If its journal cannot be read or is not valid.
    """
    history = History.from_records(read_journal(folder))
    problem = history.last_problem
    evaluations = [_evaluation(record, problem, folder.name) for record in history.evaluations]
    points = _reported(folder) or _nondominated(problem, evaluations)
    last = evaluations[-1] if evaluations else None
    return PastRun(
        problem,
        evaluations,
        Front(
            run_id=folder.name,
            points=tuple(points),
            hypervolume=last.hypervolume if last else 0.0,
            hypervolume_measured=last.hypervolume_measured if last else 0.0,
            reference_point={o.name: o.reference for o in problem.objectives},
            units=problem.units,
        ),
        tuple(_changes(history)),
    )


def _changes(history: History) -> Iterator[int]:
    """Yield how many evaluations there were when the problem was changed, not the budget alone."""
    problem = history.problem
    for change in history.changes:
        if change.problem != problem:
            yield change.index
        problem = change.problem


def _evaluation(record: EvaluationRecord, problem: Problem, run_id: str) -> Evaluation:
    unknown = (math.nan, math.nan)
    objectives = {n: record.diagnostics.get(n, unknown)[0] for n in problem.objective_names}
    return Evaluation(**vars(record), run_id=run_id, objectives=objectives, units=problem.units)


def _reported(folder: Path) -> list[Point]:
    """Return the front of the report; empty if there is none that can be read."""
    try:
        content = json.loads((folder / SUMMARY_FILE).read_text(encoding="utf-8"))
        return [
            Point(
                int(point["index"]),
                _numbers(point["setpoint"]),
                _numbers(point["objectives"]),
                _numbers(point.get("stddevs", {})),
            )
            for point in content["pareto_front"]
        ]
    except (OSError, ValueError, TypeError, KeyError, AttributeError, RecursionError):
        return []


def _numbers(values: Mapping[str, Any]) -> dict[str, float]:
    return {name: math.nan if value is None else float(value) for name, value in values.items()}


def _nondominated(problem: Problem, evaluations: list[Evaluation]) -> list[Point]:
    """Return the feasible evaluations that no other dominates."""
    feasible = [
        e
        for e in evaluations
        if e.valid
        and problem.is_feasible({name: mean for name, (mean, _) in e.diagnostics.items()})
        and all(map(math.isfinite, e.objectives.values()))
    ]
    signs = np.array([objective.sign for objective in problem.objectives])
    values = [[e.objectives[name] for name in problem.objective_names] for e in feasible]
    if not values:
        return []
    # Only here: compiled code costs a client 60 MB.
    from mobo_tuner.core.pareto import is_nondominated

    kept = is_nondominated(signs * np.array(values))
    return [
        Point(e.index, e.setpoint, e.objectives, {n: e.stddev(n) for n in e.objectives})
        for e, keep in zip(feasible, kept, strict=True)
        if keep
    ]
