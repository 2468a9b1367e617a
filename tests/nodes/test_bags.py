"""The recorder's two ways to write a bag: by rosbags, and by rosbag2_py, of which a double is here."""

from __future__ import annotations

import itertools
import sys
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any

import pytest
from rclpy.duration import Duration
from rclpy.qos import QoSProfile, qos_profile_sensor_data
from rclpy.serialization import serialize_message
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore
from std_msgs.msg import Float64

from mobo_msgs_py.msg import Evaluation
from mobo_tuner.nodes.bags import Bag, Rosbag2Bag, RosbagsBag, open_bag
from mobo_tuner.ros.qos import KEPT, LATCHED, STREAM
from mobo_tuner.runs.definitions import find_definition

DOUBLE = Path(__file__).parents[1] / "support" / "rosbag2_double"
SLOW = QoSProfile(depth=3, deadline=Duration(seconds=1.25), lifespan=Duration(seconds=2))
TOPICS = {
    "/evaluation": (Evaluation, [KEPT]),
    "/latest": (Evaluation, [LATCHED, LATCHED, STREAM]),
    "/plot/x": (Float64, [qos_profile_sensor_data]),
    "/slow": (Float64, [SLOW]),
}


@pytest.fixture
def rosbag2(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """The double of rosbag2_py, as if ROS 2 had it."""
    monkeypatch.syspath_prepend(str(DOUBLE))
    yield
    for name in [name for name in sys.modules if name.split(".")[0] == "rosbag2_py"]:
        del sys.modules[name]


@cache  # serialized once for all bags: the bytes between the fields of a message are random
def serialized(name: str, index: int) -> bytes:
    if "x" in name:
        return serialize_message(Float64(data=index / 3))
    return serialize_message(Evaluation(index=index, run_id="run"))


def fill(bag: Bag) -> None:
    topics = {}
    for name, (kind, offers) in TOPICS.items():
        package, folder, *_ = kind.__module__.split(".")
        type_name = f"{package}/{folder}/{kind.__name__}"
        topics[name] = bag.add_topic(name, type_name, find_definition(type_name), offers)
    for index, name in itertools.product(range(3), list(TOPICS)[:3]):  # one stays empty
        bag.write(topics[name], 1_000_000_000 + index, serialized(name, index))
        bag.flush()
    assert bag.message_count == 9
    bag.close()


def content(path: Path) -> tuple[Any, ...]:
    """What any reader finds in a bag: topics with all that is told of them, and messages."""
    with AnyReader([path], default_typestore=get_typestore(Stores.EMPTY)) as reader:
        extensions: dict[str, Any] = {c.topic: c.ext for c in reader.connections}
        topics = {
            c.topic: (c.msgtype, c.digest, c.msgcount, extensions[c.topic].offered_qos_profiles)
            for c in reader.connections
        }
        messages = [(c.topic, time, bytes(data)) for c, time, data in reader.messages()]
    return topics, sorted(messages)


@pytest.mark.usefixtures("rosbag2")
def test_both_bags_have_the_same_content(tmp_path: Path) -> None:
    bags: tuple[Bag, Bag] = (RosbagsBag(str(tmp_path / "one")), open_bag(str(tmp_path / "other")))
    assert isinstance(bags[1], Rosbag2Bag)
    for bag in bags:
        fill(bag)
    one, other = (content(bag.path) for bag in bags)
    assert one == other
    topics, messages = one
    assert {*topics} == {*TOPICS}
    assert len(messages) == 9
    assert len(topics["/latest"][3]) == 2  # of three publishers, two have the same profile
    (slow,) = topics["/slow"][3]
    assert (slow.deadline.sec, slow.deadline.nsec) == (1, 250_000_000)


def test_without_rosbag2_the_bag_is_that_of_rosbags(tmp_path: Path) -> None:
    bag = open_bag(str(tmp_path / "bag"))
    assert isinstance(bag, RosbagsBag)
    bag.close()


@pytest.mark.usefixtures("rosbag2")
def test_a_bag_that_exists_or_cannot_be_created_is_an_os_error(tmp_path: Path) -> None:
    with pytest.raises(FileExistsError):
        open_bag(str(tmp_path))
    (tmp_path / "file").touch()
    with pytest.raises(OSError, match="file"):
        open_bag(str(tmp_path / "file" / "bag"))
