"""Checks for `ros2 doctor`, which finds them by the entry points `ros2doctor.checks` and `ros2doctor.report`.

`ros2 doctor` makes an object of each class without arguments, and uses its `category` and `check`, or `category` and
`report`. Of a result it reads `error` and `warning`, the numbers of each; of a report `name` and `items`.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field

import rclpy
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node

from mobo_msgs_py import msg, srv

CATEGORY = "mobo_tuner"
DISCOVERY_TIME = 2.0  # [s] to find what is there
# Without a change after which everything counts as found, once there is a tuner.
_QUIET_TIME = 0.5  # [s]


@dataclass
class CheckResult:
    """What a check found.

    Attributes:
        error: Number of errors.
        warning: Number of warnings.
    """

    error: int = 0
    warning: int = 0

    def add_error(self, text: str) -> None:
        """Count an error and print it."""
        self.error += 1
        print(f"ERROR: {text}", file=sys.stderr)

    def add_warning(self, text: str) -> None:
        """Count a warning and print it."""
        self.warning += 1
        print(f"WARNING: {text}", file=sys.stderr)


@dataclass
class SystemReport:
    """A section of the report.

    Attributes:
        name: Title.
        items: Names and values.
    """

    name: str
    items: list[tuple[str, str]] = field(default_factory=list)


@dataclass(frozen=True)
class Tuner:
    """A tuner of the graph.

    Attributes:
        name: Full name of the node.
        heartbeat: Topic of its heartbeat.
        machine: Service by which it asks for the machine's description.
        machines: Number of machines that serve it.
    """

    name: str
    heartbeat: str
    machine: str
    machines: int


class MachineCheck:
    """Checks that each tuner has exactly one machine."""

    def category(self) -> str:
        """Return the category that `ros2 doctor` prints for failed checks."""
        return CATEGORY

    def check(self) -> CheckResult:
        """Look for the machine of each tuner in this terminal's ROS domain."""
        result = CheckResult()
        for tuner in find_tuners():
            if tuner.machines == 0:
                result.add_error(f"{tuner.name} has no machine: nothing serves {tuner.machine}")
            elif tuner.machines > 1:
                result.add_error(
                    f"{tuner.name} has {tuner.machines} machines that serve {tuner.machine}; "
                    "each goal would move all of them"
                )
        return result


class TunerCheck:
    """Checks that each machine has one tuner only."""

    def category(self) -> str:
        """Return the category that `ros2 doctor` prints for failed checks."""
        return CATEGORY

    def check(self) -> CheckResult:
        """Look for tuners that send the same heartbeat."""
        result = CheckResult()
        tuners = find_tuners()
        for heartbeat in sorted({tuner.heartbeat for tuner in tuners}):
            names = [tuner.name for tuner in tuners if tuner.heartbeat == heartbeat]
            if len(names) > 1:
                result.add_warning(
                    f"{len(names)} tuners send {heartbeat}: {', '.join(names)}; a machine serves "
                    "one at a time"
                )
        return result


class TunerReport:
    """Lists the tuners and their machines."""

    def category(self) -> str:
        """Return the category by which `ros2 doctor` relates reports to failed checks."""
        return CATEGORY

    def report(self) -> SystemReport:
        """Return one entry for each tuner."""
        report = SystemReport("MOBO TUNERS")
        for tuner in find_tuners():
            report.items += [
                ("tuner", tuner.name),
                ("machines", f"{tuner.machines} on {tuner.machine}"),
                ("heartbeat", tuner.heartbeat),
            ]
        if not report.items:
            report.items.append(("tuner", "none"))
        return report


def find_tuners() -> list[Tuner]:
    """Return the tuners of this terminal's ROS domain, sorted by name."""
    with _visitor() as (node, executor):
        deadline = time.monotonic() + DISCOVERY_TIME
        found, since = _tuners(node), time.monotonic()
        while time.monotonic() < deadline:
            executor.spin_once(timeout_sec=0.1)
            now = _tuners(node)
            if now != found:
                found, since = now, time.monotonic()
            complete = found and all(tuner.machines for tuner in found)
            if complete and time.monotonic() - since > _QUIET_TIME:
                break
        return found


def _tuners(node: Node) -> list[Tuner]:
    status, heartbeat, describe = (
        _type_name(kind) for kind in (msg.TunerStatus, msg.Heartbeat, srv.DescribeMachine)
    )
    owners = [
        (info.node_name, info.node_namespace)
        for topic, types in node.get_topic_names_and_types()
        if status in types
        for info in node.get_publishers_info_by_topic(topic)
    ]
    found = []
    for name, namespace in owners:
        try:
            published = node.get_publisher_names_and_types_by_node(name, namespace)
            called = node.get_client_names_and_types_by_node(name, namespace)
        except RuntimeError:  # it has gone meanwhile
            continue
        heartbeats = [topic for topic, types in published if heartbeat in types]
        machines = [service for service, types in called if describe in types]
        if heartbeats and machines:
            full = f"{namespace.rstrip('/')}/{name}"
            count = node.count_services(machines[0])
            found.append(Tuner(full, heartbeats[0], machines[0], count))
    return sorted(found, key=lambda tuner: tuner.name)


def _type_name(kind: type) -> str:
    package, folder, *_ = kind.__module__.split(".")
    return f"{package}/{folder}/{kind.__name__}"


@contextmanager
def _visitor() -> Iterator[tuple[Node, SingleThreadedExecutor]]:
    """Give a node that looks at the graph, in a context of its own."""
    context = Context()
    rclpy.init(args=[], context=context)
    try:
        node = Node("mobo_doctor", context=context, start_parameter_services=False)
        executor = SingleThreadedExecutor(context=context)
        executor.add_node(node)
        try:
            yield node, executor
        finally:
            executor.shutdown(timeout_sec=1.0)
            node.destroy_node()
    finally:
        context.try_shutdown()
