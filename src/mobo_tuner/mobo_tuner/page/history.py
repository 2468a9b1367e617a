"""The runs of a folder, from the files that each run leaves there."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

MAX_RUNS = 200  # that are shown
RUN_FILE = "run.json"
SUMMARY_FILE = "summary.json"


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
        found = [self._read(path.parent) for path in self._folder.glob(f"*/{RUN_FILE}")]
        fitting = [r for r in found if text in f"{r.run_id} {r.state} {r.reason}".casefold()]
        return sorted(fitting, key=lambda run: run.started, reverse=True)[:MAX_RUNS]

    def folder_of(self, run_id: str) -> Path | None:
        """Return the folder of a run; None if it is not there."""
        if self._folder is None or Path(run_id).name != run_id or run_id in ("", ".", ".."):
            return None
        folder = self._folder / run_id
        return folder if folder.is_dir() else None

    def _read(self, folder: Path) -> PastRun:
        stamps = (_changed(folder / RUN_FILE), _changed(folder / SUMMARY_FILE))
        known = self._known.get(folder)
        if known is None or known[0] != stamps:
            known = (stamps, _past_run(folder))
            self._known[folder] = known
        return known[1]


def _past_run(folder: Path) -> PastRun:
    facts, summary = _content(folder / RUN_FILE), _content(folder / SUMMARY_FILE)
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
        content = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError):
        return {}
    return content if isinstance(content, dict) else {}
