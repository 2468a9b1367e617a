"""The bag: readable by everybody after each flush."""

from __future__ import annotations

import inspect
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml
from mcap.reader import make_reader
from rosbags.interfaces import Connection
from rosbags.rosbag2 import Reader, StoragePlugin, Writer, WriterError
from rosbags.rosbag2.metadata import dump_qos_v9
from rosbags.rosbag2.storage_mcap import McapWriter

from mobo_tuner.runs.bag import BagWriter

DEFINITION = "string data\n"
TYPE_HASH = "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18"


@pytest.fixture
def bag(tmp_path: Path) -> Iterator[BagWriter]:
    """A bag that is open."""
    bag = BagWriter(tmp_path / "bag")
    bag.open()
    yield bag
    if bag.storage is not None:
        bag.abort()


def connect(bag: BagWriter, topic: str = "/text") -> Connection:
    """Add a topic of texts."""
    return bag.add_connection(topic, "std_msgs/msg/String", msgdef=DEFINITION, rihs01=TYPE_HASH)


def timestamps(path: Path) -> list[int]:
    """What both readers find, which must be the same."""
    with Reader(path) as reader:
        found = [timestamp for _, timestamp, _ in reader.messages()]
        assert reader.message_count == len(found)
        counts = {connection.topic: connection.msgcount for connection in reader.connections}
        assert sum(counts.values()) == len(found)
    with (path / f"{path.name}.mcap").open("rb") as file:
        assert [m.log_time for _, _, m in make_reader(file).iter_messages()] == found
    return found


def test_a_new_bag_is_readable_and_empty(bag: BagWriter) -> None:
    assert timestamps(bag.path) == []


def test_what_was_flushed_is_readable_while_the_bag_is_open(bag: BagWriter) -> None:
    text = connect(bag)
    bag.flush()
    assert timestamps(bag.path) == []
    for stamp in range(10, 15):
        bag.write(text, stamp, b"\0\1\0\0")
        assert bag.message_count == stamp - 9
    assert timestamps(bag.path) == []
    bag.flush()
    assert timestamps(bag.path) == [10, 11, 12, 13, 14]
    other = connect(bag, "/other")
    bag.write(other, 15, b"\0\1\0\0")
    bag.flush()
    bag.flush()
    assert timestamps(bag.path) == [10, 11, 12, 13, 14, 15]


def test_a_large_message_is_flushed_of_itself(bag: BagWriter) -> None:
    text = connect(bag)
    bag.write(text, 1, bytes(2**21))
    assert timestamps(bag.path) == [1]


def test_a_closed_bag_is_complete(bag: BagWriter) -> None:
    text = connect(bag)
    for stamp in range(3):
        bag.write(text, stamp, b"\0\1\0\0")
        bag.flush()
    bag.write(text, 3, b"\0\1\0\0")
    connect(bag, "/silent")
    bag.close()
    assert timestamps(bag.path) == [0, 1, 2, 3]
    with (bag.path / "bag.mcap").open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    assert summary.statistics is not None
    assert summary.statistics.message_count == 4
    assert {channel.topic for channel in summary.channels.values()} == {"/text", "/silent"}


def test_an_aborted_bag_holds_what_was_flushed(bag: BagWriter) -> None:
    text = connect(bag)
    bag.write(text, 1, b"\0\1\0\0")
    bag.flush()
    bag.write(text, 2, b"\0\1\0\0")
    bag.abort()
    assert timestamps(bag.path) == [1]


def test_an_existing_folder_is_left_alone(tmp_path: Path) -> None:
    (tmp_path / "bag").mkdir()
    with pytest.raises(WriterError, match="exists already"):
        BagWriter(tmp_path / "bag")


def test_the_metadata_are_those_that_rosbags_writes(tmp_path: Path) -> None:
    """They must be the same while the bag is open and at its end.

    If this fails after an update of rosbags, `_metadata` must follow its new format.
    """
    found = {}
    for name, kind in (("ours", BagWriter), ("plain", Writer)):
        options: Any = (
            {} if kind is BagWriter else {"version": 9, "storage_plugin": StoragePlugin.MCAP}
        )
        bag: Any = kind(tmp_path / name / "bag", **options)
        (tmp_path / name).mkdir()
        bag.open()
        text = connect(bag)
        for stamp in (5, 7):
            bag.write(text, stamp, b"\0\1\0\0")
        if isinstance(bag, BagWriter):
            bag.flush()
            found["open"] = yaml.safe_load((bag.path / "metadata.yaml").read_text(encoding="utf-8"))
        bag.close()
        found[name] = yaml.safe_load((bag.path / "metadata.yaml").read_text(encoding="utf-8"))
    assert found["open"] == found["ours"] == found["plain"]


def test_the_parts_of_rosbags_that_the_writer_is_made_of() -> None:
    """Its MCAP writer is not for everybody; this says what of it must stay, or be followed."""
    assert {"path", "compression"} <= {*inspect.signature(McapWriter.__init__).parameters}
    assert {"version", "metadata"} <= {*inspect.signature(McapWriter.close).parameters}
    assert callable(McapWriter.close_chunk), "it writes the messages that are pending"
    assert StoragePlugin.MCAP in Writer.STORAGE_PLUGINS, "a writer finds its storage there"
    assert callable(dump_qos_v9), "metadata name QoS profiles in its way"
