"""A rosbag2 folder that is readable at any time, also after its writer was killed.

The writer of `rosbags` keeps up to 1 MiB in memory and completes the file only when it is closed.
Here each `BagWriter.flush` writes all messages and a footer, which the next flush overwrites, and updates
`metadata.yaml`. So only the messages since the last flush are lost if the process is killed.
"""

from __future__ import annotations

import contextlib
import json
from copy import deepcopy
from io import BytesIO
from pathlib import Path
from typing import Any

import yaml
from rosbags.interfaces import Connection, ConnectionExtRosbag2
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.rosbag2.enums import CompressionMode
from rosbags.rosbag2.metadata import dump_qos_v9
from rosbags.rosbag2.storage_mcap import McapWriter

# The records DataEnd and Footer, without a summary, and the magic bytes at the end.
_ENDING = b"".join(
    (
        b"\x0f" + (4).to_bytes(8, "little") + bytes(4),
        b"\x02" + (20).to_bytes(8, "little") + bytes(20),
        b"\x89MCAP0\r\n",
    )
)


class BagWriter(Writer):
    """Writer of a rosbag2 folder with MCAP storage; open it before use, then close or abort it.

    Messages must be written in the order of their timestamps, because readers do not sort a bag without
    an index. Every method may raise OSError if the disk is full; `abort` then leaves the bag as of the
    last flush.
    """

    def __init__(self, path: str | Path) -> None:
        super().__init__(path, version=9, storage_plugin=StoragePlugin.MCAP)

    @property
    def message_count(self) -> int:
        """Number of messages written so far."""
        return sum(self.counts.values())

    def open(self) -> None:
        """Create the folder, which must not exist, with an empty bag."""
        super().open()
        self.flush()

    def write(self, connection: Connection, timestamp: int, data: bytes | memoryview) -> None:
        """Write one message, received at `timestamp` [ns since the epoch]."""
        super().write(connection, timestamp, data)
        if not self._storage.chunk.msgs:  # the message filled its chunk
            self.flush()

    def flush(self) -> None:
        """Make all messages so far readable."""
        if self._storage.flush():
            # JSON is valid YAML, and faster to write.
            self._replace_metadata(json.dumps(self._metadata()))

    def close(self) -> None:
        """Complete the bag with its index.

        That of `rosbags` takes a third of a second to write the metadata of fifty topics.
        """
        storage, metadata = self._storage, self._metadata()
        storage.close(self.version, _as_yaml(metadata["rosbag2_bagfile_information"]).strip())
        self.storage = None
        self._replace_metadata(_as_yaml(metadata))

    @property
    def _storage(self) -> _Storage:
        assert isinstance(self.storage, _Storage), "the bag is not open"
        return self.storage

    def _metadata(self) -> dict[str, Any]:
        """Return what `metadata.yaml` says of the messages so far."""
        count = self.message_count
        start = self.min_timestamp if count else 0
        span = {
            "starting_time": {"nanoseconds_since_epoch": start},
            "duration": {"nanoseconds": self.max_timestamp - start if count else 0},
            "message_count": count,
        }
        file_name = self._storage.path.name
        information = {
            "version": self.version,
            "storage_identifier": "mcap",
            "relative_file_paths": [file_name],
            **span,
            "topics_with_message_count": [
                {
                    "topic_metadata": {
                        "name": connection.topic,
                        "type": connection.msgtype,
                        "serialization_format": connection.ext.serialization_format,
                        "offered_qos_profiles": dump_qos_v9(connection.ext.offered_qos_profiles),
                        "type_description_hash": connection.digest,
                    },
                    "message_count": self.counts[connection.id],
                }
                for connection in self.connections
                if isinstance(connection.ext, ConnectionExtRosbag2)
            ],
            "compression_format": "",
            "compression_mode": "",
            "files": [
                {"path": file_name, **deepcopy(span)}
            ],  # a second mention would be an alias in YAML
            "custom_data": None,
            "ros_distro": "rosbags",
        }
        return {"rosbag2_bagfile_information": information}

    def _replace_metadata(self, text: str) -> None:
        temporary = self.metapath.with_suffix(".yaml.tmp")
        try:
            temporary.write_text(text, encoding="utf-8")
            temporary.replace(self.metapath)
        except OSError:
            with contextlib.suppress(OSError):
                temporary.unlink()
            raise


def _as_yaml(content: dict[str, Any]) -> str:
    """Return YAML for people, of one line for each value."""
    dumper = getattr(yaml, "CSafeDumper", yaml.SafeDumper)  # not every PyYAML has libyaml
    text: str = yaml.dump(content, Dumper=dumper, width=1000)
    return text


class _Storage(McapWriter):
    """An MCAP file that is complete after each flush."""

    def __init__(self, path: Path, compression: CompressionMode) -> None:
        super().__init__(path, compression)
        self._start = self.bio.tell()
        self._end = -1  # of the data, without the ending, as of the last flush

    def flush(self) -> bool:
        """Write pending data and an ending; return whether there was any."""
        if self.chunk.msgs:
            self.close_chunk()
        elif self.chunk.bio.tell():  # schemas and channels alone need no chunk
            self.bio.write(self.chunk.bio.getbuffer())
            self.chunk.bio = BytesIO()
        end = self.bio.tell()
        if end == self._end:
            return False
        self.bio.write(_ENDING)
        self.bio.flush()
        self.bio.seek(end)
        self._end = end
        return True

    def close(self, version: int, metadata: str) -> None:
        """Complete the file with its index."""
        self.flush()
        super().close(version, metadata)

    def abort(self) -> None:
        """Close the file as of the last flush."""
        with contextlib.suppress(OSError):
            self.bio.close()
        with self.path.open("r+b") as file:
            file.truncate(max(self._end, self._start))
            file.seek(0, 2)
            file.write(_ENDING)


BagWriter.STORAGE_PLUGINS = {StoragePlugin.MCAP: _Storage}
