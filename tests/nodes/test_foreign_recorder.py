"""A run that an independent recorder recorded, as `ros2 bag record -a` does: nothing that rebuild needs is missing."""

from __future__ import annotations

import importlib
import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import pytest
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from mobo_msgs_py.action import Tune
from mobo_tuner.runs.journal import JsonRecord, read_journal
from mobo_tuner.runs.rebuild import main as rebuild
from mobo_tuner.runs.replay import main as replay
from tests.support.processes import NodeStarter
from tests.support.tuner import CONFIG, GoalClient

Spin = Callable[..., None]
TOY = ["--ros-args", "--params-file", str(CONFIG / "toy.yaml")]
NAMESPACE = ["-r", "__ns:=/A"]
EVALUATIONS = 9
pytestmark = pytest.mark.filterwarnings("ignore:module 'sre_:DeprecationWarning")


class RawRecorder:
    """Subscribes to every topic as it appears, and keeps the messages as they were sent."""

    def __init__(self, node: Node) -> None:
        self._node = node
        self.types: dict[str, str] = {}
        self.messages: list[tuple[str, int, bytes]] = []
        node.create_timer(0.1, self._discover)

    def _discover(self) -> None:
        for topic, (type_name, *_) in self._node.get_topic_names_and_types():
            offers = [p.qos_profile for p in self._node.get_publishers_info_by_topic(topic)]
            if topic in self.types or "/_" in topic or not offers:
                continue
            package, _, name = type_name.split("/")
            latched = all(o.durability == DurabilityPolicy.TRANSIENT_LOCAL for o in offers)
            reliable = all(o.reliability == ReliabilityPolicy.RELIABLE for o in offers)
            qos = QoSProfile(
                depth=1000,
                durability=DurabilityPolicy.TRANSIENT_LOCAL
                if latched
                else DurabilityPolicy.VOLATILE,
                reliability=ReliabilityPolicy.RELIABLE
                if reliable
                else ReliabilityPolicy.BEST_EFFORT,
            )
            kind = getattr(importlib.import_module(f"{package}.msg"), name)
            keep = partial(self._keep, topic)
            self._node.create_subscription(kind, topic, keep, qos, raw=True)
            self.types[topic] = type_name

    def _keep(self, topic: str, data: bytes, info: dict[str, int]) -> None:
        self.messages.append((topic, info["received_timestamp"], bytes(data)))

    def write(self, bag: Path, storage: StoragePlugin) -> Path:
        """Write a bag with the definitions that are installed for other programs."""
        store = get_typestore(Stores.ROS2_JAZZY)
        folder = Path(sys.prefix, "share", "mobo_msgs_py", "msg")
        types: dict[str, Any] = {}
        for file in folder.glob("*.msg"):
            types |= get_types_from_msg(file.read_text(), f"mobo_msgs_py/msg/{file.stem}")
        store.register(types)
        with Writer(bag, version=9, storage_plugin=storage) as writer:
            connections = {
                topic: writer.add_connection(topic, type_name, typestore=store)
                for topic, type_name in self.types.items()
            }
            for topic, time, data in sorted(self.messages, key=lambda message: message[1]):
                writer.write(connections[topic], time, data)
        return bag


def lived(journal: list[JsonRecord]) -> list[JsonRecord]:
    return [r for r in journal if r["type"] in ("start", "change", "evaluation")]


def test_a_run_is_rebuilt_and_replayed_bit_for_bit_from_a_plain_recording(
    start_node: NodeStarter,
    node: Node,
    spin_until: Spin,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    recorder = RawRecorder(node)
    start_node("-m", "awa_sim_node.node", *TOY, *NAMESPACE)
    runs = ["-p", f"runs_dir:={tmp_path / 'runs'}", "-p", "seed:=5"]
    start_node("-m", "mobo_tuner.nodes.tuner", *TOY, *NAMESPACE, *runs)
    client = GoalClient(node, spin_until, Tune, "A/tune")
    client.send(Tune.Goal(run_id="run", evaluations=EVALUATIONS))
    result = client.wait(60.0)
    assert result.stop_reason == Tune.Result.STOP_REASON_BUDGET, result.error_msg
    wanted = {f"/A/{name}" for name in ("run_records", "problem", "evaluation", "status")}

    def evaluations() -> int:
        return sum(topic == "/A/evaluation" for topic, _, _ in recorder.messages)

    spin_until(lambda: wanted <= {*recorder.types}, "the topics of the run")
    spin_until(lambda: evaluations() == EVALUATIONS, "every evaluation")

    journal = read_journal(tmp_path / "runs" / "run")
    for storage in StoragePlugin:
        bag = recorder.write(tmp_path / storage.name, storage)
        folder = tmp_path / "rebuilt" / storage.name
        folder.parent.mkdir(exist_ok=True)
        assert rebuild([str(bag), str(folder)]) == 0, capsys.readouterr().err
        assert lived(read_journal(folder)) == lived(journal)
        assert replay([str(bag)]) == 0
        assert f"{EVALUATIONS} identical bit for bit" in capsys.readouterr().out
