"""The messages in an SQLite file of rosbag2, one after another, as far as they go.

A file whose recorder was killed is read with the write-ahead log or the rollback journal beside it, and one that was
cut off is read up to its last whole page. Both are repaired in a copy: the bag itself is never changed. Nothing in the
file is trusted: only plain tables are read, and no value may be larger than `MAX_RECORD`.
"""

from __future__ import annotations

import os
import shutil
import sqlite3
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any
from urllib.parse import quote

from mobo_tuner.runs.mcap_records import MAX_RECORD, Message, Schema

MAGIC = b"SQLite format 3\0"
_UNFINISHED = ("-wal", "-journal")  # endings of the files beside one whose writer was killed
_DEFINITIONS = """
SELECT topic_type, encoding, encoded_message_definition FROM message_definitions
"""
_TOPICS = "SELECT id, name, type FROM topics WHERE serialization_format = 'cdr'"
_MESSAGES = "SELECT topic_id, timestamp, data FROM messages ORDER BY id"


class SqliteError(ValueError):
    """A file that is not an SQLite file of rosbag2; the message is one sentence for the user."""


def read_messages(path: Path) -> Iterator[Message]:
    """Yield every message of an SQLite file, in the order of their ids.

    Raises:
        SqliteError: If it cannot be read or is not an SQLite file of rosbag2.
    """
    try:
        with path.open("rb") as file:
            if file.read(len(MAGIC)) != MAGIC:
                raise SqliteError(f"'{path}' is not an SQLite file")
        with TemporaryDirectory() as scratch, closing(_connect(path, Path(scratch))) as database:
            yield from _messages(database, path)
    except OSError as error:
        raise SqliteError(f"'{path}' cannot be read: {error.strerror}") from None


def _connect(path: Path, scratch: Path) -> sqlite3.Connection:
    """Open a file for reading, or its repaired copy if it is incomplete."""
    beside = [file for end in _UNFINISHED if (file := path.with_name(path.name + end)).is_file()]
    size = path.stat().st_size
    whole = size - size % _page_size(path)  # SQLite would take the rest for a page with zeros
    options = "?mode=ro&immutable=1"
    if beside or whole < size:
        for file in (path, *beside):
            shutil.copyfile(file, scratch / file.name)
        path, options = scratch / path.name, "?mode=rw"
        os.truncate(path, whole)
    database = sqlite3.connect(f"file:{quote(str(path.absolute()))}{options}", uri=True)
    database.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, MAX_RECORD)
    database.text_factory = bytes  # which need not be UTF-8
    return database


def _page_size(path: Path) -> int:
    with path.open("rb") as file:
        size = int.from_bytes(file.read(18)[16:], "big")
    return 65536 if size <= 1 else size


def _messages(database: sqlite3.Connection, path: Path) -> Iterator[Message]:
    try:
        database.execute("PRAGMA trusted_schema = OFF")
        database.execute("PRAGMA writable_schema = ON")  # reads a file that was cut off, too
        plain = "SELECT name FROM sqlite_master WHERE type = 'table' AND rootpage > 0"
        tables = {name for (name,) in database.execute(plain)}
        if not {b"topics", b"messages"} <= tables:
            raise SqliteError(f"'{path}' is not a bag: it lacks the tables of rosbag2")
        known = database.execute(_DEFINITIONS) if b"message_definitions" in tables else ()
        texts = {_text(name): (_text(encoding), _text(text)) for name, encoding, text in known}
        topics = {}
        for number, topic, name in database.execute(_TOPICS):
            schema = Schema(_text(name), *texts.get(_text(name), ("", "")))
            topics[number] = (_text(topic), schema)
        rows = database.execute(_MESSAGES)
    except sqlite3.Error as error:
        raise SqliteError(f"'{path}' cannot be read: {error}") from None
    while True:
        try:
            row = rows.fetchone()
        except sqlite3.Error:  # the file is damaged or was cut off here
            return
        if row is None:
            return
        number, time, data = row
        if number in topics and isinstance(data, bytes) and isinstance(time, int):
            yield Message(*topics[number], time, data)


def _text(value: Any) -> str:
    return value.decode("utf-8", "replace") if isinstance(value, bytes) else str(value)
