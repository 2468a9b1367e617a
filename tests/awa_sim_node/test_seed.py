"""Two machines' nodes of one seed, which live at different speeds."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from rclpy.node import Node

from mobo_msgs_py.action import EvaluateSetpoint
from tests.support.processes import NodeStarter
from tests.support.simulator import MIDDLE, evaluation_goal, start_machine
from tests.support.tuner import GoalClient

POINTS = (
    MIDDLE | {"K1": 431.7, "G2": 17.3},
    MIDDLE | {"phi1": -9.1, "K2": 262.9},
    MIDDLE,
)


def said(result: EvaluateSetpoint.Result) -> dict[str, Any]:
    """All of a result that the machine measured."""
    measured = {d.name: (d.value, d.stddev, d.unit) for d in result.diagnostics}
    where = {f"{r.name} readback": (r.value, r.stddev, r.unit) for r in result.readbacks}
    return measured | where | {"shots": result.shots, "error": result.error_msg}


def test_an_ideal_run_is_the_same_bit_for_bit(
    start_node: NodeStarter, node: Node, spin_until: Callable[..., None]
) -> None:
    clients = []
    for name, speed, rate in (("slow", 60.0, 5.0), ("fast", 5000.0, 200.0)):
        options = {"mode": "ideal", "seed": 3, "speed": speed, "stream_rate": rate}
        start_machine(start_node, namespace=f"/{name}", **options)
        clients.append(GoalClient(node, spin_until, EvaluateSetpoint, f"{name}/evaluate_setpoint"))
    for index, point in enumerate(POINTS):
        results = []
        for client in clients:
            client.send(evaluation_goal(point, index=index))
            results.append(said(client.wait()))
        assert results[0] == results[1]
        assert len(results[0]) == 10 + 6 + 2
        assert results[0]["error"] == ""
        assert results[0]["K1 readback"][0] == point["K1"]
