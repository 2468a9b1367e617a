"""The runs of a folder, from the files that each run leaves there."""

from __future__ import annotations

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
        state: State at its end.
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
    """Reads the runs of a folder; a run that has not changed is read once.

    Args:
        folder: Folder of the runs; None if it is unknown.
    """

    def __init__(self, folder: Path | None) -> None:
        self._folder = folder
        self._known: dict[Path, tuple[tuple[int, int], PastRun]] = {}

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
        board.problem, board.front = past.problem, past.front
        board.progress.set_problem(past.problem)
        for evaluation in past.evaluations:
            board.add(evaluation)
        board.progress.set_front(past.front)
        return board

    def _read(self, folder: Path) -> PastRun:
        stamps = (_changed(folder / RUN_FILE), _changed(folder / SUMMARY_FILE))
        if not stamps[1]:
            stamps = (stamps[0], _changed(folder / JOURNAL_FILE))
        known = self._known.get(folder)
        if known is None or known[0] != stamps:
            known = (stamps, _past_run(folder))
            self._known[folder] = known
        return known[1]


def _past_run(folder: Path) -> PastRun:
    facts, summary = _content(folder / RUN_FILE), _content(folder / SUMMARY_FILE)
    if not summary:  # it is active, was killed, or is that of nodes that stay
        told, summary = _last_records(folder / JOURNAL_FILE)
        facts = facts or told
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


def _last_records(path: Path) -> tuple[Mapping[str, Any], Mapping[str, Any]]:
    """Return what the end of a journal says of a run and of its results."""
    try:
        with path.open("rb") as file:
            file.seek(max(path.stat().st_size - TAIL, 0))
            lines = file.read().decode(errors="replace").splitlines()
        started = datetime.fromtimestamp(path.stat().st_mtime).astimezone()
    except OSError:
        return {}, {}
    records = [record for line in lines if (record := _object(line))]
    end = next((r for r in records if r.get("type") == "end"), {})
    last: dict[str, Any] = next((r for r in reversed(records) if r.get("type") == "evaluation"), {})
    facts = {
        "state": end.get("stop_reason", "not ended"),
        "started": started.isoformat(timespec="seconds"),
        "reason": end.get("error_msg", ""),
    }
    index = last.get("index")
    count = {"evaluations": index + 1} if isinstance(index, int) else {}
    return facts, {**count, "hypervolume": last.get("hypervolume")}


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
