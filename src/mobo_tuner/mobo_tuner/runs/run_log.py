"""The records of an active run: the journal, the optimiser's state, and the outline."""

from __future__ import annotations

import contextlib
import threading
from collections import deque
from collections.abc import Sequence
from pathlib import Path

from mobo_tuner.core import Optimizer
from mobo_tuner.runs.journal import (
    Journal,
    JournalWriteError,
    JsonRecord,
    append_record,
    journal_line,
)
from mobo_tuner.runs.records import (
    ChangeRecord,
    EvaluationRecord,
    ForgetRecord,
    MoveRecord,
    QueuedRecord,
    Record,
    StartRecord,
    StateRecord,
    to_json,
)
from mobo_tuner.runs.saved_state import SavedState


class RunLog:
    """Keeps the records of one run.

    Args:
        run_dir: Folder of the run; if None, only the outline is kept.
        start: First record.
        earlier: Records taken over from the run that this one resumes.
        ended: Whether the run has ended and its journal exists, to which what comes later is added.

    Attributes:
        trouble: Reason why records are not in the journal yet, in one sentence; empty if all are.

    Raises:
        FileExistsError: If the folder already contains a journal.
        JournalWriteError: If the journal cannot be written.
    """

    def __init__(
        self,
        run_dir: Path | None,
        start: StartRecord,
        earlier: Sequence[Record] = (),
        *,
        ended: bool = False,
    ) -> None:
        self._run_dir = run_dir
        self._run_id = start.run_id
        self._problem = start.problem
        self._changes = 0
        self._lines: list[str] = []
        self._waiting: deque[Record] = deque()  # not in the journal yet
        self._lock = threading.RLock()  # operators' requests and evaluations come from two threads
        self.trouble = ""
        records = [start, *earlier]
        self._journal = None
        self._ended = ended
        if run_dir is not None and not ended:
            self._journal = Journal.create(run_dir, [self._json(record) for record in records])
        for record in records:
            self._outline(record)

    @property
    def outline(self) -> str:
        """Start record, changes and moves so far, one line of JSON each.

        The run can be rebuilt from it and the evaluations.
        """
        return "".join(self._lines)

    def append(self, record: Record) -> None:
        """Keep one record; it is on disk when this returns.

        Raises:
            JournalWriteError: If it, or what waits, cannot be written; it is not kept then.
        """
        with self._lock:
            self._write_waiting()
            self._write(record)
            self._outline(record)

    def keep(self, record: Record) -> None:
        """Keep one record; it waits in memory while the journal cannot be written."""
        with self._lock:
            self._waiting.append(record)
            self._outline(record)
            self.retry()

    def retry(self) -> bool:
        """Write what waits in memory; return whether all of it is on disk."""
        with self._lock:
            try:
                self._write_waiting()
            except JournalWriteError as error:
                self.trouble = str(error)
            else:
                self.trouble = ""
            return not self.trouble

    def _write_waiting(self) -> None:
        while self._waiting:
            self._write(self._waiting[0])
            self._waiting.popleft()

    def _write(self, record: Record) -> None:
        if self._ended and self._run_dir is not None:
            append_record(self._run_dir, self._json(record))
        elif self._journal is not None:
            self._journal.append(self._json(record))

    def save(self, optimizer: Optimizer) -> None:
        """Keep the optimiser's state, so that a resumed run needs no replay.

        If that fails, as on a full disk, the journal suffices. The state is never ahead of the journal.
        """
        if self._run_dir is None or self._waiting:
            return
        saved = SavedState(
            self._run_id,
            len(optimizer.dataset),
            self._changes,
            optimizer.get_state(with_evaluations=False),
        )
        with contextlib.suppress(OSError):
            saved.write(self._run_dir)

    @property
    def waiting(self) -> tuple[Record, ...]:
        """Records that are not in the journal yet."""
        return tuple(self._waiting)

    def close(self) -> None:
        """Close the journal, which is opened again for each later record; repeated calls have no effect."""
        self._ended = True
        if self._journal is not None:
            self._journal.close()

    def _json(self, record: Record) -> JsonRecord:
        """Return a record as a JSON object, in which the names of choices are beside their numbers."""
        if isinstance(record, StartRecord | ChangeRecord):
            self._problem = record.problem
        content = to_json(record)
        if isinstance(record, EvaluationRecord | QueuedRecord | MoveRecord):
            chosen = self._problem.chosen(record.setpoint)
            if chosen:
                content["chosen"] = chosen
        return content

    def _outline(self, record: Record) -> None:
        if isinstance(record, StartRecord | ChangeRecord | ForgetRecord | MoveRecord | StateRecord):
            self._changes += isinstance(record, ChangeRecord | ForgetRecord)
            self._lines.append(journal_line(self._json(record)).decode())
