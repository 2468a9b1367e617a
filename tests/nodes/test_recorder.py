"""The recorder: a bag with every message, whatever happens to the process."""

from __future__ import annotations

import resource
import shutil
import signal
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import yaml
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from mcap.reader import NonSeekingReader, make_reader
from mcap_ros2.decoder import DecoderFactory
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import qos_profile_sensor_data
from rclpy.serialization import serialize_message
from rosbags.highlevel import AnyReader
from rosbags.interfaces import QosDurability, QosReliability
from rosbags.typesys import Stores, get_typestore
from rosgraph_msgs.msg import Clock
from std_msgs.msg import Float64, String
from std_srvs.srv import Trigger

from mobo_msgs_py.action import Tune
from mobo_msgs_py.msg import Evaluation, NamedValue, Problem, RecorderStatus, Variable
from mobo_tuner.nodes.recorder import REPEAT_PERIOD, Repetitions
from mobo_tuner.ros.qos import LATCHED, STREAM
from mobo_tuner.runs.rebuild import records_of_bag
from tests.support.processes import NodeProcess, NodeStarter
from tests.support.tuner import GoalClient, Listener, journal

SpinUntil = Callable[..., None]


class Recording:
    """A recorder process, and what it says of itself."""

    def __init__(
        self,
        start: NodeStarter,
        node: Node,
        spin_until: SpinUntil,
        bag: Path,
        *arguments: str,
        **options: Any,
    ) -> None:
        self.bag = bag
        self.node = node
        self.spin_until = spin_until
        self.status = RecorderStatus()
        self.statuses = 0
        node.create_subscription(RecorderStatus, "recorder_status", self._on_status, LATCHED)
        self.process: NodeProcess = start(
            "-m",
            "mobo_tuner.nodes.recorder",
            "--ros-args",
            "-p",
            f"bag_path:={bag}",
            *arguments,
            **options,
        )

    def _on_status(self, status: RecorderStatus) -> None:
        self.status = status
        self.statuses += 1

    def wait_for(self, *publishers: Publisher) -> None:
        """Wait until the topics are recorded and the recorder is matched by the publishers."""
        names = {publisher.topic_name for publisher in publishers}
        self.spin_until(
            lambda: (
                self.status.recording
                and names <= set(self.status.topics)
                and all(publisher.get_subscription_count() for publisher in publishers)
            ),
            f"the recorder to record {names}",
        )


@pytest.fixture
def record(
    start_node: NodeStarter, node: Node, spin_until: SpinUntil, tmp_path: Path
) -> Callable[..., Recording]:
    """Start a recorder into ``tmp_path/bag``."""

    def start(*arguments: str, bag: Path = tmp_path / "bag", **options: Any) -> Recording:
        return Recording(start_node, node, spin_until, bag, *arguments, **options)

    return start


def read_with_rosbags(bag: Path) -> dict[str, list[Any]]:
    """All messages, decoded with the definitions that the bag holds, by topic."""
    messages: dict[str, list[Any]] = {}
    with AnyReader([bag], default_typestore=get_typestore(Stores.EMPTY)) as reader:
        for connection, _, data in reader.messages():
            message = reader.deserialize(data, connection.msgtype)
            messages.setdefault(connection.topic, []).append(message)
        counts = Counter({topic: len(items) for topic, items in messages.items()})
        assert reader.message_count == counts.total()
    return messages


def read_with_mcap(
    bag: Path, reader_class: Callable[..., Any] = make_reader
) -> dict[str, list[Any]]:
    """The same with the independent reader."""
    messages: dict[str, list[Any]] = {}
    with (bag / f"{bag.name}.mcap").open("rb") as file:
        reader = reader_class(file, decoder_factories=[DecoderFactory()])
        for item in reader.iter_decoded_messages():
            messages.setdefault(item.channel.topic, []).append(item.decoded_message)
    return messages


