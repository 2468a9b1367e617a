"""What the tuner publishes."""

from __future__ import annotations

from rclpy.duration import Duration
from rclpy.node import Node
from std_msgs.msg import Float64

from mobo_msgs_py import msg
from mobo_tuner.core.problem import Problem
from mobo_tuner.ros.qos import KEPT, LATCHED, STREAM


class TunerPublishers:
    """The tuner's topics, all relative to its namespace.

    `problem`, `status` and `pareto_front` are latched. `evaluation` is kept for subscribers that
    come late, for a recorder may take seconds to discover a tuner whose run has begun. Beside it
    stands one flat topic `plot/<name>` per variable, diagnostic and figure, for plotting tools that
    cannot look into arrays.
    """

    def __init__(self, node: Node, problem: Problem) -> None:
        self._problem = node.create_publisher(msg.Problem, "problem", LATCHED)
        self._status = node.create_publisher(msg.TunerStatus, "status", LATCHED)
        self._front = node.create_publisher(msg.ParetoFront, "pareto_front", LATCHED)
        self._evaluation = node.create_publisher(msg.Evaluation, "evaluation", KEPT)
        names = dict.fromkeys(
            [
                *problem.variable_names,
                *problem.required_diagnostics,
                *(o.name for o in problem.observables),
                "hypervolume",
                "suggest_seconds",
            ]
        )
        self._plots = {
            name: node.create_publisher(Float64, f"plot/{name}", STREAM) for name in names
        }

    def problem(self, message: msg.Problem) -> None:
        """Publish the problem of a run that begins."""
        self._problem.publish(message)

    def status(self, message: msg.TunerStatus) -> None:
        """Publish what the tuner is doing."""
        self._status.publish(message)

    def front(self, message: msg.ParetoFront) -> None:
        """Publish the Pareto front as it is now."""
        self._front.publish(message)

    def acknowledged(self, timeout: Duration) -> bool:
        """Whether every subscriber has all evaluations that were published, channels included."""
        publishers = (self._evaluation, *self._plots.values())
        return all(publisher.wait_for_all_acked(timeout) for publisher in publishers)

    def evaluation(self, message: msg.Evaluation) -> None:
        """Publish an evaluation, whole and as flat channels."""
        self._evaluation.publish(message)
        values = {item.name: item.value for item in (*message.diagnostics, *message.setpoint)}
        values["hypervolume"] = message.hypervolume
        values["suggest_seconds"] = message.suggest_seconds
        for name, publisher in self._plots.items():
            if name in values:
                publisher.publish(Float64(data=values[name]))
