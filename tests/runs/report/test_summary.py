"""The summary: whatever the run was, strict JSON with the right numbers."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mobo_tuner.core import Optimizer, Problem
from mobo_tuner.runs.recorded_run import RecordedRun
from mobo_tuner.runs.report.command import write_report
from mobo_tuner.runs.report.summary import choose_points, recommend
from tests.support.run_folders import TWO, evaluation, write_run


def summary_of(folder: Path) -> dict[str, Any]:
    """The summary that is written, which must be strict JSON."""
    write_report(folder)

    def refuse(constant: str) -> None:
        raise AssertionError(constant)

    summary: dict[str, Any] = json.loads(
        (folder / "summary.json").read_text(encoding="utf-8"), parse_constant=refuse
    )
    return summary


def test_the_summary(mixed: Path) -> None:
    summary = summary_of(mixed)
    front = summary.pop("pareto_front")
    seconds = summary.pop("seconds")
    assert summary == {
        "run_id": "run1",
        "started": "1970-01-01T00:16:40+00:00",
        "finished": "1970-01-01T00:33:20+00:00",
        "preset": "default",
        "seed": 3,
        "stop_reason": "budget",
        "error_msg": "",
        "evaluations": 8,
        "failed": 1,
        "feasible": 6,
        "hypervolume": 70.0,
        "hypervolume_measured": 63.0,
        "reference_point": {"f1": 10.0, "f2": 10.0},
        "units": {"x1": "A", "f1": "mm", "f2": ""},
    }
    certain: dict[str, Any] = {
        "probability": 1.0,
        "stddevs": {"f1": 0.0, "f2": 0.0},
        "predicted": [],
    }
    assert front == [
        {"index": 0, "setpoint": {"x1": 0.0}, "objectives": {"f1": 5.0, "f2": 5.0}, **certain},
        {"index": 2, "setpoint": {"x1": 1.0}, "objectives": {"f1": 2.0, "f2": 8.0}, **certain},
        {"index": 6, "setpoint": {"x1": 3.0}, "objectives": {"f1": 8.0, "f2": 2.0}, **certain},
    ]
    assert seconds == pytest.approx(
        {"suggest_median": 0.5, "evaluate_median": 0.25, "overhead_median": 0.01}
    )


def test_maximised_objectives_are_reported_in_their_own_sense(tmp_path: Path) -> None:
    problem = {
        "variables": {"x1": {"min": 0.0, "max": 4.0}},
        "objectives": {
            "loss": {"reference": 10.0},
            "yield": {"reference": 0.0, "direction": "maximize", "unit": "nC"},
        },
    }
    values = [(5.0, 3.0), (4.0, 1.0), (6.0, 2.0), (1.0, -1.0)]
    folder = write_run(
        tmp_path,
        [evaluation(i, {"loss": a, "yield": b}) for i, (a, b) in enumerate(values)],
        problem,
        {"stop_reason": "budget"},
    )
    summary = summary_of(folder)
    assert [point["index"] for point in summary["pareto_front"]] == [0, 1]
    assert summary["pareto_front"][0]["objectives"] == {"loss": 5.0, "yield": 3.0}
    assert summary["reference_point"] == {"loss": 10.0, "yield": 0.0}
    assert summary["finished"] is None


def test_a_run_without_evaluations_and_without_end(tmp_path: Path) -> None:
    folder = write_run(tmp_path, [])
    summary = summary_of(folder)
    assert summary["evaluations"] == summary["failed"] == summary["feasible"] == 0
    assert summary["hypervolume"] == 0.0
    assert summary["stop_reason"] == "unfinished"
    assert summary["finished"] is None
    assert summary["pareto_front"] == []
    assert set(summary["seconds"].values()) == {None}


def test_a_run_in_which_everything_failed(tmp_path: Path) -> None:
    failed = {"valid": False, "feasible": False, "hypervolume": 0.0, "error_code": 4}
    folder = write_run(
        tmp_path,
        [
            evaluation(0, {}, **failed, diagnostics={}),
            evaluation(1, {"f1": math.nan, "f2": math.nan}, **failed, machine_seconds=math.nan),
        ],
        end={"stop_reason": "error", "error_code": 4, "error_msg": "2 evaluations failed in a row"},
    )
    summary = summary_of(folder)
    assert (summary["evaluations"], summary["failed"], summary["feasible"]) == (2, 2, 0)
    assert summary["error_msg"] == "2 evaluations failed in a row"
    assert summary["seconds"]["evaluate_median"] == 0.25


def test_a_single_objective(tmp_path: Path) -> None:
    problem = {"variables": TWO["variables"], "objectives": {"f1": {"reference": 10.0}}}
    folder = write_run(
        tmp_path,
        [evaluation(i, {"f1": value}) for i, value in enumerate([7.0, 3.0, 5.0])],
        problem,
        {"stop_reason": "hypervolume_goal"},
    )
    assert [point["index"] for point in summary_of(folder)["pareto_front"]] == [1]


def test_the_most_balanced_point_comes_first(tmp_path: Path) -> None:
    values = [(1.0, 9.0), (9.0, 1.6), (4.0, 4.5), (2.0, 8.0)]
    folder = write_run(
        tmp_path, [evaluation(i, {"f1": a, "f2": b}) for i, (a, b) in enumerate(values)]
    )
    run = RecordedRun.load(folder)
    balanced, extremes = choose_points(run, 3)
    assert balanced.tolist() == [2]
    assert extremes.tolist() == [0, 1]


def test_a_report_can_be_made_again(mixed: Path) -> None:
    first = summary_of(mixed)
    assert summary_of(mixed) == first


@pytest.mark.parametrize(("count", "replayed"), [(12, True), (160, False)])
def test_the_summary_holds_what_is_believed_of_noisy_or_missing_readings(
    tmp_path: Path, count: int, replayed: bool
) -> None:
    """Without its saved state, a short run is replayed, and the models of a long one are trained once."""
    rng = np.random.default_rng(4)
    records = []
    for index, x in enumerate(np.linspace(0.0, 4.0, count)):
        values = {"f1": 1.0 + x, "f2": 8.0 - 1.5 * x + 0.1 * float(rng.normal())}
        if index == 5:
            del values["f2"]
        told = {name: (value, 0.1) for name, value in values.items()}
        records.append(evaluation(index, {}, setpoint={"x1": float(x)}, diagnostics=told))
    summary = summary_of(write_run(tmp_path, records))
    optimizer = Optimizer(Problem.from_dict(TWO), seed=3)
    for record in records:
        if replayed:
            optimizer.catch_up()
        optimizer.tell(record["setpoint"], record["diagnostics"])
    assert summary["pareto_front"] == optimizer.pareto_front()
    predicted = {point["index"]: point["predicted"] for point in summary["pareto_front"]}
    assert predicted.pop(5, ["f2"]) == ["f2"]
    assert not any(predicted.values())
    assert all(point["stddevs"]["f2"] > 0.0 for point in summary["pareto_front"])


def test_balanced_knee_and_extremes_are_recommended_once_each(tmp_path: Path) -> None:
    values = [(1.0, 9.0), (9.0, 1.6), (2.0, 2.5), (3.0, 2.3), (1.5, 6.0)]
    run = RecordedRun.load(
        write_run(tmp_path, [evaluation(i, {"f1": a, "f2": b}) for i, (a, b) in enumerate(values)])
    )
    found = {int(run.front[r.row]): r.reasons for r in recommend(run)}
    assert found == {2: ("balanced", "knee"), 0: ("best f1",), 1: ("best f2",)}
