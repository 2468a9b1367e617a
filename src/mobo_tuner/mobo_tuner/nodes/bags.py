"""The bag that a recorder writes: by `rosbag2_py` where ROS 2 has it, otherwise by `rosbags`, with the same content.

The wheels have no `rosbag2_py`, and apt has no `rosbags`. Both bags have MCAP storage and the same topics, definitions,
type hashes, profiles and messages. They differ if the recorder is killed: `BagWriter` has made everything readable a
quarter of a second before, while `rosbag2_py` writes `metadata.yaml` only when it is closed, and its last messages may
be missing.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Protocol

from rclpy.duration import Duration
from rclpy.qos import QoSProfile

from mobo_tuner.runs.definitions import Definition


class Bag(Protocol):
    """A bag that is open for writing. Every method may raise OSError."""

    @property
    def path(self) -> Path:
        """Folder of the bag."""

    @property
    def message_count(self) -> int:
        """Number of messages written so far."""

    def add_topic(
        self, name: str, type_name: str, definition: Definition, offers: Sequence[QoSProfile]
    ) -> Any:
        """Add a topic with its publishers' profiles; return what `write` needs of it."""

    def write(self, topic: Any, timestamp: int, data: bytes) -> None:
        """Write one message, received at `timestamp` [ns since the epoch]."""

    def flush(self) -> None:
        """Make all messages so far readable, as far as the library can."""

    def close(self) -> None:
        """Complete the bag."""

    def abort(self) -> None:
        """Close the bag as it is, after a failure."""


def open_bag(path: str) -> Bag:
    """Create a bag.

    Args:
        path: Folder of the bag.

    Raises:
        FileExistsError: If there is such a folder.
        OSError: If it cannot be created.
    """
    if Path(path).exists():
        raise FileExistsError(path)
    return Rosbag2Bag(path) if find_spec("rosbag2_py") else RosbagsBag(path)


class RosbagsBag:
    """A bag that `rosbags` writes."""

    def __init__(self, path: str) -> None:
        from mobo_tuner.runs.bag import BagWriter  # needs rosbags, which apt's ROS does not have

        self._writer = BagWriter(path)
        self._writer.open()

    @property
    def path(self) -> Path:
        """Folder of the bag."""
        return self._writer.path

    @property
    def message_count(self) -> int:
        """Number of messages written so far."""
        return self._writer.message_count

    def add_topic(
        self, name: str, type_name: str, definition: Definition, offers: Sequence[QoSProfile]
    ) -> Any:
        """Add a topic; return its connection."""
        return self._writer.add_connection(
            name,
            type_name,
            msgdef=definition.text,
            rihs01=definition.type_hash,
            offered_qos_profiles=[_rosbags_qos(profile) for profile in _distinct(offers)],
        )

    def write(self, topic: Any, timestamp: int, data: bytes) -> None:
        """Write one message."""
        self._writer.write(topic, timestamp, data)

    def flush(self) -> None:
        """Make all messages so far readable."""
        self._writer.flush()

    def close(self) -> None:
        """Complete the bag with its index."""
        self._writer.close()

    def abort(self) -> None:
        """Close the bag as of the last flush."""
        self._writer.abort()


class Rosbag2Bag:
    """A bag that `rosbag2_py` writes; it finds the definitions itself."""

    def __init__(self, path: str) -> None:
        import rosbag2_py

        self.path = Path(path)
        self.message_count = 0
        self._library = rosbag2_py
        self._topics = 0
        # Without chunks, so that each message goes to the file at once.
        storage = rosbag2_py.StorageOptions(
            uri=path, storage_id="mcap", storage_preset_profile="fastwrite"
        )
        with _as_os_error():
            self._writer = rosbag2_py.SequentialWriter()
            self._writer.open(storage, rosbag2_py.ConverterOptions("cdr", "cdr"))

    def add_topic(
        self, name: str, type_name: str, definition: Definition, offers: Sequence[QoSProfile]
    ) -> str:
        """Add a topic; return its name."""
        metadata = self._library.TopicMetadata(
            id=self._topics,
            name=name,
            type=type_name,
            serialization_format="cdr",
            offered_qos_profiles=[_rosbag2_qos(profile) for profile in _distinct(offers)],
            type_description_hash=definition.type_hash,
        )
        with _as_os_error():
            self._writer.create_topic(metadata)
        self._topics += 1
        return name

    def write(self, topic: str, timestamp: int, data: bytes) -> None:
        """Write one message."""
        with _as_os_error():
            self._writer.write(topic, data, timestamp)
        self.message_count += 1

    def flush(self) -> None:
        """Do nothing: each message has been written."""

    def close(self) -> None:
        """Complete the bag with its metadata."""
        with _as_os_error():
            self._writer.close()

    def abort(self) -> None:
        """Close the bag as it is."""
        self.close()


@contextlib.contextmanager
def _as_os_error() -> Iterator[None]:
    """Raise the errors of rosbag2, of which all are RuntimeError, as OSError."""
    try:
        yield
    except RuntimeError as error:
        raise OSError(str(error)) from None


def _distinct(offers: Sequence[QoSProfile]) -> list[QoSProfile]:
    found: list[QoSProfile] = []
    for profile in offers:
        if profile not in found:
            found.append(profile)
    return found


def _rosbags_qos(profile: QoSProfile) -> Any:
    """Return a publisher's profile for rosbags; discovery provides neither history nor depth."""
    from rosbags.interfaces import Qos, QosDurability, QosHistory, QosLiveliness, QosReliability

    return Qos(
        history=QosHistory[profile.history.name],
        depth=profile.depth,
        reliability=QosReliability[profile.reliability.name],
        durability=QosDurability[profile.durability.name],
        deadline=_rosbags_time(profile.deadline),
        lifespan=_rosbags_time(profile.lifespan),
        liveliness=QosLiveliness[profile.liveliness.name],
        liveliness_lease_duration=_rosbags_time(profile.liveliness_lease_duration),
        avoid_ros_namespace_conventions=profile.avoid_ros_namespace_conventions,
    )


def _rosbags_time(duration: Duration) -> Any:
    from rosbags.interfaces import QosTime

    return QosTime(*divmod(duration.nanoseconds, 1_000_000_000))


def _rosbag2_qos(profile: QoSProfile) -> Any:
    """Return a publisher's profile for rosbag2_py, which has its own classes of them."""
    from rosbag2_py import _storage

    def time(duration: Duration) -> Any:
        seconds, nanoseconds = divmod(duration.nanoseconds, 1_000_000_000)
        return _storage.Duration(seconds, nanoseconds)

    qos = _storage.QoS(profile.depth)
    qos.history(_storage.rmw_qos_history_policy_t(int(profile.history)))
    qos.reliability(_storage.rmw_qos_reliability_policy_t(int(profile.reliability)))
    qos.durability(_storage.rmw_qos_durability_policy_t(int(profile.durability)))
    qos.deadline(time(profile.deadline))
    qos.lifespan(time(profile.lifespan))
    qos.liveliness(_storage.rmw_qos_liveliness_policy_t(int(profile.liveliness)))
    qos.liveliness_lease_duration(time(profile.liveliness_lease_duration))
    qos.avoid_ros_namespace_conventions(profile.avoid_ros_namespace_conventions)
    return qos
