"""Run folders with a made-up journal, for tests of what is made of a run."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from mobo_tuner.core.problem import Problem
from mobo_tuner.runs.journal import Journal
from mobo_tuner.runs.records import StartRecord, to_json

TWO: dict[str, Any] = {
    "variables": {"x1": {"min": 0.0, "max": 4.0, "unit": "A"}},
    "objectives": {
        "f1": {"reference": 10.0, "unit": "mm"},
        "f2": {"reference": 10.0, "direction": "minimize"},
    },
    "constraints": {"f2": {"min": 1.5}},
}


def evaluation(index: int, values: dict[str, float], **fields: Any) -> dict[str, Any]:
    """A record; the uncertainty of the values is unknown."""
    return {
        "type": "evaluation",
        "index": index,
        "source": "initial" if index < 2 else "model",
        "attempts": 1,
        "stamp": 1000.0 + index,
        "setpoint": {"x1": 0.5 * index},
        "readbacks": {"x1": 0.5 * index},
        "diagnostics": {name: [value, None] for name, value in values.items()},
        "valid": True,
        "feasible": True,
        "non_dominated": False,
        "error_code": 0,
        "error_msg": "",
        "hypervolume": 10.0 * index,
        "hypervolume_measured": 9.0 * index,
        "suggest_seconds": 0.5,
        "machine_seconds": 0.25,
        "total_seconds": 0.76,
        **fields,
    }


def write_run(
    folder: Path,
    evaluations: Sequence[dict[str, Any]],
    problem: dict[str, Any] | None = None,
    end: dict[str, Any] | None = None,
    **settings: Any,
) -> Path:
    """A run folder with its journal."""
    start = StartRecord(
        "run1",
        1000.0,
        Problem.from_dict(problem or TWO),
        {"seed": 3, "preset": "default", "model_input": "setpoint", **settings},
    )
    with Journal.create(folder, [to_json(start)]) as journal:
        for record in evaluations:
            names = start.problem.setpoint_names
            if problem is not None and record["setpoint"].keys() != {*names}:
                record = record | {"setpoint": dict.fromkeys(names, 0.0)}
            journal.append(record)
        if end is not None:
            journal.append({"type": "end", "stamp": None, "error_code": 0, "error_msg": "", **end})
    return folder


def seven_objectives(folder: Path, count: int) -> Path:
    """A front of `count` points in seven objectives: all on a plane, so none is dominated.

    They are an initial design, so that seven models are trained once and not with each of the points.
    """
    names = ("sigma_x", "sigma_y", "sigma_z", "eps_x", "eps_y", "eps_z", "dE")
    problem = {
        "variables": {f"K{i}": {"min": 0.0, "max": 1.0, "unit": "A"} for i in range(6)},
        "objectives": {name: {"reference": 1500.0, "unit": "mm mrad"} for name in names},
    }
    rng = np.random.default_rng(1)
    setpoints = rng.random((count, 6))
    shares = np.exp(setpoints @ rng.normal(size=(6, len(names))))
    points = 1234.5 * shares / shares.sum(axis=1)[:, None]
    records = [
        evaluation(
            i,
            dict(zip(names, point, strict=True)),
            setpoint={f"K{j}": value for j, value in enumerate(setpoint)},
        )
        for i, (point, setpoint) in enumerate(zip(points.tolist(), setpoints.tolist(), strict=True))
    ]
    end = {"stop_reason": "budget"}
    return write_run(folder, records, problem, end, initial_evaluations=count)
