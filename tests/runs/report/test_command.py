"""The report: a summary, two pictures and a table, whatever the run was."""

from __future__ import annotations

import itertools
import json
import math
from collections.abc import Sequence
from io import StringIO
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rich.console import Console
from scipy.integrate import trapezoid
from scipy.stats import spearmanr

from mobo_tuner.core.problem import Problem
from mobo_tuner.runs.journal import FILE_NAME, Journal, JournalError, read_journal
from mobo_tuner.runs.recorded_run import RecordedRun
from mobo_tuner.runs.records import StartRecord, to_json
from mobo_tuner.runs.report import command as report
from mobo_tuner.runs.report.figures import (
    conflicting_pair,
    front_figure,
    hypervolume_figure,
    product_of_units,
    staircase,
)
from mobo_tuner.runs.report.summary import choose_points

PNG = b"\x89PNG\r\n\x1a\n"

TWO = {
    "variables": {"x1": {"min": 0.0, "max": 4.0, "unit": "A"}},
    "objectives": {
        "f1": {"reference": 10.0, "unit": "mm"},
        "f2": {"reference": 10.0, "direction": "minimize"},
    },
}


def evaluation(index: int, values: dict[str, float], **fields: Any) -> dict[str, Any]:
    """A record; every value has the same uncertainty."""
    return {
        "type": "evaluation",
        "index": index,
        "source": "initial" if index < 2 else "model",
        "attempts": 1,
        "stamp": 1000.0 + index,
        "setpoint": {"x1": 0.5 * index},
        "readbacks": {"x1": 0.5 * index},
        "diagnostics": {name: [value, 0.1] for name, value in values.items()},
        "valid": True,
        "feasible": True,
        "non_dominated": False,
        "error_code": 0,
        "error_msg": "",
        "hypervolume": 10.0 * index,
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
) -> Path:
    """A run folder with its journal."""
    start = StartRecord(
        "run1",
        1000.0,
        Problem.from_dict(problem or TWO),
        {"seed": 3, "preset": "default", "model_input": "setpoint"},
    )
    with Journal.create(folder, [to_json(start)]) as journal:
        for record in evaluations:
            if problem is not None:  # the set-points of `evaluation` are those of TWO
                names = [v.name for v in start.problem.variables]
                record = record | {"setpoint": dict.fromkeys(names, 0.0)}
            journal.append(record)
        if end is not None:
            journal.append({"type": "end", "stamp": None, "error_code": 0, "error_msg": "", **end})
    return folder


def table_of(folder: Path, width: int = 100) -> str:
    """What is printed of a run."""
    out = StringIO()
    run = RecordedRun.from_records(read_journal(folder))
    report.print_report(run, Console(file=out, width=width))
    return out.getvalue()


def summary_of(folder: Path) -> dict[str, Any]:
    """The summary that is written, which must be strict JSON."""
    report.write_report(folder)

    def refuse(constant: str) -> None:
        raise AssertionError(constant)

    summary: dict[str, Any] = json.loads(
        (folder / "summary.json").read_text(encoding="utf-8"), parse_constant=refuse
    )
    return summary


