"""The command that makes a report: its files, its table, and what it says of a broken journal."""

from __future__ import annotations

from io import StringIO
from pathlib import Path
from typing import Any

import pytest
from rich.console import Console

from mobo_tuner.runs.journal import COUNT_FILE_NAME, FILE_NAME, Journal, JournalError
from mobo_tuner.runs.recorded_run import RecordedRun
from mobo_tuner.runs.report import command as report
from tests.support.run_folders import evaluation, seven_objectives, write_run

PNG = b"\x89PNG\r\n\x1a\n"


def table_of(folder: Path, width: int = 100) -> str:
    """What is printed of a run."""
    out = StringIO()
    run = RecordedRun.load(folder)
    report.print_report(run, Console(file=out, width=width))
    return out.getvalue()


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
    run = RecordedRun.load(folder)
    assert shown >= {int(run.objectives[:, j].argmin()) for j in range(7)}


def test_the_command_writes_everything_and_prints_the_table(
    mixed: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert report.main([str(mixed)]) == 0
    assert "3 points on the Pareto front" in capsys.readouterr().out
    for name in ("hypervolume.png", "front.png"):
        assert (mixed / name).read_bytes().startswith(PNG)
    names = {path.name for path in mixed.iterdir()}
    made = {"summary.json", "report.html", "hypervolume.png", "front.png"}
    assert names == {FILE_NAME, COUNT_FILE_NAME, *made}


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


def test_an_empty_front_and_the_error_of_a_run_are_said(tmp_path: Path) -> None:
    failed = evaluation(0, {}, valid=False, feasible=False, error_code=4)
    end = {"stop_reason": "error", "error_code": 4, "error_msg": "2 evaluations failed in a row"}
    text = table_of(write_run(tmp_path, [failed], end=end))
    assert "The Pareto front is empty" in text
    assert "2 evaluations failed in a row" in text


def test_the_best_of_a_maximised_objective_is_its_greatest(tmp_path: Path) -> None:
    objectives = {"loss": {"reference": 10.0}, "yield": {"reference": 0.0, "direction": "maximize"}}
    problem = {"variables": {"x1": {"min": 0.0, "max": 4.0}}, "objectives": objectives}
    values = [(5.0, 3.0), (4.0, 1.0), (6.0, 2.0)]
    records = [evaluation(i, {"loss": a, "yield": b}) for i, (a, b) in enumerate(values)]
    text = table_of(write_run(tmp_path, records, problem))
    assert "3*" in text
    assert "4*" in text
