"""The runs of a folder, from the files that each run leaves there.

`launcher/run_folder.py`, which cannot share a module with this one, says the same for `mobo.py list`; a test
compares them.
"""

from __future__ import annotations

import contextlib
import fcntl
import json
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import datetime
from itertools import chain
from pathlib import Path
from typing import Any

from mobo_tuner.client.past_run import read_run
from mobo_tuner.errors import UserError
from mobo_tuner.page.board import RunBoard

MAX_RUNS = 200  # that are shown
RUN_FILE = "run.json"
SUMMARY_FILE = "summary.json"
JOURNAL_FILE = "journal.jsonl"
TAIL = 1 << 16  # bytes of a journal that are read for its last records


@dataclass(frozen=True)
class PastRun:
    """A run in one line.

    Attributes:
        run_id: Id of the run.
        state: State at its end; "running" while it is active, "died" if it was killed.
        started: Local time of its start, in ISO 8601.
        evaluations: Number of evaluations; None if there is no summary.
        failed: Number of failed ones among them.
        hypervolume: Hypervolume of its front.
        reason: Reason of an end that was not intended.
    """

    run_id: str
    state: str
    started: str
    evaluations: int | None
    failed: int | None
    hypervolume: float | None
    reason: str


class History:
    """Reads the runs of a folder; a run that has ended and not changed is read once.

    Args:
        folder: Folder of the runs; None if it is unknown.
    """

    def __init__(self, folder: Path | None) -> None:
        self._folder = folder
        self._known: dict[Path, tuple[tuple[int, ...], PastRun]] = {}

    def runs(self, wanted: str = "") -> list[PastRun]:
        """Return the newest runs whose id, state or reason contains a text.

        Args:
            wanted: Text to look for, in any case; empty = all runs.
        """
        if self._folder is None:
            return []
        text = wanted.strip().casefold()
        files = (self._folder.glob(f"*/{name}") for name in (RUN_FILE, JOURNAL_FILE))
        found = [self._read(folder) for folder in {path.parent for path in chain(*files)}]
        fitting = [r for r in found if text in f"{r.run_id} {r.state} {r.reason}".casefold()]
        return sorted(fitting, key=lambda run: run.started, reverse=True)[:MAX_RUNS]

    def folder_of(self, run_id: str) -> Path | None:
        """Return the folder of a run; None if it is not there."""
        if self._folder is None or Path(run_id).name != run_id or run_id in ("", ".", ".."):
            return None
        folder = self._folder / run_id
        return folder if folder.is_dir() else None

    def board_of(self, run_id: str) -> RunBoard:
        """Return what is known of a run of the folder.

        Raises:
            UserError: If it is not there, or its journal cannot be read.
        """
        folder = self.folder_of(run_id)
        if folder is None:
            raise UserError(f"the run '{run_id}' is not in the folder")
        past = read_run(folder)
        board = RunBoard(run_id)
        board.set_problem(past.problem)
        board.changes, board.front = list(past.changes), past.front
        for evaluation in past.evaluations:
            board.add(evaluation)
        board.progress.set_front(past.front)
        return board

    def _read(self, folder: Path) -> PastRun:
        names = (RUN_FILE, SUMMARY_FILE, JOURNAL_FILE)
        stamps = tuple(_changed(folder / name) for name in names)
        known = self._known.get(folder)
        # A run that is killed changes no file.
        if known is None or known[0] != stamps or known[1].state == "running":
            known = (stamps, _past_run(folder))
            self._known[folder] = known
        return known[1]


def _past_run(folder: Path) -> PastRun:
    facts, summary = _content(folder / RUN_FILE), _content(folder / SUMMARY_FILE)
    journal = folder / JOURNAL_FILE
    records: list[dict[str, Any]] = []
    if not facts or not summary or _changed(folder / SUMMARY_FILE) < _changed(journal):
        records = _last_records(journal)
    last: dict[str, Any] = next((r for r in reversed(records) if r.get("type") == "evaluation"), {})
    if isinstance(last.get("index"), int):  # the summary is missing, or older
        counts = {"evaluations": last["index"] + 1, "failed": _failed(journal)}
        summary = {**summary, **counts, "hypervolume": last.get("hypervolume")}
    if not facts:  # a run of nodes that stay
        facts = _journal_facts(journal, records)
    elif facts.get("state") == "running" and not _is_alive(facts):
        facts = {**facts, "state": "died"}
    hypervolume = summary.get("hypervolume")
    return PastRun(
        run_id=folder.name,
        state=str(facts.get("state", "unknown")),
        started=str(facts.get("started", "")),
        evaluations=_integer(summary.get("evaluations")),
        failed=_integer(summary.get("failed")),
        hypervolume=float(hypervolume) if isinstance(hypervolume, int | float) else None,
        reason=str(facts.get("reason", "")),
    )


def _journal_facts(path: Path, records: list[dict[str, Any]]) -> Mapping[str, Any]:
    """Return what a journal says of a run without a file of facts; its last records are given."""
    try:
        with path.open("rb") as file:
            start = _object(file.readline().decode(errors="replace"))
            is_locked = False
            try:
                fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
            except OSError:
                is_locked = True
    except OSError:
        return {}
    facts = {"state": "running" if is_locked else "died", "started": ""}
    with contextlib.suppress(KeyError, TypeError, ValueError, OverflowError, OSError):
        started = datetime.fromtimestamp(start["stamp"]).astimezone()
        facts["started"] = started.isoformat(timespec="seconds")
    end = next((r for r in reversed(records) if r.get("type") == "end"), None)
    if end is not None:
        states = {"canceled": "canceled", "error": "failed"}
        facts["state"] = states.get(str(end.get("stop_reason")), "finished")
        facts["reason"] = str(end.get("error_msg", ""))
    return facts


def _is_alive(facts: Mapping[str, Any]) -> bool:
    """Return whether the process that carries out a run is there: its id and its start agree."""
    try:
        content = Path(f"/proc/{int(facts['pid'])}/stat").read_text()
    except (OSError, KeyError, TypeError, ValueError):
        return False
    # The start is the 20th field after the program's name, which is in brackets.
    state, *fields = content.rpartition(")")[2].split()
    return state != "Z" and fields[18] == facts.get("pid_started")


def _last_records(path: Path) -> list[dict[str, Any]]:
    """Return the last records of a journal."""
    try:
        with path.open("rb") as file:
            file.seek(max(path.stat().st_size - TAIL, 0))
            lines = file.read().decode(errors="replace").splitlines()
    except OSError:
        return []
    return [record for line in lines if (record := _object(line))]


def _failed(path: Path) -> int | None:
    """Return how many evaluations of a journal failed; None if it cannot be read."""
    try:
        with path.open("rb") as file:
            return sum(b'"valid":false' in line for line in file)
    except OSError:
        return None


def _integer(value: object) -> int | None:
    return value if isinstance(value, int) else None


def _changed(path: Path) -> int:
    """Return when a file changed last [ns since the epoch]; 0 if it does not exist."""
    try:
        return path.stat().st_mtime_ns
    except OSError:
        return 0


def _content(path: Path) -> Mapping[str, Any]:
    """Return the object in a JSON file; an empty one if it cannot be read."""
    try:
        return _object(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}


def _object(text: str) -> dict[str, Any]:
    """Return the object that a text holds as JSON; an empty one if it holds none."""
    try:
        content = json.loads(text)
    except (ValueError, RecursionError):
        return {}
    return content if isinstance(content, dict) else {}
