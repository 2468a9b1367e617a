"""What is kept of a run while it continues."""

from __future__ import annotations

import json
import resource
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from mobo_tuner.core import Optimizer, Problem
from mobo_tuner.runs.history import History
from mobo_tuner.runs.journal import FILE_NAME, JournalWriteError, read_journal
from mobo_tuner.runs.records import (
    ChangeRecord,
    EndRecord,
    MoveRecord,
    QueuedRecord,
    StartRecord,
    StateRecord,
)
from mobo_tuner.runs.run_log import RunLog
from mobo_tuner.runs.saved_state import SavedState

PROBLEM = Problem.from_dict(
    {
        "variables": {"x": {"min": 0.0, "max": 1.0}},
        "objectives": {"f": {"reference": 2.0}, "g": {"reference": 2.0}},
    }
)
START = StartRecord("run", 0.0, PROBLEM, {})
CHANGE = ChangeRecord(1.0, 0, PROBLEM, 9)


def outlined(log: RunLog) -> list[str]:
    return [json.loads(line)["type"] for line in log.outline.splitlines()]


def test_the_outline_has_the_start_and_the_changes_alone() -> None:
    log = RunLog(None, START, [CHANGE])
    log.append(QueuedRecord(0.5, {"x": 0.5}))
    log.append(ChangeRecord(2.0, 1, PROBLEM, 9))
    assert outlined(log) == ["start", "change", "change"]


def test_a_record_is_on_disk_when_it_was_appended(tmp_path: Path) -> None:
    log = RunLog(tmp_path / "run", START, [CHANGE])
    log.append(QueuedRecord(2.0, {"x": 0.5}))
    assert [r["type"] for r in read_journal(tmp_path / "run")] == ["start", "change", "queued"]
    log.close()
    log.close()


def test_the_saved_state_knows_how_far_the_run_was(tmp_path: Path) -> None:
    optimizer = Optimizer(PROBLEM, seed=0)
    log = RunLog(tmp_path / "run", START)
    for index in range(3):
        optimizer.tell({"x": 0.3 * index}, {"f": float(index), "g": 1.0})
    log.append(CHANGE)
    log.save(optimizer)
    saved = SavedState.read(tmp_path / "run")
    assert saved is not None
    assert (saved.run_id, saved.evaluations, saved.changes) == ("run", 3, 1)
    log.close()


def test_moves_are_kept_after_the_end_too(tmp_path: Path) -> None:
    log = RunLog(tmp_path / "run", START)
    log.append(StateRecord(0.5, 0, {"x": 0.1}))
    log.append(EndRecord(1.0, "budget"))
    log.close()
    log.append(MoveRecord(2.0, 0, {"x": 0.5}))
    log.append(StateRecord(3.0, 0, {"x": 0.4}, "it was stopped"))
    history = History.from_records(read_journal(tmp_path / "run"))
    moves: list[MoveRecord | StateRecord] = [
        MoveRecord(2.0, 0, {"x": 0.5}),
        StateRecord(3.0, 0, {"x": 0.4}, "it was stopped"),
    ]
    assert history.before == StateRecord(0.5, 0, {"x": 0.1})
    assert [*history.moves[0]] == moves
    assert [*history.places] == [history.before, *moves]
    again = RunLog(tmp_path / "run", START, moves, ended=True)
    again.append(MoveRecord(4.0, 0, {"x": 0.1}, "restore"))
    kept = History.from_records(read_journal(tmp_path / "run")).moves
    assert [move.asked.purpose for move in kept] == ["go", "restore"]
    assert kept[-1].ended is None
    assert outlined(again) == ["start", "move", "state", "move"]
    log.save(Optimizer(PROBLEM, seed=0))
    saved = SavedState.read(tmp_path / "run")
    assert saved is not None
    assert saved.changes == 0


def test_a_state_that_cannot_be_written_stops_nothing(tmp_path: Path) -> None:
    log = RunLog(tmp_path / "run", START)
    (tmp_path / "run" / "optimizer.json").mkdir()  # no file can take its place
    log.save(Optimizer(PROBLEM, seed=0))
    assert SavedState.read(tmp_path / "run") is None
    log.close()


def test_a_run_is_never_overwritten(tmp_path: Path) -> None:
    RunLog(tmp_path / "run", START).close()
    kept = (tmp_path / "run" / FILE_NAME).read_bytes()
    with pytest.raises(FileExistsError):
        RunLog(tmp_path / "run", START)
    assert (tmp_path / "run" / FILE_NAME).read_bytes() == kept


@pytest.fixture
def limited() -> Iterator[Callable[[int], None]]:
    """Limit the size of this process's files, as a full disk does."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    yield lambda size: resource.setrlimit(resource.RLIMIT_FSIZE, (size, hard))
    resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


def test_what_a_full_disk_does_not_take_waits_in_its_order(
    tmp_path: Path, limited: Callable[[int], None]
) -> None:
    log = RunLog(tmp_path / "run", START)
    limited((tmp_path / "run" / FILE_NAME).stat().st_size)
    log.keep(CHANGE)
    log.keep(EndRecord(2.0, "budget"))
    assert log.waiting == (CHANGE, EndRecord(2.0, "budget"))
    assert "cannot be written: File too large" in log.trouble
    assert not log.retry()
    with pytest.raises(JournalWriteError, match="File too large"):
        log.append(QueuedRecord(1.0, {"x": 0.5}))
    optimizer = Optimizer(PROBLEM, seed=0)
    log.save(optimizer)  # it would be ahead of the journal
    assert SavedState.read(tmp_path / "run") is None
    limited(resource.RLIM_INFINITY)
    log.append(QueuedRecord(1.0, {"x": 0.5}))
    assert not log.waiting
    assert log.retry()
    assert not log.trouble
    log.close()
    kinds = [r["type"] for r in read_journal(tmp_path / "run")]
    assert kinds == ["start", "change", "end", "queued"]
