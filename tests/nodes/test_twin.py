"""Machines as the workers of a campaign: each in its namespace, one lost while the other goes on."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest
from action_msgs.msg import GoalStatus, GoalStatusArray
from rclpy.node import Node
from rclpy.qos import qos_profile_action_status_default

from mobo_tuner.core import Problem
from mobo_tuner.offline.hosts import Hosts
from tests.core.toy_runs import TOY, toy
from tests.support.processes import NodeProcess, NodeStarter, wait_until
from tests.support.simulator import Listener

WAIT = 60.0
POINTS = [{"x1": 0.5, "x2": -1.0}, {"x1": 1.0, "x2": 1.5}, {"x1": -1.5, "x2": 0.25}]


@pytest.fixture
def hosts(tmp_path: Path) -> Iterator[Hosts]:
    task = {"command": "", "timeout": WAIT, "problem": Problem.from_dict(TOY).to_dict()}
    hosts = Hosts("127.0.0.1", task, tmp_path)
    yield hosts
    hosts.stop()


def test_a_lost_machine_s_point_is_evaluated_by_another_one(
    hosts: Hosts, start_node: NodeStarter, tmp_path: Path
) -> None:
    def start(name: str, rate: float) -> tuple[NodeProcess, NodeProcess]:
        names = ("--ros-args", "-r", f"__ns:=/{name}")
        toys = ("-p", "model:=toy", "-p", "mode:=ideal", "-p", f"beam_repetition_rate:={rate}")
        machine = start_node("-m", "awa_sim_node.node", *names, *toys, "-p", "speed:=1.0")
        words = (str(tmp_path), "--machine-timeout", "2")
        return machine, start_node("-m", "mobo_tuner.nodes.twin", *words, *names)

    slow, slow_worker = start("slow", 0.01)  # until it is killed, it measures one shot
    with ThreadPoolExecutor(3) as threads:
        outcomes = [threads.submit(hosts.run, i, point) for i, point in enumerate(POINTS)]
        wait_until(lambda: "joined" in slow_worker.stderr, "the slow machine", WAIT)
        _, quick_worker = start("quick", 100.0)
        wait_until(lambda: sum(o.done() for o in outcomes) >= 2, "the quick machine", WAIT)
        slow.kill()
        for point, outcome in zip(POINTS, outcomes, strict=True):
            assert outcome.result(WAIT).error == ""
            assert outcome.result().outputs.items() >= toy(point).items()
    assert "given back" in slow_worker.stderr
    assert "given back" not in quick_worker.stderr
    hosts.stop()
    # One is idle, the other looks for its machine: both see that the campaign is over.
    assert [worker.wait(WAIT) for worker in (quick_worker, slow_worker)] == [0, 0]


def test_a_machine_whose_worker_is_killed_holds_and_serves_the_next_one(
    hosts: Hosts,
    start_node: NodeStarter,
    node: Node,
    spin_until: Callable[..., None],
    tmp_path: Path,
) -> None:
    names = ("--ros-args", "-r", "__ns:=/stand")
    toys = ("-p", "model:=toy", "-p", "mode:=ideal", "-p", "beam_repetition_rate:=0.2")
    machine = start_node("-m", "awa_sim_node.node", *names, *toys, "-p", "speed:=1.0")
    goals = Listener(
        node,
        GoalStatusArray,
        "/stand/evaluate_setpoint/_action/status",
        qos_profile_action_status_default,
    )
    words = ("-m", "mobo_tuner.nodes.twin", str(tmp_path), "--machine-timeout", "2", *names)
    first = start_node(*words)
    with ThreadPoolExecutor(1) as threads:
        outcome = threads.submit(hosts.run, 0, POINTS[0])
        spin_until(
            lambda: any(
                goal.status == GoalStatus.STATUS_EXECUTING
                for message in goals.messages
                for goal in message.status_list
            ),
            "an evaluation",
            WAIT,
        )
        first.kill()
        wait_until(lambda: "holds where it is" in machine.stderr, "the machine to hold", WAIT)
        start_node(*words)
        assert outcome.result(WAIT).outputs.items() >= toy(POINTS[0]).items()