def evaluation(index: int) -> Evaluation:
    """An evaluation with something in its nested fields."""
    value = NamedValue(name="K1", value=400.0 + index, stddev=0.5, unit="A")
    return Evaluation(run_id="run1", index=index, setpoint=[value], feasible=index % 2 == 0)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_every_message_is_in_the_bag_after_a_signal(
    record: Callable[..., Recording], node: Node, number: signal.Signals
) -> None:
    problems = node.create_publisher(Problem, "problem", LATCHED)
    problem = Problem(run_id="run1", variables=[Variable(name="K1", unit="A", min=1.0, max=2.0)])
    problems.publish(problem)  # before the recorder runs
    evaluations = node.create_publisher(Evaluation, "evaluation", STREAM)
    plots = node.create_publisher(Float64, "plot/hypervolume", STREAM)
    recording = record()
    recording.wait_for(problems, evaluations, plots)
    for index in range(80):  # fewer than the publishers themselves keep
        evaluations.publish(evaluation(index))
        plots.publish(Float64(data=float(index)))
    assert recording.process.stop(number) == 0  # at once: what was published must not be lost

    for messages in (read_with_rosbags(recording.bag), read_with_mcap(recording.bag)):
        assert [m.index for m in messages["/evaluation"]] == list(range(80))
        assert [m.data for m in messages["/plot/hypervolume"]] == [float(i) for i in range(80)]
        assert messages["/evaluation"][7].setpoint[0].unit == "A"
        assert messages["/evaluation"][7].setpoint[0].value == 407.0
        assert len(messages["/problem"]) == 1
        assert messages["/problem"][0].variables[0].name == "K1"
        assert messages["/recorder_status"][-1].recording
        assert any("ready: " in m.msg for m in messages["/rosout"])
    metadata = yaml.safe_load((recording.bag / "metadata.yaml").read_text())
    information = metadata["rosbag2_bagfile_information"]
    assert information["version"] == 9
    assert information["storage_identifier"] == "mcap"
    assert information["relative_file_paths"] == ["bag.mcap"]
    assert sorted(p.name for p in recording.bag.iterdir()) == ["bag.mcap", "metadata.yaml"]


def test_a_late_recorder_has_the_evaluations_before_it_too(
    record: Callable[..., Recording],
    start_tuner: Callable[..., NodeProcess],
    start_machine: Callable[..., NodeProcess],
    client: GoalClient,
    spin_until: SpinUntil,
    tmp_path: Path,
) -> None:
    start_machine()
    start_tuner("initial_evaluations:=130")
    client.send(Tune.Goal(run_id="early", evaluations=130))  # more than a stream keeps
    assert client.wait(60.0).evaluations == 130
    recording = record()
    spin_until(
        lambda: {"/evaluation", "/problem"} <= set(recording.status.topics), "the tuner's topics"
    )
    spin_until(lambda: recording.status.messages >= 130, "the evaluations")
    assert recording.process.stop() == 0
    kept = [r for r in journal(tmp_path, "early") if r["type"] == "evaluation"]
    rebuilt = [r for r in records_of_bag(recording.bag) if r["type"] == "evaluation"]
    assert rebuilt == kept
    assert len(read_with_mcap(recording.bag)["/evaluation"]) == 130


def test_the_bag_tells_types_hashes_and_offered_qos(
    record: Callable[..., Recording], node: Node
) -> None:
    problems = node.create_publisher(Problem, "problem", LATCHED)
    evaluations = node.create_publisher(Evaluation, "evaluation", STREAM)
    sensor = node.create_publisher(Clock, "sensor", qos_profile_sensor_data)
    recording = record()
    recording.wait_for(problems, evaluations, sensor)
    for publisher, message in (
        (problems, Problem()),
        (evaluations, Evaluation()),
        (sensor, Clock()),
    ):
        publisher.publish(message)
    assert recording.process.stop() == 0

    store = get_typestore(Stores.EMPTY)
    with AnyReader([recording.bag], default_typestore=store) as reader:
        connections = {connection.topic: connection for connection in reader.connections}
        extensions: dict[str, Any] = {t: c.ext for t, c in connections.items()}
        offered = {t: e.offered_qos_profiles for t, e in extensions.items()}
        definitions = {t: c.msgdef.data for t, c in connections.items()}
        for connection in connections.values():
            assert connection.digest == reader.typestore.hash_rihs01(connection.msgtype)
    assert connections["/evaluation"].msgtype == "mobo_msgs_py/msg/Evaluation"
    (latched,) = offered["/problem"]
    assert latched.durability == QosDurability.TRANSIENT_LOCAL
    assert latched.reliability == QosReliability.RELIABLE
    (stream,) = offered["/evaluation"]
    assert stream.durability == QosDurability.VOLATILE
    assert stream.reliability == QosReliability.RELIABLE
    (best_effort,) = offered["/sensor"]
    assert best_effort.reliability == QosReliability.BEST_EFFORT
    assert connections["/sensor"].msgcount == 1
    assert "[s]" in definitions["/evaluation"]  # units and meanings travel along
    publisher_hash = str(node.get_publishers_info_by_topic("/problem")[0].topic_type_hash)
    assert connections["/problem"].digest == publisher_hash


