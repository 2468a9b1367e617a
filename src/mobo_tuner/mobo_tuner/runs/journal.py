"""The journal of a run: one JSON object per line, on disk before the run continues.

A run's folder contains `journal.jsonl`, from which its report is made. `records` defines the records. The
JSON is strict: a number that is not finite is written as null.

Each line ends with its number and a checksum of itself and of the checksum before, so that a line that was
changed, moved or removed is noticed. `journal.lines` beside it has the number of lines, so that one that is
missing at the end is noticed, too. Journals of before have none of these, or numbers alone.

`python -m mobo_tuner.runs.journal RUN` checks a journal.
"""

from __future__ import annotations

import argparse
import contextlib
import errno
import fcntl
import hashlib
import json
import math
import os
import re
import sys
import threading
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from mobo_tuner.errors import UserError

FILE_NAME = "journal.jsonl"
COUNT_FILE_NAME = "journal.lines"
_NUMBER = "line"  # key of the number of a line, from 1
_SUM = "sum"  # key of its checksum, the last one of a line
_SUM_DIGITS = 16
_SEAL = re.compile(rb',"sum":"([0-9a-f]{16})"}$')
MAX_BYTES = 1 << 30  # largest journal that is read: half a million evaluations

_ADVICE = "'rebuild' makes the run from its bag"

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
        self._sum = b""  # of the last line
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
        for record in records:
            journal_line(record)
        folder = Path(run_dir)
        path = folder / FILE_NAME
        try:
            return cls._create(folder, path, records)
        except (FileExistsError, JournalWriteError):
            raise
        except OSError as error:
            raise JournalWriteError(path, error) from None

    @classmethod
    def _create(cls, folder: Path, path: Path, records: Sequence[Mapping[str, Any]]) -> Journal:
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
                journal._write(*records)
            if not path.exists():  # what counts the lines of a journal that was deleted is void
                (folder / COUNT_FILE_NAME).unlink(missing_ok=True)
            _put(draft, path)
            _sync_folder(folder)
            _write_count(path, journal._count)
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
            self._write(record)
            _write_count(self.path, self._count)

    def close(self) -> None:
        """Close the file; repeated calls have no effect."""
        if self._descriptor >= 0:
            os.close(self._descriptor)
            self._descriptor = -1

    def __enter__(self) -> Journal:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _write(self, *records: Mapping[str, Any]) -> None:
        if self._descriptor < 0:
            raise ValueError(f"the journal '{self.path}' is closed")
        content, last = _sealed(records, self._count, self._sum)
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
        self._count += len(records)
        self._sum = last


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
            count = content.count(b"\n")
            seal = _SEAL.search(content[:end].rpartition(b"\n")[0])
            line, _ = _sealed([record], count, seal[1] if seal else b"")
            file.truncate(end)
            file.seek(end)
            file.write(line)
            file.flush()
            os.fsync(file.fileno())
    except OSError as error:
        raise JournalWriteError(path, error) from None
    _write_count(path, count + 1)


def read_journal(path: str | Path) -> list[JsonRecord]:
    """Read a journal's records in order.

    An incomplete or damaged last line is ignored, because a killed process may leave one, unless it was
    whole once.

    Args:
        path: Path of the journal, or of its run's folder.

    Raises:
        JournalError: If it cannot be read, an earlier line is not a record, the first is not a start, or a
            line is missing or was changed.
    """
    file = Path(path)
    if file.is_dir():
        file /= FILE_NAME
    try:
        if file.stat().st_size > MAX_BYTES:
            raise JournalError(f"the journal '{file}' is larger than the {MAX_BYTES} bytes allowed")
        count = _read_count(file)  # before the lines, to which an active run adds
        content = file.read_bytes()
    except OSError as error:
        raise JournalError(f"the journal '{file}' cannot be read: {error.strerror}") from None
    name = f"the journal '{file}'"
    records = parse_journal(content, name)
    if len(records) < count:
        raise JournalError(
            f"line {len(records) + 1} of {name} is missing or damaged: {count} lines were written; "
            f"{_ADVICE}"
        )
    return records


def parse_journal(content: bytes, name: str) -> list[JsonRecord]:
    """Return the records in the lines of a journal; `name` is its name in errors.

    Raises:
        JournalError: If a line before the last is not a record, the first is not a start, or a line is
            missing or was changed.
    """
    lines = content.split(b"\n")
    while lines and not lines[-1].strip():
        lines.pop()
    records: list[JsonRecord] = []
    before = b""
    for number, line in enumerate(lines, start=1):
        record = _record(line)
        if record is not None:
            if record.pop(_NUMBER, number) != number:
                raise JournalError(
                    f"line {number} of {name} is not the one that was written there: one is missing, or was moved; "
                    f"{_ADVICE}"
                )
            given = record.pop(_SUM, None)
            seal = _SEAL.search(line) if given is not None else None
            expected = _checksum(before, line[: seal.start()]) if seal else b""
            if (given is not None or before) and (not seal or seal[1] != expected):
                raise JournalError(
                    f"line {number} of {name} is not as it was written: it was changed; {_ADVICE}"
                )
            before = expected
            records.append(record)
        elif number < len(lines):
            raise JournalError(f"line {number} of {name} is not a record; {_ADVICE}")
    if not records or records[0]["type"] != "start":
        raise JournalError(f"{name} does not begin with a start record")
    return records


def _sealed(records: Sequence[Mapping[str, Any]], count: int, last: bytes) -> tuple[bytes, bytes]:
    """Return records as lines with their numbers and checksums, and the last checksum.

    Args:
        records: Records to write.
        count: Number of lines before.
        last: Checksum of the line before; empty if there is none.

    Raises:
        ValueError: If a record cannot be written as JSON.
    """
    lines = []
    for number, record in enumerate(records, start=count + 1):
        body = journal_line({**record, _NUMBER: number})[: -len(b"}\n")]
        last = _checksum(last, body)
        lines.append(b'%b,"%b":"%b"}\n' % (body, _SUM.encode(), last))
    return b"".join(lines), last


def _checksum(last: bytes, body: bytes) -> bytes:
    return hashlib.sha256(last + body).hexdigest()[:_SUM_DIGITS].encode()


def _write_count(path: Path, count: int) -> None:
    """Write the number of a journal's lines beside it, in place: the disk may be full by now.

    It is written after the lines are on disk, so that it is never ahead of them; if it cannot be
    written, the last lines are not counted.
    """
    with contextlib.suppress(OSError):
        descriptor = os.open(path.with_name(COUNT_FILE_NAME), os.O_WRONLY | os.O_CREAT, 0o644)
        try:
            os.pwrite(descriptor, b"%12d\n" % count, 0)
        finally:
            os.close(descriptor)


def _read_count(path: Path) -> int:
    """Return the number of lines that were written to a journal; 0 if it is unknown."""
    try:
        return int(path.with_name(COUNT_FILE_NAME).read_bytes()[:20])
    except (OSError, ValueError):
        return 0


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


def main(arguments: Sequence[str] | None = None) -> int:
    """Check the journal of a run; return the exit status."""
    parser = argparse.ArgumentParser(
        prog="mobo_tuner.runs.journal", description="Check of a journal."
    )
    parser.add_argument("run", type=Path, help="run folder, or journal")
    options = parser.parse_args(arguments)
    try:
        read_journal(options.run)
    except JournalError as error:
        print(error, file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
