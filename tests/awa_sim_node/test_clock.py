"""Simulated time on `/clock`: from the machine's node, or from others."""

from __future__ import annotations

import time
from collections.abc import Callable

from builtin_interfaces.msg import Time
from rclpy.node import Node
from rosgraph_msgs.msg import Clock
from std_msgs.msg import Float64

from mobo_msgs_py.action import EvaluateSetpoint
from mobo_tuner.ros.conversions import seconds
from mobo_tuner.ros.qos import STREAM
from tests.support.processes import NodeStarter
from tests.support.simulator import Listener, evaluation_goal, start_machine
from tests.support.tuner import machine_client


def test_the_node_can_be_the_clock(
    start_node: NodeStarter, node: Node, spin_until: Callable[..., None]
) -> None:
    start_machine(
        start_node, model="toy", mode="ideal", speed=50.0, publish_clock=True, use_sim_time=True
    )
    clock = Listener(node, Clock, "/clock")
    spin_until(lambda: clock.messages, "the clock")
    began, first = time.monotonic(), seconds(clock.messages[-1].clock)
    client = machine_client(node, spin_until)
    for index in range(2):
        client.send(evaluation_goal({"x1": 1.0, "x2": 1.0}, index=index, shots=2000))
        result = client.wait()
        assert result.error_code == EvaluateSetpoint.Result.NONE
        # 2000 shots at 100 Hz take 20 s of its own time, 0.4 s of ours.
        assert seconds(result.stamp) > first + 20.0 * (index + 1) - 5.0
    spin_until(lambda: seconds(clock.messages[-1].clock) >= seconds(result.stamp), "the clock")
    times = [seconds(message.clock) for message in clock.messages]
    assert times == sorted(times)
    passed = times[-1] - first
    # The first message may have waited for half a second on a busy computer.
    assert 40.0 - 5.0 < passed < 50.0 * (time.monotonic() - began + 0.5)


def test_the_machine_follows_the_clock_of_others(
    start_node: NodeStarter, node: Node, spin_until: Callable[..., None]
) -> None:
    start_machine(start_node, mode="ideal", speed=1.0, stream_rate=50.0, use_sim_time=True)
    clock = node.create_publisher(Clock, "/clock", 10)
    k1 = node.create_publisher(Float64, "K1/setpoint", STREAM)
    readback = Listener(node, Float64, "K1/readback")
    spin_until(lambda: clock.get_subscription_count() and readback.data, "the machine")

    def tick(sec: int) -> None:
        clock.publish(Clock(clock=Time(sec=sec)))

    tick(100)
    k1.publish(Float64(data=515.0))
    count = len(readback.data)
    spin_until(lambda: len(readback.data) > count + 25, "half a second of readbacks")
    assert set(readback.data) == {475.0}
    tick(105)
    # 5 s at 8 A/s, less the lag of 12 A (1 - exp(-5 / 1.5)).
    spin_until(lambda: readback.data[-1] > 475.0, "the device to move")
    count = len(readback.data)
    spin_until(lambda: len(readback.data) > count + 10, "more readbacks")
    assert abs(readback.data[-1] - (475.0 + 40.0 - 12.0 * 0.96433)) < 0.01
    tick(200)
    spin_until(lambda: readback.data[-1] == 515.0, "the device to arrive")