def test_a_topic_that_appears_later_is_recorded_and_hidden_ones_are_not(
    record: Callable[..., Recording], node: Node, spin_until: SpinUntil
) -> None:
    recording = record("-p", "discovery_period:=0.1")
    recording.wait_for()
    node.create_publisher(String, "hidden/_service_event", STREAM)
    node.create_publisher(String, "_hidden", STREAM)
    node.create_service(Trigger, "pause", lambda _, response: response)
    late = node.create_publisher(String, "deep/er/late", LATCHED)
    late.publish(String(data="first"))
    recording.wait_for(late)
    spin_until(lambda: "/deep/er/late" in read_with_mcap(recording.bag), "the latched message")
    late.publish(String(data="second"))
    assert recording.process.stop() == 0
    messages = read_with_rosbags(recording.bag)
    assert [m.data for m in messages["/deep/er/late"]] == ["first", "second"]
    with AnyReader([recording.bag]) as reader:
        topics = {connection.topic for connection in reader.connections}
    own = {"/recorder_status", "/diagnostics", "/rosout", "/parameter_events"}
    assert topics == {"/deep/er/late", *own}


def test_a_topic_without_messages_is_in_the_bag(
    record: Callable[..., Recording], node: Node
) -> None:
    silent = node.create_publisher(Problem, "problem", LATCHED)
    recording = record()
    recording.wait_for(silent)
    assert recording.process.stop() == 0
    with AnyReader([recording.bag]) as reader:
        counts = {connection.topic: connection.msgcount for connection in reader.connections}
    assert counts["/problem"] == 0


def test_the_status_is_latched_repeated_and_ends_with_the_bag_closed(
    record: Callable[..., Recording], spin_until: SpinUntil
) -> None:
    recording = record()
    recording.wait_for()
    assert recording.status.path == str(recording.bag)
    assert recording.status.message == ""
    assert recording.status.topics == sorted(recording.status.topics)
    seen = recording.statuses
    spin_until(lambda: recording.statuses >= seen + 3, "the status to be repeated")
    recording.process.popen.send_signal(signal.SIGINT)
    spin_until(lambda: not recording.status.recording, "the last status")
    assert recording.status.message == "the recorder was stopped"
    assert recording.status.messages == sum(
        len(messages) for messages in read_with_rosbags(recording.bag).values()
    )
    assert recording.process.wait(5.0) == 0


def test_kill_9_leaves_a_readable_bag(
    record: Callable[..., Recording], node: Node, spin_until: SpinUntil
) -> None:
    problems = node.create_publisher(Problem, "problem", LATCHED)
    evaluations = node.create_publisher(Evaluation, "evaluation", STREAM)
    recording = record()
    recording.wait_for(problems, evaluations)
    problems.publish(Problem(run_id="run1"))
    for index in range(80):
        evaluations.publish(evaluation(index))

    def flushed() -> bool:
        return len(read_with_mcap(recording.bag).get("/evaluation", [])) == 80

    spin_until(flushed, "the messages to be on disk while the recorder runs")
    recording.process.stop(signal.SIGKILL)
    for messages in (
        read_with_rosbags(recording.bag),
        read_with_mcap(recording.bag),
        read_with_mcap(recording.bag, NonSeekingReader),
    ):
        assert [m.index for m in messages["/evaluation"]] == list(range(80))
        assert [m.run_id for m in messages["/problem"]] == ["run1"]


def test_it_records_while_simulated_time_stands(
    record: Callable[..., Recording], node: Node, spin_until: SpinUntil
) -> None:
    recording = record("-p", "use_sim_time:=true")
    recording.wait_for()
    evaluations = node.create_publisher(Evaluation, "evaluation", STREAM)  # discovered later
    recording.wait_for(evaluations)
    evaluations.publish(evaluation(0))

    def flushed() -> bool:
        return len(read_with_mcap(recording.bag).get("/evaluation", [])) == 1

    spin_until(flushed, "the message to be on disk")
    seen = recording.statuses
    spin_until(lambda: recording.statuses >= seen + 2, "the status to be repeated")
    assert recording.process.stop() == 0  # what waits for the queues to be empty ends, too


