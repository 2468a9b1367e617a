"""The messages of a rosbag2 bag, whatever stores them: MCAP or SQLite, compressed, in one file or several.

What a bag is made of is seen from its files. `metadata.yaml`, which a killed recorder leaves incomplete or does not
write at all, is not read.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory

from backports import zstd

from mobo_tuner.errors import UserError
from mobo_tuner.runs import mcap_records, sqlite_records
from mobo_tuner.runs.mcap_records import MAX_RECORD, McapError, Message
from mobo_tuner.runs.sqlite_records import SqliteError

METADATA = "metadata.yaml"
SUFFIXES = (".mcap", ".db3", ".mcap.zstd", ".db3.zstd")
"""Endings of the files of a bag; the launcher has the same list."""

MAX_FILE = 1 << 36  # bytes of a decompressed file
_ZSTD = b"\x28\xb5\x2f\xfd"  # begins a compressed message; one that is not compressed begins with 0


class BagError(UserError):
    """A bag that cannot be read, or from which no run can be rebuilt."""


def is_bag(path: Path) -> bool:
    """Return whether a path is that of a bag's folder or of one of its files."""
    return path.exists() and ((path / METADATA).is_file() or bool(_files(path)))


def read_bag(path: Path) -> Iterator[Message]:
    """Yield every whole message of a bag, file by file.

    Args:
        path: Folder of the bag, or one of its files.

    Raises:
        BagError: If there is no such bag, or it cannot be read.
    """
    if not path.exists():
        raise BagError(f"'{path}' cannot be read: No such file or directory")
    files = _files(path) if path.is_dir() else [path]
    if not files:
        raise BagError(f"'{path}' holds no MCAP file and no SQLite file")
    try:
        for file in files:
            with _decompressed(file) as plain:
                storage = sqlite_records if plain.suffix == ".db3" else mcap_records
                for message in storage.read_messages(plain):
                    if (whole := _whole(message)) is not None:
                        yield whole
    except (McapError, SqliteError) as error:
        raise BagError(str(error)) from None


def _files(path: Path) -> list[Path]:
    """Return the files of a bag; those of a split one in their order."""
    if not path.is_dir():
        return [path] if path.name.endswith(SUFFIXES) else []
    files = [file for file in path.iterdir() if file.name.endswith(SUFFIXES)]
    return sorted(files, key=lambda file: _natural(file.name))


def _natural(name: str) -> list[tuple[int, str]]:
    """Return a key that sorts `bag_10` after `bag_9`."""
    return [(int(n or 0), text) for text, n in re.findall(r"([^0-9]*)([0-9]{0,18})", name)]


@contextmanager
def _decompressed(file: Path) -> Iterator[Path]:
    """Give the plain file of one that is compressed as a whole, and the file itself otherwise."""
    if file.suffix != ".zstd":
        yield file
        return
    with TemporaryDirectory() as scratch:
        plain = Path(scratch, file.stem)
        try:
            with zstd.open(file, "rb") as source, plain.open("wb") as target:
                size = 0
                while block := source.read(1 << 20):
                    size += len(block)
                    if size > MAX_FILE:
                        raise BagError(f"'{file}' holds more than the {MAX_FILE} bytes allowed")
                    target.write(block)
        except (EOFError, zstd.ZstdError):
            pass  # it was cut off; what came before is there
        except OSError as error:
            raise BagError(f"'{file}' cannot be read: {error.strerror}") from None
        yield plain


def _whole(message: Message) -> Message | None:
    """Return a message whose data is not compressed; None if they are damaged."""
    if not message.data.startswith(_ZSTD):
        return message
    try:
        data = zstd.ZstdDecompressor().decompress(message.data, max_length=MAX_RECORD)
    except zstd.ZstdError:
        return None
    return message._replace(data=data)
