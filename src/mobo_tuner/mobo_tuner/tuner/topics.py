"""The tuner's topics, all relative to its namespace."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager

from rclpy.duration import Duration
from rclpy.node import Node
from std_msgs.msg import Float64, Header

from mobo_msgs_py import msg
from mobo_tuner.core.problem import Problem
from mobo_tuner.names import topic_token
from mobo_tuner.ros import interfaces
from mobo_tuner.ros.waiting import STEADY_CLOCK

STATUS_PERIOD = 1.0  # [s]
HEARTBEAT_PERIOD = 1.0  # [s] at most
HEARTBEATS_PER_TIMEOUT = 3.0  # at least
READBACK_PERIOD = 0.1  # [s] at least between two messages about a motion
FRONT_SHARE = 0.1
"""Share of the front that has changed when it is published again during a run."""


class TunerTopics:
    """Publishers of what a run is, does and has found.

    `problem`, `run_records`, `status` and `pareto_front` are latched. `evaluation` is kept for late
    subscribers, because a recorder may take seconds to discover a tuner whose run has begun. One flat
    topic `plot/<name>` per variable, diagnostic and figure serves plotting tools that cannot look into
    arrays.

    Args:
        node: Node that publishes.
        problem: Problem whose names get a `plot/<name>`.
        client_timeout: Silence after which a machine takes this client for lost [s]; 0 = never.

    Attributes:
        status: The tuner's status.
        heartbeat: The heartbeat of a run.
    """

    def __init__(self, node: Node, problem: Problem, client_timeout: float) -> None:
        self._problem = interfaces.PROBLEM.publisher(node)
        self._records = interfaces.RUN_RECORDS.publisher(node)
        self._front = interfaces.PARETO_FRONT.publisher(node)
        self._listed: frozenset[int] = frozenset()  # points of the front that was published last
        self._evaluation = interfaces.EVALUATION.publisher(node)
        self._latest = interfaces.LATEST_EVALUATION.publisher(node)
        names = dict.fromkeys(
            [
                *problem.variable_names,
                *problem.required_diagnostics,
                *(o.name for o in problem.observables),
                *(d.name for d in problem.derived),
                "hypervolume",
                "suggest_seconds",
            ]
        )
        self._plots = {n: interfaces.PLOT.publisher(node, topic_token(n)) for n in names}
        self.status = Status(node)
        self.heartbeat = Heartbeat(node, client_timeout)

    def problem(self, message: msg.Problem) -> None:
        """Publish the problem of a run."""
        self._problem.publish(message)

    def run_records(self, message: msg.RunRecords) -> None:
        """Publish how a run was set up and changed."""
        self._records.publish(message)

    def front(self, message: msg.ParetoFront) -> None:
        """Publish the whole Pareto front as it is now."""
        self._listed = frozenset(point.index for point in message.points)
        self._front.publish(message)

    def front_changed(self, indices: Iterable[int], message: Callable[[], msg.ParetoFront]) -> None:
        """Publish the whole front if enough of its points are others than when it was published last.

        So the fronts of a run take space in proportion to its evaluations, and not to their square.

        Args:
            indices: Points of the front as it is now.
            message: Function that returns that front.
        """
        now = frozenset(indices)
        if len(now ^ self._listed) >= max(1.0, FRONT_SHARE * len(now)):
            self.front(message())

    def evaluation(self, message: msg.Evaluation) -> None:
        """Publish an evaluation, as a whole and as flat topics."""
        self._evaluation.publish(message)
        self._latest.publish(message)
        values = {item.name: item.value for item in (*message.diagnostics, *message.setpoint)}
        values["hypervolume"] = message.hypervolume
        values["suggest_seconds"] = message.suggest_seconds
        for name, publisher in self._plots.items():
            if name in values:
                publisher.publish(Float64(data=values[name]))

    def acknowledged(self, timeout: Duration) -> bool:
        """Return whether every subscriber has received all evaluations, flat topics included."""
        publishers = (self._evaluation, *self._plots.values())
        return all(publisher.wait_for_all_acked(timeout) for publisher in publishers)


class Status:
    """The topic `status`: published at every change that matters, and at 1 Hz.

    Attributes:
        message: Last message, but for its stamp.
    """

    def __init__(self, node: Node) -> None:
        self._node = node
        self._publisher = interfaces.STATUS.publisher(node)
        self.message = msg.TunerStatus(free_space=math.nan)
        self._hints: dict[str, list[str]] = {}
        # On a steady clock: who watches the tuner must not be misled by simulated time that stands.
        self._timer = node.create_timer(STATUS_PERIOD, self._publish, clock=STEADY_CLOCK)
        self._publish()

    def set(self, *, publish: bool = True, **fields: object) -> None:
        """Change some fields; with `publish=False` they wait for the next period."""
        for name, value in fields.items():
            setattr(self.message, name, value)
        if publish:
            self._publish()

    def work(self, state: int, message: str | None = None) -> None:
        """Publish what the tuner begins to do now.

        Args:
            state: One of `TunerStatus`'s constants.
            message: Sentence for people; None leaves the last one.
        """
        text = self.message.message if message is None else message
        self.set(state=state, phase="", fraction=0.0, message=text)

    def fail(self, text: str) -> None:
        """Publish the last failure of a run; it stays until the next one or another run."""
        self.set(last_failure=text)

    def hint(self, source: str, texts: Iterable[str]) -> None:
        """Publish the hints of one part of the tuner in place of its earlier ones, if they changed.

        Args:
            source: Name of the part.
            texts: One sentence each; may be empty.
        """
        new = list(texts)
        if new != self._hints.get(source, []):
            self._hints[source] = new
            self.set(hints=[text for hints in self._hints.values() for text in hints])

    def progress(self, phase: str, fraction: float) -> None:
        """Keep how far the machine is, for the next period."""
        self.set(publish=False, phase=phase, fraction=fraction)

    def _publish(self) -> None:
        self.message.header.stamp = self._node.get_clock().now().to_msg()
        self._publisher.publish(self.message)


class Motion:
    """The topics `machine_setpoint` and `machine_readbacks`: where the machine goes, and where it is.

    Args:
        node: Node that publishes.
    """

    def __init__(self, node: Node) -> None:
        self._node = node
        self._setpoint = interfaces.MACHINE_SETPOINT.publisher(node)
        self._readbacks = interfaces.MACHINE_READBACKS.publisher(node)
        self._said = 0.0  # when readbacks were published, by `time.monotonic` [s]

    def begin(self, setpoint: Sequence[msg.NamedValue]) -> None:
        """Publish the set-point of a motion that begins now."""
        self._setpoint.publish(self._message(setpoint))
        self._said = 0.0

    def progress(self, readbacks: Sequence[msg.NamedValue], *, last: bool = False) -> None:
        """Publish readbacks; those that follow too closely are left out unless they are the last."""
        now = time.monotonic()
        if readbacks and (last or now - self._said >= READBACK_PERIOD):
            self._said = now
            self._readbacks.publish(self._message(readbacks))

    def _message(self, values: Sequence[msg.NamedValue]) -> msg.NamedValues:
        header = Header(stamp=self._node.get_clock().now().to_msg())
        return msg.NamedValues(header=header, values=list(values))


class Heartbeat:
    """The topic `heartbeat`, by which a machine knows that its client is alive.

    It is published from the executor's thread while a run is active.

    Args:
        node: Node that publishes.
        client_timeout: Silence after which a machine takes this client for lost [s]; 0 = never. A
            short one makes the heartbeat faster.
    """

    def __init__(self, node: Node, client_timeout: float) -> None:
        self._node = node
        self._run_id = ""
        self._publisher = interfaces.HEARTBEAT.publisher(node)
        fastest = client_timeout / HEARTBEATS_PER_TIMEOUT or HEARTBEAT_PERIOD
        period = min(HEARTBEAT_PERIOD, fastest)
        self._timer = node.create_timer(period, self._beat, clock=STEADY_CLOCK)

    @contextmanager
    def of(self, run_id: str) -> Iterator[None]:
        """Beat for a run; a last message without a run tells the machine that the end is intended."""
        self._run_id = run_id
        self._publish()
        try:
            yield
        finally:
            self._run_id = ""
            self._publish()

    def _beat(self) -> None:
        if self._run_id:
            self._publish()

    def _publish(self) -> None:
        header = Header(stamp=self._node.get_clock().now().to_msg())
        self._publisher.publish(msg.Heartbeat(header=header, run_id=self._run_id))
