"""Several runs in one page."""

from __future__ import annotations

import re
from pathlib import Path
from xml.etree import ElementTree

import pytest

from mobo_tuner.runs.recorded_run import RecordedRun
from mobo_tuner.runs.report.comparison import main, render_comparison
from tests.support.run_folders import TWO, evaluation, seven_objectives, write_run

EVIL = "<script>alert('x')</script>"


def run_of(folder: Path, shift: float, reference: float = 10.0) -> Path:
    """A run of three evaluations in the objectives of `TWO`."""
    problem = TWO | {
        "objectives": {n: o | {"reference": reference} for n, o in TWO["objectives"].items()}
    }
    values = [(5.0, 5.0), (2.0, 8.0), (8.0, 2.0)]
    records = [evaluation(i, {"f1": a + shift, "f2": b}) for i, (a, b) in enumerate(values)]
    return write_run(folder, records, problem)


def page_of(*folders: Path) -> str:
    """The page of some runs, whose plots are well-formed."""
    page = render_comparison([RecordedRun.load(folder) for folder in folders])
    for svg in re.findall(r"<svg.*?</svg>", page, re.DOTALL):
        ElementTree.fromstring(svg)
    assert not re.search(r"https?:|<script|\b(nan|inf)\b", page)
    return page


def test_runs_of_one_problem_are_in_one_table_and_two_plots(tmp_path: Path) -> None:
    page = page_of(run_of(tmp_path / "a", 0.0), run_of(tmp_path / "b", 1.0))
    assert page.count("svg class") == 2
    cells = re.findall(r"<td>(.*?)</td>", page)
    assert {"2", "3"} <= set(cells), "the best f1 of each"
    assert "run1 (1)" in page
    assert "run1 (2)" in page
    assert "do not compare" not in page


def test_other_reference_points_and_objectives_are_told(tmp_path: Path) -> None:
    first = run_of(tmp_path / "a", 0.0)
    assert "another reference point" in page_of(first, run_of(tmp_path / "b", 0.0, 11.0))
    page = page_of(first, seven_objectives(tmp_path / "c", 5))
    assert "other objectives" in page
    assert "share no two objectives" in page


def test_runs_without_a_front_or_an_evaluation_are_compared(tmp_path: Path) -> None:
    failed = evaluation(0, {}, valid=False, feasible=False, error_code=3)
    page = page_of(write_run(tmp_path / "a", []), write_run(tmp_path / "b", [failed]))
    assert page.count("unfinished") == 2


def test_ten_runs_in_seven_objectives(tmp_path: Path) -> None:
    folders = [seven_objectives(tmp_path / str(i), 4) for i in range(10)]
    assert page_of(*folders).count("svg class") == 1 + 21


def test_a_stop_reason_is_not_taken_for_html(tmp_path: Path) -> None:
    folder = write_run(tmp_path, [], end={"stop_reason": EVIL})
    assert "&lt;script&gt;" in page_of(folder)


def test_the_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    a, b, output = run_of(tmp_path / "a", 0.0), run_of(tmp_path / "b", 1.0), tmp_path / "c.html"
    assert main([str(a), str(b), "--output", str(output)]) == 0
    assert capsys.readouterr().out == f"{output}\n"
    assert output.read_text().startswith("<!DOCTYPE html>")
    assert main([str(a), str(tmp_path / "no"), "--output", str(output)]) == 1
    assert capsys.readouterr().err.count("\n") == 1
    assert main([str(a), "--output", str(tmp_path)]) == 1
    assert str(tmp_path) in capsys.readouterr().err