@pytest.fixture
def mixed(tmp_path: Path) -> Path:
    """Eight evaluations of all kinds, ended by the budget."""
    return write_run(
        tmp_path / "run1",
        [
            evaluation(0, {"f1": 5.0, "f2": 5.0}),
            evaluation(1, {"f1": math.nan, "f2": 1.0}, valid=False, feasible=False),
            evaluation(2, {"f1": 2.0, "f2": 8.0}),
            evaluation(3, {"f1": 6.0, "f2": 6.0}),  # dominated
            evaluation(4, {"f1": 1.0, "f2": 1.0}, feasible=False),
            evaluation(5, {"f1": 0.5, "f2": 10.0}),  # not better than the reference
            evaluation(6, {"f1": 8.0, "f2": 2.0}, suggest_seconds=0.7, total_seconds=0.97),
            evaluation(7, {"f1": 5.0, "f2": 5.0}),  # a repetition
        ],
        end={"stop_reason": "budget", "stamp": 2000.0},
    )


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
        "reference_point": {"f1": 10.0, "f2": 10.0},
        "units": {"x1": "A", "f1": "mm", "f2": ""},
    }
    assert front == [
        {"index": 0, "setpoint": {"x1": 0.0}, "objectives": {"f1": 5.0, "f2": 5.0}},
        {"index": 2, "setpoint": {"x1": 1.0}, "objectives": {"f1": 2.0, "f2": 8.0}},
        {"index": 6, "setpoint": {"x1": 3.0}, "objectives": {"f1": 8.0, "f2": 2.0}},
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
    text = table_of(folder)
    assert "3*" in text
    assert "4*" in text


def test_a_run_without_evaluations_and_without_end(tmp_path: Path) -> None:
    folder = write_run(tmp_path, [])
    summary = summary_of(folder)
    assert summary["evaluations"] == summary["failed"] == summary["feasible"] == 0
    assert summary["hypervolume"] == 0.0
    assert summary["stop_reason"] == "unfinished"
    assert summary["finished"] is None
    assert summary["pareto_front"] == []
    assert set(summary["seconds"].values()) == {None}
    assert "The Pareto front is empty" in table_of(folder)


def test_a_run_in_which_everything_failed(tmp_path: Path) -> None:
    failed = {"valid": False, "feasible": False, "hypervolume": 0.0}
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
    assert "2 evaluations failed in a row" in table_of(folder)


def test_a_single_objective(tmp_path: Path) -> None:
    problem = {"variables": TWO["variables"], "objectives": {"f1": {"reference": 10.0}}}
    folder = write_run(
        tmp_path,
        [evaluation(i, {"f1": value}) for i, value in enumerate([7.0, 3.0, 5.0])],
        problem,
        {"stop_reason": "hypervolume_goal"},
    )
    assert [point["index"] for point in summary_of(folder)["pareto_front"]] == [1]


def test_the_front_of_two_has_the_right_names_units_and_steps(mixed: Path) -> None:
    figure = front_figure(RecordedRun.from_records(read_journal(mixed)))
    axes = figure.axes[0]
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("f1 [mm]", "f2")
    steps = next(line for line in axes.lines if line.get_label() == "front")
    assert np.asarray(steps.get_xydata()).tolist() == [
        [2.0, 10.0], [2.0, 8.0], [5.0, 8.0], [5.0, 5.0], [8.0, 5.0], [8.0, 2.0], [10.0, 2.0]
    ]  # fmt: skip


def test_the_front_is_shown_in_the_plane_of_the_objectives_that_conflict_most(
    tmp_path: Path,
) -> None:
    objectives = {
        name: {"reference": 10.0, "unit": unit}
        for name, unit in (("sigma_x", "mm"), ("eps_x", "mm mrad"), ("dE", "MeV"))
    }
    problem = {"variables": TWO["variables"], "objectives": objectives}
    problem["constraints"] = {"dE": {"max": 5.0}}
    folder = write_run(
        tmp_path,
        [
            evaluation(i, {"sigma_x": x, "eps_x": 1.0 + i, "dE": 4.0 - i})
            for i, x in enumerate([3.0, 1.0, 2.0])
        ],
        problem,
    )
    axes = front_figure(RecordedRun.from_records(read_journal(folder))).axes[0]
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("eps_x [mm mrad]", "dE [MeV]")
    assert "limit of dE" in axes.get_legend_handles_labels()[1]


def test_the_pair_that_conflicts_most_against_scipy() -> None:
    rng = np.random.default_rng(3)
    for _ in range(20):
        front = rng.normal(size=(30, 4)) @ rng.normal(size=(4, 5))
        pairs = list(itertools.combinations(range(5), 2))
        correlations = [spearmanr(front[:, i], front[:, j])[0] for i, j in pairs]
        assert conflicting_pair(front) == pairs[int(np.argmin(correlations))]
    front[:, 0] = np.nan
    assert 0 not in conflicting_pair(front)
    assert conflicting_pair(front[:2]) == (0, 1)


def test_the_hypervolume_is_shown_with_failures_and_the_product_of_units(mixed: Path) -> None:
    axes = hypervolume_figure(RecordedRun.from_records(read_journal(mixed))).axes[0]
    assert axes.get_ylabel() == "hypervolume [mm]"
    (line,) = axes.lines
    assert np.asarray(line.get_ydata()).tolist() == [10.0 * i for i in range(8)]
    labels = axes.get_legend_handles_labels()[1]
    assert {"initial design", "failed", "infeasible"} <= set(labels)


@pytest.mark.parametrize(
    ("units", "product"),
    [
        (["mm", "mm", "mm mrad", "mm mrad", "MeV"], "mm² (mm mrad)² MeV"),
        (["", "nC", ""], "nC"),
        (["", ""], ""),
        (["mm mrad", "MV/m"], "mm mrad MV/m"),
    ],
)
def test_the_unit_of_a_product(units: list[str], product: str) -> None:
    assert product_of_units(units) == product


def test_the_staircase_bounds_the_dominated_area() -> None:
    rng = np.random.default_rng(5)
    x = np.sort(rng.random(6))
    points = np.column_stack([x, np.sort(rng.random(6))[::-1]])[rng.permutation(6)]
    reference = np.array([1.2, 1.3])
    corners = staircase(points, reference)
    assert corners.shape == (13, 2)
    area = -trapezoid(corners[:, 1] - reference[1], corners[:, 0])
    grid = (rng.random((20_000, 2))) * reference
    dominated = (points[None] <= grid[:, None]).all(axis=2).any(axis=1)
    assert area == pytest.approx(dominated.mean() * reference.prod(), abs=0.02)


def seven_objectives(folder: Path, count: int) -> Path:
    """A front of `count` points in seven objectives: all on a plane, so none is dominated."""
    names = ("sigma_x", "sigma_y", "sigma_z", "eps_x", "eps_y", "eps_z", "dE")
    problem = {
        "variables": {f"K{i}": {"min": 0.0, "max": 1.0, "unit": "A"} for i in range(6)},
        "objectives": {name: {"reference": 1500.0, "unit": "mm mrad"} for name in names},
    }
    points = np.random.default_rng(1).dirichlet(np.ones(len(names)), count) * 1234.5
    records = [
        evaluation(i, dict(zip(names, map(float, point), strict=True)))
        for i, point in enumerate(points)
    ]
    return write_run(folder, records, problem, {"stop_reason": "budget"})


@pytest.mark.parametrize("count", [40, 5])
def test_the_table_of_seven_objectives_fits_into_100_columns(tmp_path: Path, count: int) -> None:
    folder = seven_objectives(tmp_path, count)
    text = table_of(folder)
    lines = text.splitlines()
    assert max(map(len, lines)) <= 100
    assert "…" not in text, "a cell was cut"
    rows = [line for line in lines if line.strip() and line.split()[0].isdigit()]
    assert len(rows) == min(count, report.SHOWN_POINTS)
    assert text.count("*") == 7 + 1  # one per objective, and the legend
    hidden = count - len(rows)
    assert (f"{hidden} more points" in text) == (hidden > 0)
    shown = {int(row.split()[0]) for row in rows}
    run = RecordedRun.from_records(read_journal(folder))
    assert shown >= {int(run.objectives[:, j].argmin()) for j in range(7)}


def test_the_most_balanced_point_comes_first(tmp_path: Path) -> None:
    values = [(1.0, 9.0), (9.0, 1.0), (4.0, 4.5), (2.0, 8.0)]
    folder = write_run(
        tmp_path, [evaluation(i, {"f1": a, "f2": b}) for i, (a, b) in enumerate(values)]
    )
    run = RecordedRun.from_records(read_journal(folder))
    balanced, extremes = choose_points(run, 3)
    assert balanced.tolist() == [2]
    assert extremes.tolist() == [0, 1]


def test_the_command_writes_everything_and_prints_the_table(
    mixed: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert report.main([str(mixed)]) == 0
    assert "3 points on the Pareto front" in capsys.readouterr().out
    for name in ("hypervolume.png", "front.png"):
        assert (mixed / name).read_bytes().startswith(PNG)
    names = {path.name for path in mixed.iterdir()}
    assert names == {FILE_NAME, "summary.json", "hypervolume.png", "front.png"}


def test_a_report_can_be_made_again(mixed: Path) -> None:
    first = summary_of(mixed)
    assert summary_of(mixed) == first


def test_a_folder_without_a_journal_is_one_sentence(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert report.main([str(tmp_path)]) == 1
    error = capsys.readouterr().err
    assert error.startswith("the journal '")
    assert error.count("\n") == 1
    assert list(tmp_path.iterdir()) == []


def test_a_summary_that_cannot_be_written_is_one_sentence(
    mixed: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (mixed / "summary.json").mkdir()
    assert report.main([str(mixed)]) == 1
    assert capsys.readouterr().err == (
        f"the report cannot be written to '{mixed}': Is a directory\n"
    )
    assert not list(mixed.glob(".*")), "a temporary file was left"


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        ({"hypervolume": "much"}, "hypervolume is not valid: 'much'"),
        ({"setpoint": None}, None),
        ({"diagnostics": None}, "diagnostics is not valid: None"),
    ],
)
def test_a_record_that_is_not_as_it_should_be(
    tmp_path: Path, damage: dict[str, Any], message: str | None
) -> None:
    record = evaluation(0, {"f1": 1.0, "f2": 1.0}) | damage
    folder = write_run(tmp_path, [record])
    if message is None:
        record.pop("setpoint")
        (folder / FILE_NAME).unlink()
        write_run(folder, [record])
        message = "lacks 'setpoint'"
    with pytest.raises(JournalError, match=message):
        report.write_report(folder)


def test_a_start_without_a_problem(tmp_path: Path) -> None:
    Journal.create(
        tmp_path, [{"type": "start", "version": 1, "run_id": "r", "problem": {}}]
    ).close()
    with pytest.raises(JournalError, match="record 1, 'start', of the journal is not valid"):
        report.write_report(tmp_path)
