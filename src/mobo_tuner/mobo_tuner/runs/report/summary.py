"""What came out of a run, as numbers: `summary.json`, and the points of the front worth showing."""

from __future__ import annotations

import math
from datetime import UTC, datetime
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mobo_tuner.core.problem import Array
from mobo_tuner.runs.recorded_run import RecordedRun


class Recommendation(NamedTuple):
    """A point of the front that is recommended, and why.

    Attributes:
        row: Its place in the front.
        reasons: What it is: "balanced", "knee", "best NAME".
    """

    row: int
    reasons: tuple[str, ...]


def summarize(run: RecordedRun) -> dict[str, Any]:
    """Return what `summary.json` holds; null stands for what is not known."""
    objectives = run.problem.objectives
    return {
        "run_id": run.run_id,
        "started": timestamp(run.started),
        "finished": timestamp(run.finished),
        "preset": run.settings.get("preset"),
        "seed": run.settings.get("seed"),
        "stop_reason": run.stop_reason,
        "error_msg": run.error_msg,
        "evaluations": len(run.indices),
        "failed": int(np.count_nonzero(run.failed)),
        "feasible": int(np.count_nonzero(run.feasible)),
        "hypervolume": _finite(run.hypervolume),
        "hypervolume_measured": _finite(run.hypervolume_measured),
        "reference_point": {o.name: _finite(o.reference) for o in objectives},
        "units": {v.name: v.unit for v in run.problem.variables}
        | {o.name: o.unit for o in objectives},
        "seconds": {
            # A point of the initial design costs nothing; only the model's suggestions tell something.
            "suggest_median": _median(
                run.suggest_seconds if run.initial.all() else run.suggest_seconds[~run.initial]
            ),
            "evaluate_median": _median(run.machine_seconds),
            "overhead_median": _median(run.overhead_seconds),
        },
        "pareto_front": [
            point
            | {
                "objectives": _finite_values(point["objectives"]),
                "stddevs": _finite_values(point["stddevs"]),
            }
            | ({"chosen": chosen} if (chosen := run.problem.chosen(point["setpoint"])) else {})
            for point in run.pareto_front
        ],
        **({"fidelities": [spent._asdict() for spent in run.spent]} if run.spent else {}),
    }


def choose_points(run: RecordedRun, limit: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the points of the front to show: the most balanced ones, and those best in one objective.

    A point is the more balanced, the smaller its worst objective is on the scale on which the best
    of the front is 0 and the reference is 1.

    Returns:
        Indices of evaluations: the balanced ones, from the most to the least; the extremes that are
        not among them, in the objectives' order. A front of at most `limit` points is all there.
    """
    rows = run.front
    minimised = run.front_objectives * run.signs
    order = rows[np.argsort(_worst_shares(run), kind="stable")]
    if len(rows) <= limit:
        return order, rows[:0]
    extremes = np.array(list(dict.fromkeys(rows[minimised.argmin(axis=0)])))
    count = max(limit - len(extremes), 1)
    balanced = np.array([row for row in order if row not in extremes][:count])
    return balanced, extremes


def recommend(run: RecordedRun) -> list[Recommendation]:
    """Return the most balanced point of the front, its knee, and the best point of each objective.

    The balanced point is that of `choose_points`. The knee lies farthest from the plane through the
    best values of the objectives, each scaled to 0 at the front's best and 1 at its worst.

    Returns:
        Each point once, with all that it is; empty if there is no front.
    """
    if not len(run.front):
        return []
    minimised = run.front_objectives * run.signs
    ideal, worst = minimised.min(axis=0), minimised.max(axis=0)
    width = np.where(worst > ideal, worst - ideal, 1.0)
    chosen: dict[int, list[str]] = {int(_worst_shares(run).argmin()): ["balanced"]}
    if len(run.front) > 2 and len(ideal) > 1:
        knee = int(((minimised - ideal) / width).sum(axis=1).argmin())
        chosen.setdefault(knee, []).append("knee")
    for name, row in zip(run.problem.objective_names, minimised.argmin(axis=0), strict=True):
        chosen.setdefault(int(row), []).append(f"best {name}")
    return [Recommendation(row, tuple(reasons)) for row, reasons in chosen.items()]


def timestamp(seconds: float) -> str | None:
    """Return a time in UTC as text; None for one that is unknown or in no year that there is."""
    if not math.isfinite(seconds):
        return None
    try:
        return datetime.fromtimestamp(seconds, UTC).isoformat(timespec="seconds")
    except (OSError, OverflowError, ValueError):
        return None


def _worst_shares(run: RecordedRun) -> Array:
    """Return the worst objective of each point of the front, from the front's best to the reference."""
    minimised = run.front_objectives * run.signs
    if not len(minimised):
        return np.empty(0)
    ideal = minimised.min(axis=0)
    shares: Array = ((minimised - ideal) / (run.problem.reference_point - ideal)).max(axis=1)
    return shares


def _median(values: Array) -> float | None:
    known = values[np.isfinite(values)]
    return float(np.median(known)) if len(known) else None


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None


def _finite_values(values: dict[str, float]) -> dict[str, float | None]:
    return {name: _finite(value) for name, value in values.items()}
