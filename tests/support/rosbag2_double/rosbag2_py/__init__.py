"""A double of what the recorder uses of `rosbag2_py` of ROS 2 Jazzy, which the wheels do not have.

It takes exactly the arguments that the library takes, and writes what it is told with rosbags. Like the library, it
finds the definitions in the installed packages by itself.
"""

from __future__ import annotations

import sys
from pathlib import Path

from rosbags.interfaces import Qos
from rosbags.rosbag2 import StoragePlugin, Writer, WriterError
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from rosbag2_py._storage import QoS


class StorageOptions:
    def __init__(
        self,
        uri: str,
        storage_id: str = "",
        max_bagfile_size: int = 0,
        max_bagfile_duration: int = 0,
        max_cache_size: int = 0,
        storage_preset_profile: str = "",
    ) -> None:
        assert isinstance(uri, str)
        assert (storage_id, storage_preset_profile) == ("mcap", "fastwrite")
        assert (max_bagfile_size, max_bagfile_duration, max_cache_size) == (0, 0, 0)
        self.uri = uri


class ConverterOptions:
    def __init__(
        self, input_serialization_format: str = "", output_serialization_format: str = ""
    ) -> None:
        assert input_serialization_format == output_serialization_format == "cdr"


class TopicMetadata:
    def __init__(
        self,
        id: int,
        name: str,
        type: str,
        serialization_format: str,
        offered_qos_profiles: list[QoS] | None = None,
        type_description_hash: str = "",
    ) -> None:
        assert isinstance(id, int)
        assert serialization_format == "cdr"
        self.name, self.type, self.type_description_hash = name, type, type_description_hash
        self.offered: list[Qos] = [qos.profile() for qos in offered_qos_profiles or []]


class SequentialWriter:
    def open(self, storage: StorageOptions, converter: ConverterOptions) -> None:
        assert isinstance(converter, ConverterOptions)
        self._writer = Writer(storage.uri, version=9, storage_plugin=StoragePlugin.MCAP)
        try:
            self._writer.open()
        except (OSError, WriterError) as error:
            raise RuntimeError(str(error)) from None
        self._store = get_typestore(Stores.ROS2_JAZZY)
        folder = Path(sys.prefix, "share", "mobo_msgs_py", "msg")
        for file in folder.glob("*.msg"):
            name = f"mobo_msgs_py/msg/{file.stem}"
            if name not in self._store.fielddefs:
                self._store.register(get_types_from_msg(file.read_text(), name))
        self._connections: dict[str, object] = {}

    def create_topic(self, topic: TopicMetadata) -> None:
        msgdef, _ = self._store.generate_msgdef(topic.type, ros_version=2)
        self._connections[topic.name] = self._writer.add_connection(
            topic.name,
            topic.type,
            msgdef=msgdef,
            rihs01=topic.type_description_hash,
            offered_qos_profiles=topic.offered,
        )

    def write(self, topic_name: str, message: bytes, time_stamp: int) -> None:
        assert isinstance(message, bytes)
        self._writer.write(self._connections[topic_name], time_stamp, message)  # type: ignore[arg-type]

    def close(self) -> None:
        self._writer.close()
