"""The messages in an MCAP file, read from its beginning as far as possible.

The index and the footer at the end are not needed: all complete messages are read from a file that was
cut off anywhere, also within a chunk. Nothing in the file is trusted: sizes are compared with the
remaining bytes before reading.

The format is specified at https://mcap.dev/spec.
"""

from __future__ import annotations

import os
import struct
from collections.abc import Iterator
from io import BytesIO
from pathlib import Path
from typing import BinaryIO, NamedTuple

import lz4.frame  # type: ignore[import-untyped]
from backports import zstd

MAGIC = b"\x89MCAP0\r\n"
MAX_RECORD = 1 << 28  # bytes; larger records, compressed or not, are skipped
_SCHEMA, _CHANNEL, _MESSAGE, _CHUNK, _DATA_END = 0x03, 0x04, 0x05, 0x06, 0x0F


class McapError(ValueError):
    """A file that is not an MCAP file; the message is one sentence for the user."""


class Schema(NamedTuple):
    """A message type: its name, e.g. ``std_msgs/msg/String``, how it is defined, and its definition."""

    name: str
    encoding: str
    text: str


class Message(NamedTuple):
    """A message in a bag: topic, type, time of its receipt [ns], CDR bytes."""

    topic: str
    schema: Schema
    time: int
    data: bytes


class _Damaged(Exception):  # noqa: N818 - never leaves this module
    """The rest of the file cannot be read."""


def read_messages(path: Path) -> Iterator[Message]:
    """Yield every complete message of an MCAP file, in the order of the file.

    Raises:
        McapError: If it cannot be read or does not start like an MCAP file.
    """
    try:
        with path.open("rb") as file:
            if file.read(len(MAGIC)) != MAGIC:
                raise McapError(f"'{path}' is not an MCAP file")
            yield from _Reader().messages(file, os.fstat(file.fileno()).st_size)
    except OSError as error:
        raise McapError(f"'{path}' cannot be read: {error.strerror}") from None


class _Reader:
    def __init__(self) -> None:
        self._schemas: dict[int, Schema] = {}
        self._channels: dict[int, tuple[str, Schema]] = {}

    def messages(self, file: BinaryIO, size: int, depth: int = 0) -> Iterator[Message]:
        """Yield the messages of a file or of the content of a chunk, of `size` bytes."""
        while True:
            head = file.read(9)
            if len(head) < 9:
                return
            code, length = head[0], int.from_bytes(head[1:], "little")
            if code == _DATA_END:
                return
            present = min(length, max(size - file.tell(), 0))
            if code not in (_SCHEMA, _CHANNEL, _MESSAGE, _CHUNK) or present > MAX_RECORD:
                file.seek(present, os.SEEK_CUR)
                continue
            content = file.read(present)
            try:
                if code == _CHUNK:
                    if depth == 0:  # nested chunks are not allowed
                        inside = _inside(content, whole=present == length)
                        yield from self.messages(BytesIO(inside), len(inside), depth=1)
                elif present < length:
                    return
                elif (message := self._take(code, content)) is not None:
                    yield message
            except (_Damaged, struct.error, UnicodeDecodeError):
                continue  # the next record may be complete

    def _take(self, code: int, content: bytes) -> Message | None:
        """Remember a schema or a channel; return a message."""
        if code == _SCHEMA:
            (number,) = struct.unpack_from("<H", content)
            name, offset = _string(content, 2)
            encoding, offset = _string(content, offset)
            text, _ = _string(content, offset)
            self._schemas[number] = Schema(name, encoding, text)
        elif code == _CHANNEL:
            number, schema = struct.unpack_from("<HH", content)
            topic, offset = _string(content, 4)
            encoding, _ = _string(content, offset)
            if schema in self._schemas and encoding == "cdr":
                self._channels[number] = (topic, self._schemas[schema])
        else:
            channel, _, time, _ = struct.unpack_from("<HIQQ", content)
            if channel in self._channels:
                topic, kind = self._channels[channel]
                return Message(topic, kind, time, content[22:])
        return None


def _inside(content: bytes, *, whole: bool) -> bytes:
    """Return the decompressed records of a chunk; those that exist if it was cut off."""
    size, _ = struct.unpack_from("<QI", content, 16)
    compression, offset = _string(content, 28)
    offset += 8
    if not compression:
        return content[offset:]
    if not whole or size > MAX_RECORD:
        raise _Damaged
    return _decompress(compression, content[offset:], size)


def _decompress(compression: str, data: bytes, size: int) -> bytes:
    try:
        if compression == "lz4":
            raw: bytes = lz4.frame.LZ4FrameDecompressor().decompress(data, max_length=size)
        elif compression == "zstd":
            raw = zstd.ZstdDecompressor().decompress(data, max_length=size)
        else:
            raise _Damaged
    except (EOFError, RuntimeError, ValueError, zstd.ZstdError) as error:
        raise _Damaged from error
    if len(raw) != size:
        raise _Damaged
    return raw


def _string(content: bytes, offset: int) -> tuple[str, int]:
    """Return a string and the offset of its end."""
    (length,) = struct.unpack_from("<I", content, offset)
    start = offset + 4
    if length > len(content) - start:
        raise _Damaged
    return content[start : start + length].decode(), start + length
