"""The recorder: it writes every topic of the run's ROS domain into a rosbag2 folder.

Hidden topics (those of actions and service events) are omitted, as by `ros2 bag record --all`: the
topics of the nodes contain the whole run, with one `Evaluation` per evaluation. Health and the recorder's
status, which come every second, are written when they change, and every `REPEAT_PERIOD` seconds.
"""

from __future__ import annotations

import contextlib
import errno
import shutil
import time
from collections.abc import Callable
from functools import partial
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.duration import Duration
from rclpy.executors import Executor
from rclpy.node import Node
from rclpy.serialization import deserialize_message
from rclpy.task import Future
from rclpy.timer import Timer
from std_msgs.msg import Header

from mobo_msgs_py.msg import RecorderStatus
from mobo_tuner.nodes.bags import Bag, open_bag
from mobo_tuner.nodes.parameters import RECORDER
from mobo_tuner.nodes.topic_discovery import FoundTopic, TopicDiscovery
from mobo_tuner.ros import interfaces
from mobo_tuner.ros.diagnostics import ERROR, OK, WARN, Diagnostics, Health
from mobo_tuner.ros.parameters import declare, refuse_undeclared, take_given
from mobo_tuner.ros.process import Program, StartError, exit_process, run_node
from mobo_tuner.ros.waiting import STEADY_CLOCK
from mobo_tuner.wording import counted

FLUSH_PERIOD = 0.25  # [s] of messages that are lost at most if the process is killed
STATUS_PERIOD = 1.0  # [s]
REPEAT_PERIOD = 10.0  # [s] after which a state that is still the same is written again
SCARCE_SPACE = 1e9  # [bytes] left on the disk below which a person is warned
QUIET_TIME = 0.2  # [s] without a message after which the queues count as empty
DRAIN_TIMEOUT = 1.0  # [s]
DRAIN_POLL_PERIOD = 0.05  # [s]
FAREWELL_TIMEOUT = 0.3  # [s] for the last status to arrive
PROGRAM = Program(
    "recorder", "Records every topic of the ROS domain into a rosbag2 folder.", RECORDER
)


class Repetitions:
    """Finds the messages that say again what was written already, but for their stamp.

    In what the recorder says of itself, figures such as its count of messages do not count.

    Args:
        recorder: Full name of the recorder's node, without the first slash.
    """

    def __init__(self, recorder: str) -> None:
        self._recorder = f"{recorder}: "
        self._written: dict[object, tuple[object, float]] = {}  # what a sender said, and when [s]

    def contain(self, kind: object, data: bytes, now: float) -> bool:
        """Return whether a serialised message may be left out of the bag.

        Args:
            kind: Type of the message; only health and the status of a recorder ever may be left out.
            data: Serialised message.
            now: Time of a steady clock [s].
        """
        sender: object
        content: object
        if kind is DiagnosticArray:
            health = deserialize_message(data, DiagnosticArray)
            sender = tuple(part.name for part in health.status)
            content = [
                (
                    part.level,
                    part.message,
                    part.hardware_id,
                    {}
                    if part.name.startswith(self._recorder)
                    else {value.key: value.value for value in part.values},
                )
                for part in health.status
            ]
        elif kind is RecorderStatus:
            status = deserialize_message(data, RecorderStatus)
            sender = status.path
            content = (status.recording, list(status.topics), status.message)
        else:
            return False
        before = self._written.get(sender)
        if before is not None and before[0] == content and now - before[1] < REPEAT_PERIOD:
            return True
        self._written[sender] = (content, now)
        return False


