"""Health on `/diagnostics`, and other nodes that publish the same topic."""

from __future__ import annotations

from collections.abc import Callable

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from std_msgs.msg import String

from mobo_tuner.ros.diagnostics import LEASE, STALE, WARN, Diagnostics, Health, Publishers
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


def test_other_publishers_of_the_same_name_count_when_a_killed_one_would_be_gone(
    context: Context, node: Node, spin_until: Spin
) -> None:
    now = 100.0
    publishers = Publishers(node, "word", clock=lambda: now)
    assert publishers.names() == []
    node.create_publisher(String, "word", STREAM)
    spin_until(lambda: publishers.names() == ["/test_node"], "its own publisher")
    assert publishers.others() == []
    others = [
        Node("test_node", context=context),
        Node(
            "other", context=context, namespace="/B", cli_args=["--ros-args", "-r", "word:=/word"]
        ),
    ]
    for other in others:
        other.create_publisher(String, "word", STREAM)
    spin_until(lambda: node.count_publishers("/word") == 3, "the others")
    spin_until(lambda: publishers.others() == ["/B/other"], "the name of the other")
    now += 0.9 * LEASE
    assert publishers.others() == ["/B/other"]
    now += 0.2 * LEASE
    assert publishers.others() == ["/B/other", "/test_node"]
    others.pop(0).destroy_node()
    spin_until(lambda: publishers.others() == ["/B/other"], "its end")
    for other in others:
        other.destroy_node()
