"""Health on `/diagnostics`, and other nodes that publish the same topic."""

from __future__ import annotations

from collections.abc import Callable

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from std_msgs.msg import String

from mobo_tuner.ros.diagnostics import STALE, WARN, Diagnostics, Health, other_publishers
from mobo_tuner.ros.qos import STREAM
from tests.support.tuner import Listener

Spin = Callable[..., None]


def test_each_part_has_a_status_named_after_node_and_namespace(
    context: Context, executor: SingleThreadedExecutor, node: Node, spin_until: Spin
) -> None:
    parts = {
        "pump": lambda: Health(WARN, "the pump is hot", {"temperature [K]": 350.5, "on": True}),
        "gauge": lambda: Health(STALE, "no reading for 3 s"),
    }
    listener = Listener(node, DiagnosticArray, "/diagnostics", STREAM)
    # No clock is published: the health must be told all the same.
    arguments = ["--ros-args", "-p", "use_sim_time:=true"]
    cellar = Node("cellar", context=context, namespace="/A", cli_args=arguments)
    executor.add_node(cellar)
    diagnostics = Diagnostics(cellar, "pump station 3", parts)
    spin_until(lambda: len(listener.messages) >= 2, "two messages")
    pump, gauge = listener.messages[-1].status
    assert (pump.name, pump.level, pump.message) == (
        "A/cellar: pump",
        DiagnosticStatus.WARN,
        "the pump is hot",
    )
    assert {v.key: v.value for v in pump.values} == {"temperature [K]": "350.5", "on": "True"}
    assert pump.hardware_id == "pump station 3"
    assert (gauge.name, gauge.level) == ("A/cellar: gauge", DiagnosticStatus.STALE)
    del diagnostics
    executor.remove_node(cellar)
    cellar.destroy_node()


def test_other_publishers_are_named_though_they_have_the_same_name(
    context: Context, node: Node, spin_until: Spin
) -> None:
    node.create_publisher(String, "word", STREAM)
    spin_until(lambda: node.count_publishers("/word") == 1, "its own publisher")
    assert other_publishers(node, "word") == []
    others = [
        Node("test_node", context=context),
        Node(
            "other", context=context, namespace="/B", cli_args=["--ros-args", "-r", "word:=/word"]
        ),
    ]
    for other in others:
        other.create_publisher(String, "word", STREAM)
    spin_until(lambda: node.count_publishers("/word") == 3, "the others")
    assert other_publishers(node, "word") == ["/B/other", "/test_node"]
    for other in others:
        other.destroy_node()
