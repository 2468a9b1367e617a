"""The journal of a run: one JSON object per line, on disk before the run continues.

A run's folder contains `journal.jsonl`, from which its report is made. `records` defines the records. The
JSON is strict: a number that is not finite is written as null. Each line has its number, so that a line that
is missing or was moved is noticed.
"""

from __future__ import annotations

import contextlib
import errno
import fcntl
import json
import math
import os
import threading
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from mobo_tuner.errors import UserError

FILE_NAME = "journal.jsonl"
_NUMBER = "line"  # key of the number of a line, from 1
MAX_BYTES = 1 << 30  # largest journal that is read: half a million evaluations

JsonRecord = dict[str, Any]


class JournalError(UserError):
    """A journal that cannot be read."""


class JournalWriteError(JournalError, OSError):
    """A journal that cannot be written."""

    def __init__(self, path: Path, error: OSError) -> None:
        super().__init__(f"the journal '{path}' cannot be written: {error.strerror or error}")


class Journal:
    """An append-only journal, open for writing; `create` returns one.

    Attributes:
        path: Path of the file.
    """

    def __init__(self, path: Path, descriptor: int) -> None:
        self.path = path
        self._descriptor = descriptor
        self._size = 0
        self._count = 0  # lines
        self._lock = threading.Lock()  # one line at a time, whichever thread it comes from

    @classmethod
    def create(cls, run_dir: str | Path, records: Sequence[Mapping[str, Any]]) -> Journal:
        """Start the journal of a run in its folder, which is created if it is missing.

        Args:
            run_dir: Folder of the run.
            records: Its start record, and the records taken over from the run that it resumes.

        Raises:
            FileExistsError: If the folder already contains a journal.
            JournalWriteError: If the folder or the file cannot be written.
            ValueError: If a record cannot be written as JSON.
        """
        lines = [_numbered(record, n) for n, record in enumerate(records, start=1)]
        folder = Path(run_dir)
        path = folder / FILE_NAME
        try:
            return cls._create(folder, path, lines)
        except (FileExistsError, JournalWriteError):
            raise
        except OSError as error:
            raise JournalWriteError(path, error) from None

    @classmethod
    def _create(cls, folder: Path, path: Path, lines: Sequence[bytes]) -> Journal:
        folder.mkdir(parents=True, exist_ok=True)
        # A journal always contains its start, whenever its writer is killed.
        draft = folder / f".{FILE_NAME}.{os.getpid()}"
        flags = os.O_WRONLY | os.O_CREAT | os.O_TRUNC | os.O_APPEND | os.O_CLOEXEC
        journal = cls(path, os.open(draft, flags, 0o644))
        try:
            # Who reads the folder can tell by the lock whether the run is active.
            with contextlib.suppress(OSError):  # some network disks have no locks
                fcntl.flock(journal._descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
            with journal._lock:
                journal._write(*lines)
            _put(draft, path)
            _sync_folder(folder)
        except BaseException:
            journal.close()
            raise
        finally:
            draft.unlink(missing_ok=True)
        return journal

    def append(self, record: Mapping[str, Any]) -> None:
        """Write one record; it is on disk when this returns.

        Raises:
            JournalWriteError: If it could not be written; the journal then contains no part of it.
            ValueError: If the record has no type, cannot be written as JSON, or the journal is closed.
        """
        if not isinstance(record.get("type"), str):
            raise ValueError(f"a journal record needs a type, which {dict(record)!r:.80} lacks")
        with self._lock:
            self._write(_numbered(record, self._count + 1))

    def close(self) -> None:
        """Close the file; repeated calls have no effect."""
        if self._descriptor >= 0:
            os.close(self._descriptor)
            self._descriptor = -1

    def __enter__(self) -> Journal:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _write(self, *lines: bytes) -> None:
        if self._descriptor < 0:
            raise ValueError(f"the journal '{self.path}' is closed")
        content = b"".join(lines)
        try:
            if (
                os.fstat(self._descriptor).st_nlink == 0
            ):  # what is written now would be lost silently
                raise FileNotFoundError(errno.ENOENT, "it was deleted")
            rest = memoryview(content)
            while rest:
                rest = rest[os.write(self._descriptor, rest) :]
            os.fsync(self._descriptor)
        except OSError as error:
            # An incomplete line would corrupt the next one.
            with contextlib.suppress(OSError):
                os.ftruncate(self._descriptor, self._size)
            raise JournalWriteError(self.path, error) from None
        self._size += len(content)
        self._count += len(lines)


def append_record(run_dir: str | Path, record: Mapping[str, Any]) -> None:
    """Append one record to the journal of a run that has ended; it is on disk when this returns.

    What a killed process left of a last line is cut off, as every reader leaves it out.

    Raises:
        JournalWriteError: If it could not be written.
        ValueError: If the record cannot be written as JSON.
    """
    path = Path(run_dir) / FILE_NAME
    try:
        with path.open("r+b") as file:
            content = file.read()
            end = content.rfind(b"\n") + 1
            line = _numbered(record, content.count(b"\n") + 1)
            file.truncate(end)
            file.seek(end)
            file.write(line)
            file.flush()
            os.fsync(file.fileno())
    except OSError as error:
        raise JournalWriteError(path, error) from None


def read_journal(path: str | Path) -> list[JsonRecord]:
    """Read a journal's records in order.

    An incomplete or damaged last line is ignored, because a killed process may leave one.

    Args:
        path: Path of the journal, or of its run's folder.

    Raises:
        JournalError: If it cannot be read, an earlier line is not a record, the first is not a start, or a
            line is missing.
    """
    file = Path(path)
    if file.is_dir():
        file /= FILE_NAME
    try:
        if file.stat().st_size > MAX_BYTES:
            raise JournalError(f"the journal '{file}' is larger than the {MAX_BYTES} bytes allowed")
        content = file.read_bytes()
    except OSError as error:
        raise JournalError(f"the journal '{file}' cannot be read: {error.strerror}") from None
    return parse_journal(content, f"the journal '{file}'")


def parse_journal(content: bytes, name: str) -> list[JsonRecord]:
    """Return the records in the lines of a journal; `name` is its name in errors.

    Raises:
        JournalError: If a line before the last is not a record, the first is not a start, or a line is
            missing.
    """
    lines = content.split(b"\n")
    while lines and not lines[-1].strip():
        lines.pop()
    records = []
    for number, line in enumerate(lines, start=1):
        record = _record(line)
        if record is not None:
            if record.pop(_NUMBER, number) != number:
                raise JournalError(
                    f"line {number} of {name} is not the one that was written there: one is missing, or was moved"
                )
            records.append(record)
        elif number < len(lines):
            raise JournalError(f"line {number} of {name} is not a record")
    if not records or records[0]["type"] != "start":
        raise JournalError(f"{name} does not begin with a start record")
    return records


def _numbered(record: Mapping[str, Any], number: int) -> bytes:
    return journal_line({**record, _NUMBER: number})


def _record(line: bytes) -> JsonRecord | None:
    try:
        record = json.loads(line)
    except (ValueError, RecursionError):
        return None
    return record if isinstance(record, dict) and isinstance(record.get("type"), str) else None


def journal_line(record: Mapping[str, Any]) -> bytes:
    """Return a record as a line of a journal, including the line break.

    Raises:
        ValueError: If it cannot be written as JSON.
    """
    text = json.dumps(_strict(record), ensure_ascii=False, allow_nan=False, separators=(",", ":"))
    return text.encode() + b"\n"


def _strict(value: Any) -> Any:
    """Return the value for strict JSON."""
    if isinstance(value, np.generic | np.ndarray):
        value = value.tolist()
    if isinstance(value, Mapping):
        return {str(key): _strict(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_strict(item) for item in value]
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if value is None or isinstance(value, str | int | bool):
        return value
    raise ValueError(f"a journal cannot hold {value!r:.80}")


def _put(draft: Path, path: Path) -> None:
    """Rename a finished file to a name that must not exist.

    Raises:
        FileExistsError: If the name exists.
    """
    try:
        os.link(draft, path)
    except FileExistsError:
        raise FileExistsError(f"the journal '{path}' exists already") from None
    except OSError:  # a file system without hard links
        if path.exists():
            raise FileExistsError(f"the journal '{path}' exists already") from None
        draft.rename(path)


def _sync_folder(folder: Path) -> None:
    """Sync the name of a new file to disk, if the file system supports it."""
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        with contextlib.suppress(OSError):
            os.fsync(descriptor)
    finally:
        os.close(descriptor)
