"""The runs of a folder, broken and many."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

import pytest

from launcher import run_folder
from mobo_tuner.page import history
from mobo_tuner.page.history import MAX_RUNS, History
from mobo_tuner.runs.journal import Journal, journal_line

THIS_PROCESS = {"pid": os.getpid(), "pid_started": run_folder.process_start(os.getpid())}


def make(folder: Path, run_id: str, summary: object = None, **facts: object) -> None:
    (folder / run_id).mkdir(parents=True)
    (folder / run_id / "run.json").write_text(json.dumps(facts), encoding="utf-8")
    if summary is not None:
        (folder / run_id / "summary.json").write_text(json.dumps(summary), encoding="utf-8")


@pytest.mark.parametrize("run_id", ["", ".", "..", "../runs/one", "/tmp", "none"])
def test_a_run_id_from_a_topic_leads_out_of_the_folder_nowhere(tmp_path: Path, run_id: str) -> None:
    (tmp_path / "runs" / "one").mkdir(parents=True)
    history = History(tmp_path / "runs")
    assert history.folder_of("one") == tmp_path / "runs" / "one"
    assert history.folder_of(run_id) is None


def test_the_newest_run_is_first_and_a_text_filters(tmp_path: Path) -> None:
    make(tmp_path, "a", {"evaluations": 9, "failed": 1, "hypervolume": 2.5}, state="finished")
    make(tmp_path, "b", started="2026-02-01T00:00:00", state="failed", reason="K1 is stuck")
    make(tmp_path, "c", started="2026-03-01T00:00:00", state="rebuilt")
    runs = History(tmp_path)
    assert [run.run_id for run in runs.runs()] == ["c", "b", "a"]
    assert [run.run_id for run in runs.runs(" k1 IS ")] == ["b"]
    [finished] = runs.runs("finished")
    assert (finished.evaluations, finished.failed, finished.hypervolume) == (9, 1, 2.5)


def test_what_changes_is_read_again(tmp_path: Path) -> None:
    make(tmp_path, "a", state="running", **THIS_PROCESS)
    runs = History(tmp_path)
    assert runs.runs()[0].state == "running"
    (tmp_path / "a" / "run.json").write_text('{"state": "finished"}', encoding="utf-8")
    assert runs.runs()[0].state == "finished"


def test_an_active_run_shows_how_far_it_is(tmp_path: Path) -> None:
    make(tmp_path, "a", state="running", **THIS_PROCESS)
    journal = tmp_path / "a" / "journal.jsonl"
    runs = History(tmp_path)
    record: dict[str, Any] = {"type": "evaluation", "hypervolume": 2.5}
    for index, valid in enumerate((True, False, True, False)):
        with journal.open("ab") as file:
            file.write(journal_line({**record, "index": index, "valid": valid}))
        [run] = runs.runs()
        assert (run.state, run.evaluations, run.hypervolume) == ("running", index + 1, 2.5)
        assert run.failed == (index + 1) // 2


@pytest.mark.parametrize("text", ["", "[]", "{", '{"state": 7, "started": null}', "[" * 9999])
def test_a_broken_file_hides_no_run(tmp_path: Path, text: str) -> None:
    make(tmp_path, "a", {"evaluations": "many", "hypervolume": None})
    (tmp_path / "a" / "run.json").write_text(text, encoding="utf-8")
    [run] = History(tmp_path).runs()
    assert run.run_id == "a"
    assert run.evaluations is None


def test_no_folder_has_no_runs(tmp_path: Path) -> None:
    assert History(None).runs() == History(tmp_path / "missing").runs() == []


def test_only_so_many_are_shown(tmp_path: Path) -> None:
    for number in range(MAX_RUNS + 5):
        make(tmp_path, f"run{number}", started=f"{number:05}")
    found = History(tmp_path).runs()
    assert len(found) == MAX_RUNS
    assert found[0].run_id == f"run{MAX_RUNS + 4}"


def test_entry_script_and_page_read_the_same_files() -> None:
    assert (history.RUN_FILE, history.SUMMARY_FILE) == (
        run_folder.RUN_FILE,
        run_folder.SUMMARY_FILE,
    )


def test_list_and_page_agree_on_what_became_of_a_run(tmp_path: Path) -> None:
    start: dict[str, Any] = {"type": "start", "run_id": "a", "stamp": 1_700_000_000.0, "version": 1}
    evaluation: dict[str, Any] = {"type": "evaluation", "index": 6, "hypervolume": 2.5}
    make(tmp_path, "runs", state="running", **THIS_PROCESS)
    make(tmp_path, "killed", state="running", pid=THIS_PROCESS["pid"], pid_started="1")
    make(tmp_path, "over", {"evaluations": 9, "hypervolume": 1.5}, state="finished")
    for name, end in (("done", "budget"), ("canceled", "canceled"), ("failed", "error")):
        records: list[dict[str, Any]] = [
            start,
            evaluation,
            {"type": "end", "stop_reason": end, "error_msg": "x"},
        ]
        Journal.create(tmp_path / name, records).close()
    Journal.create(tmp_path / "gone", [start, evaluation]).close()
    make(tmp_path, "held", {"evaluations": 3, "hypervolume": 1.5}, state="finished")
    os.utime(tmp_path / "held" / "summary.json", (1.0, 1.0))  # what came later is in the journal
    Journal.create(tmp_path / "held", [start, evaluation]).close()
    runs = History(tmp_path)
    with Journal.create(tmp_path / "active", [start]):
        expected = {
            "runs": "running",
            "killed": "died",
            "over": "finished",
            "done": "finished",
            "canceled": "canceled",
            "failed": "failed",
            "gone": "died",
            "held": "finished",
            "active": "running",
        }
        found = {run.run_id: run for run in runs.runs()}
        assert {name: run.state for name, run in found.items()} == expected
        for folder in run_folder.RunFolder.all(tmp_path):
            run, text = found[folder.run_id], run_folder._text
            row = [run.run_id, run.state, text(run.evaluations), text(run.hypervolume)]
            assert folder.row() == [*row, run.started or "-"]
    assert {run.run_id: run.state for run in runs.runs()} == {**expected, "active": "died"}
