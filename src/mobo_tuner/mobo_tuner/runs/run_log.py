"""What is kept of a run while it goes on: the journal, the optimiser's state, and the outline."""

from __future__ import annotations

import contextlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from mobo_tuner.core import Optimizer
from mobo_tuner.runs.journal import Journal, Record, journal_line
from mobo_tuner.runs.saved_state import SavedState

_OUTLINED = ("start", "change")


class RunLog:
    """Keeps the records of one run that goes on.

    Args:
        run_dir: the run's folder; where None, only the outline is kept.
        header: what the start record holds beside its type.
        earlier: records with which the run begins.

    Raises:
        FileExistsError: the folder holds a journal already.
        OSError: it cannot be written.
    """

    def __init__(
        self, run_dir: Path | None, header: Mapping[str, Any], earlier: Sequence[Record] = ()
    ) -> None:
        self._run_dir = run_dir
        self._run_id = str(header["run_id"])
        self._changes = 0
        self._lines: list[str] = []
        self._journal = None if run_dir is None else Journal.create(run_dir, header, earlier)
        for record in ({"type": "start", **header}, *earlier):
            self._outline(record)

    @property
    def outline(self) -> str:
        """The start record and the changes so far, one line of JSON each.

        With the evaluations this is all that the run can be rebuilt from.
        """
        return "".join(self._lines)

    def append(self, record: Mapping[str, Any]) -> None:
        """Keep one record; it is on disk when this returns.

        Raises:
            OSError: it could not be written.
        """
        if self._journal is not None:
            self._journal.append(record)
        self._outline(record)

    def save(self, optimizer: Optimizer) -> None:
        """Keep the optimiser's state, so that going on later needs no replay.

        Where that fails, as on a full disk, the journal suffices.
        """
        if self._run_dir is None:
            return
        saved = SavedState(
            self._run_id,
            len(optimizer.dataset),
            self._changes,
            optimizer.get_state(with_evaluations=False),
        )
        with contextlib.suppress(OSError):
            saved.write(self._run_dir)

    def close(self) -> None:
        """Close the journal; may be called again."""
        if self._journal is not None:
            self._journal.close()

    def _outline(self, record: Mapping[str, Any]) -> None:
        if record["type"] in _OUTLINED:
            self._changes += record["type"] == "change"
            self._lines.append(journal_line(record).decode())