def test_a_write_error_is_reported_and_the_node_lives_on(
    record: Callable[..., Recording], node: Node, spin_until: SpinUntil
) -> None:
    def limit_file_size() -> None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (1_000_000, 1_000_000))

    texts = node.create_publisher(String, "text", STREAM)
    recording = record(preexec=limit_file_size)
    recording.wait_for(texts)
    texts.publish(String(data="short"))
    spin_until(lambda: len(read_with_mcap(recording.bag).get("/text", [])) == 1, "a flush")
    texts.publish(String(data="x" * 2_000_000))
    spin_until(lambda: not recording.status.recording, "the recorder to give up")
    assert recording.status.message == "the bag cannot be written: File too large"
    seen = recording.statuses
    spin_until(lambda: recording.statuses >= seen + 2, "the node to live on")
    health = Listener(node, DiagnosticArray, "/diagnostics", STREAM)
    spin_until(lambda: health.messages, "its health")
    (bag,) = health.messages[-1].status
    assert (bag.name, bag.level) == ("recorder: bag", DiagnosticStatus.ERROR)
    assert bag.message == recording.status.message
    assert recording.process.running
    assert recording.process.stop() == 0
    assert "[ERROR]" in recording.process.stderr
    assert "the bag cannot be written: File too large" in recording.process.stderr
    assert [m.data for m in read_with_rosbags(recording.bag)["/text"]] == ["short"]
    assert [m.data for m in read_with_mcap(recording.bag)["/text"]] == ["short"]


def test_a_bag_that_is_deleted_is_told_of(
    record: Callable[..., Recording], node: Node, spin_until: SpinUntil
) -> None:
    texts = node.create_publisher(String, "text", STREAM)
    recording = record()
    recording.wait_for(texts)
    shutil.rmtree(recording.bag)
    spin_until(lambda: not recording.status.recording, "the recorder to give up")
    # The second is said where there was nothing to write.
    reasons = ("No such file or directory", "it was deleted")
    assert recording.status.message in [f"the bag cannot be written: {why}" for why in reasons]
    assert recording.process.stop() == 0


def refused(start_node: NodeStarter, bag_path: str) -> str:
    """What a recorder says that does not start."""
    process = start_node(
        "-m", "mobo_tuner.nodes.recorder", "--ros-args", "-p", f"bag_path:={bag_path}"
    )
    assert process.wait() == 2
    return process.stderr.strip()


def test_an_existing_bag_is_not_overwritten(start_node: NodeStarter, tmp_path: Path) -> None:
    bag = tmp_path / "bag"
    bag.mkdir()
    (bag / "bag.mcap").write_bytes(b"precious")
    assert refused(start_node, str(bag)) == f"cannot start: the bag '{bag}' exists already"
    assert [p.read_bytes() for p in bag.iterdir()] == [b"precious"]


def test_a_bag_that_cannot_be_made_is_one_sentence(start_node: NodeStarter, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("in the way")
    bag = tmp_path / "file" / "bag"
    message = refused(start_node, str(bag))
    assert message == f"cannot start: the bag '{bag}' cannot be written: Not a directory"


def test_the_bag_path_is_needed(start_node: NodeStarter) -> None:
    process = start_node("-m", "mobo_tuner.nodes.recorder")
    assert process.wait() == 2
    assert "the parameter bag_path is empty" in process.stderr


def test_a_state_that_stays_the_same_is_written_now_and_then() -> None:
    def health(message: str, name: str = "tuner: run", value: int = 0) -> bytes:
        values = [KeyValue(key="pressure", value=str(value))]
        part = DiagnosticStatus(
            level=DiagnosticStatus.OK, name=name, message=message, values=values
        )
        return bytes(serialize_message(DiagnosticArray(status=[part])))

    def said(messages: int, path: str = "bag") -> bytes:
        status = RecorderStatus(recording=True, path=path, messages=messages)
        return bytes(serialize_message(status))

    repetitions = Repetitions("lab/recorder")

    def is_left_out(kind: type, data: bytes, now: float) -> bool:
        return repetitions.contain(kind, data, now)

    assert not is_left_out(DiagnosticArray, health("idle"), 0.0)
    assert is_left_out(DiagnosticArray, health("idle"), 1.0)
    assert not is_left_out(DiagnosticArray, health("idle", "machine: beam"), 1.0)  # of another node
    assert not is_left_out(DiagnosticArray, health("paused"), 2.0)
    assert not is_left_out(DiagnosticArray, health("idle"), 3.0)
    assert not is_left_out(DiagnosticArray, health("idle"), 3.0 + REPEAT_PERIOD)
    assert not is_left_out(DiagnosticArray, health("idle", value=1), 4.0 + REPEAT_PERIOD)
    assert not is_left_out(DiagnosticArray, health("well", "lab/recorder: bag", 1), 0.0)
    assert is_left_out(DiagnosticArray, health("well", "lab/recorder: bag", 2), 1.0)
    assert not is_left_out(RecorderStatus, said(1), 0.0)
    assert is_left_out(RecorderStatus, said(99), 1.0)
    assert not is_left_out(RecorderStatus, said(99, "other"), 1.0)
    assert not any(is_left_out(String, b"same", 1.0) for _ in range(3))