class Recorder:
    """Records all topics from their discovery until it is stopped.

    If writing fails, it publishes the reason in its status and continues without recording.
    """

    exit_code = None

    def __init__(self, executor: Executor) -> None:
        self._executor = executor
        self._node = Node("recorder", automatically_declare_parameters_from_overrides=True)
        given = take_given(self._node)
        parameters = declare(self._node, RECORDER)
        refuse_undeclared(self._node, given)
        self._bag = _open_bag(str(parameters["bag_path"]))
        self._recording = True
        self._failure = ""
        self._last_timestamp = 0
        self._topics: set[str] = set()
        self._repetitions = Repetitions(self._node.get_fully_qualified_name().removeprefix("/"))
        self._discovery = TopicDiscovery(self._node)
        self._publisher = interfaces.RECORDER_STATUS.publisher(self._node)
        self._every(float(parameters["discovery_period"]), self._discover)
        self._every(FLUSH_PERIOD, self._flush)
        self._every(STATUS_PERIOD, self._publish_status)
        self._diagnostics = Diagnostics(self._node, "", {"bag": self._health})
        self._discover()
        self._publish_status()
        self._node.get_logger().info(
            f"ready: every topic of ROS domain {self._node.context.get_domain_id()} is recorded into "
            f"{self._bag.path.absolute()}, and {self._publisher.topic} says what is held"
        )

    @property
    def node(self) -> Node:
        """The rclpy node."""
        return self._node

    def _every(self, period: float, callback: Callable[[], None]) -> Timer:
        # In wall time: messages and topics come and a disk fills, also when simulated time stands.
        return self._node.create_timer(period, callback, clock=STEADY_CLOCK)

    def _health(self) -> Health:
        """How the bag is, for `/diagnostics`."""
        values: dict[str, object] = {
            "path": self._bag.path.absolute(),
            "messages": self._bag.message_count,
            "topics": len(self._topics),
            "topics not recorded": ", ".join(self._discovery.refused) or "none",
        }
        with contextlib.suppress(OSError):
            free = shutil.disk_usage(self._bag.path).free
            values["free disk space [GB]"] = f"{free / 1e9:.1f}"
            if self._recording and free < SCARCE_SPACE:
                return Health(WARN, f"the disk has only {free / 1e9:.1f} GB left", values)
        if not self._recording:
            return Health(ERROR, self._failure, values)
        if self._discovery.refused:
            topic, reason = next(iter(self._discovery.refused.items()))
            return Health(WARN, f"the topic {topic} is not recorded: {reason}", values)
        return Health(OK, f"topics recorded: {len(self._topics)}", values)

    async def stop(self) -> None:
        """Record all messages published until now, then close the bag."""
        self._discover()
        await self._drained()
        self._close_bag()
        self._publish_status()
        self._publisher.wait_for_all_acked(Duration(seconds=FAREWELL_TIMEOUT))

    def close(self) -> None:
        """Close the bag if it is open, and release the node."""
        self._close_bag()
        self._node.destroy_node()

    def _discover(self) -> None:
        """Subscribe to topics that have a publisher."""
        if not self._recording:
            return
        before, refused = len(self._topics), {*self._discovery.refused}
        for topic in self._discovery.new_topics():
            self._record(topic)
        for name, reason in self._discovery.refused.items():
            if name not in refused:
                self._node.get_logger().warning(f"the topic {name} is not recorded: {reason}")
        if len(self._topics) != before:
            self._publish_status()

    def _record(self, topic: FoundTopic) -> None:
        try:
            recorded = self._bag.add_topic(
                topic.name, topic.type_name, topic.definition, topic.offers
            )
        except OSError as error:
            self._fail(error)
            return
        topic.subscribe(self._node, partial(self._write, recorded, topic.kind))
        self._topics.add(topic.name)

    def _write(self, topic: Any, kind: type, data: bytes, info: dict[str, int]) -> None:
        if not self._recording or self._repetitions.contain(kind, data, time.monotonic()):
            return
        # The bag needs ordered timestamps, but the messages of several topics arrive interleaved.
        self._last_timestamp = max(self._last_timestamp, info["received_timestamp"])
        try:
            self._bag.write(topic, self._last_timestamp, data)
        except OSError as error:
            self._fail(error)

    def _flush(self) -> None:
        if not self._recording:
            return
        try:
            self._bag.flush()
            if not self._bag.path.exists():  # what is written now would be lost silently
                raise FileNotFoundError(errno.ENOENT, "it was deleted")
        except OSError as error:
            self._fail(error)

    def _fail(self, error: OSError) -> None:
        self._recording = False
        self._failure = f"the bag cannot be written: {error.strerror or error}"
        self._node.get_logger().error(
            f"{self._failure}; recording stops after {counted(self._bag.message_count, 'message')}"
        )
        with contextlib.suppress(OSError):
            self._bag.abort()
        self._publish_status()

    def _close_bag(self) -> None:
        if not self._recording:
            return
        try:
            self._bag.close()
        except OSError as error:
            self._fail(error)
            return
        self._recording = False
        self._failure = "the recorder was stopped"
        self._node.get_logger().info(
            f"recorded {counted(self._bag.message_count, 'message')} of {counted(len(self._topics), 'topic')}"
        )

    def _publish_status(self) -> None:
        self._publisher.publish(
            RecorderStatus(
                header=Header(stamp=self._node.get_clock().now().to_msg()),
                recording=self._recording,
                path=str(self._bag.path.absolute()),
                topics=sorted(self._topics) if self._recording else [],
                messages=self._bag.message_count,
                message=self._failure,
            )
        )

    def _drained(self) -> Future:
        """Return a future that is done after a moment without messages, or after a timeout."""
        done: Future = Future(executor=self._executor)
        started = latest = time.monotonic()
        count = self._bag.message_count

        def check() -> None:
            nonlocal latest, count
            now = time.monotonic()
            if self._bag.message_count != count:
                count, latest = self._bag.message_count, now
            if now - latest >= QUIET_TIME or now - started >= DRAIN_TIMEOUT:
                timer.cancel()
                done.set_result(None)

        timer = self._every(DRAIN_POLL_PERIOD, check)
        return done


def _open_bag(path: str) -> Bag:
    """Open a new bag.

    Raises:
        StartError: If it cannot be created.
    """
    if not path:
        raise StartError("the parameter bag_path is empty; it must name the bag's folder")
    try:
        return open_bag(path)
    except FileExistsError:
        raise StartError(f"the bag '{path}' exists already") from None
    except OSError as error:
        raise StartError(f"the bag '{path}' cannot be written: {error.strerror or error}") from None


def main() -> None:
    """Run the node until a signal stops it."""
    exit_process(run_node(Recorder, PROGRAM))


if __name__ == "__main__":
    main()
