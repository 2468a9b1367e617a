"""What came out of a run, as numbers: `summary.json`, and the points of the front worth showing."""

from __future__ import annotations

import math
from datetime import UTC, datetime
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mobo_tuner.core.problem import Array
from mobo_tuner.runs.recorded_run import RecordedRun


def summarize(run: RecordedRun) -> dict[str, Any]:
    """What `summary.json` holds; null stands for what is not known."""
    objectives = run.problem.objectives
    return {
        "run_id": run.run_id,
        "started": _timestamp(run.started),
        "finished": _timestamp(run.finished),
        "preset": run.settings.get("preset"),
        "seed": run.settings.get("seed"),
        "stop_reason": run.stop_reason,
        "error_msg": run.error_msg,
        "evaluations": len(run.indices),
        "failed": int(np.count_nonzero(~run.valid)),
        "feasible": int(np.count_nonzero(run.feasible)),
        "hypervolume": _finite(run.hypervolume),
        "reference_point": {o.name: o.reference for o in objectives},
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
            {
                "index": int(run.indices[row]),
                "setpoint": dict(run.setpoints[row]),
                "objectives": {
                    o.name: float(value)
                    for o, value in zip(objectives, run.objectives[row], strict=True)
                },
            }
            for row in run.front
        ],
    }


def choose_points(run: RecordedRun, limit: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """The points of the front to show: the most balanced ones, and those best in one objective.

    A point is the more balanced, the smaller its worst objective is on the scale on which the best
    of the front is 0 and the reference is 1.

    Returns:
        Rows of the run: the balanced ones, from the most to the least; the extremes that are not
        among them, in the objectives' order. A front of at most `limit` points is all there.
    """
    rows = run.front
    minimised = run.objectives[rows] * run.signs
    ideal = minimised.min(axis=0)
    worst = ((minimised - ideal) / (run.problem.reference_point - ideal)).max(axis=1)
    order = rows[np.argsort(worst, kind="stable")]
    if len(rows) <= limit:
        return order, rows[:0]
    extremes = np.array(list(dict.fromkeys(rows[minimised.argmin(axis=0)])))
    count = max(limit - len(extremes), 1)
    balanced = np.array([row for row in order if row not in extremes][:count])
    return balanced, extremes


def _median(values: Array) -> float | None:
    known = values[np.isfinite(values)]
    return float(np.median(known)) if len(known) else None


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None


def _timestamp(seconds: float) -> str | None:
    if not math.isfinite(seconds):
        return None
    try:
        return datetime.fromtimestamp(seconds, UTC).isoformat(timespec="seconds")
    except (OSError, OverflowError, ValueError):  # in no year that there is
        return None
