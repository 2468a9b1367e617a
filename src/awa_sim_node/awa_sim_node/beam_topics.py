"""Beam measurements as plain topics: one `beam/<name>` per diagnostic, one message per shot."""

from __future__ import annotations

from collections.abc import Mapping

from rclpy.node import Node
from std_msgs.msg import Float64, Header

from awa_sim_node import interfaces
from awa_sim_node.machine import ModelDescription, Shot
from mobo_msgs_py import msg
from mobo_tuner.ros.conversions import named_values


class BeamTopics:
    """Publishers of the measured shots and, for tests, of their true values.

    Args:
        node: Node that owns the topics.
        description: Description of the machine.
        with_truth: Whether to publish the topic `truth`.
    """

    def __init__(self, node: Node, description: ModelDescription, with_truth: bool) -> None:
        self._node = node
        self._units = {v.name: v.unit for v in description.variables}
        self._units |= {d.name: d.unit for d in description.diagnostics}
        self._shots = {
            diagnostic.name: interfaces.BEAM.publisher(node, diagnostic.name)
            for diagnostic in description.diagnostics
        }
        self._truth = interfaces.TRUTH.publisher(node) if with_truth else None
        self._uncertainty = interfaces.MODEL_UNCERTAINTY.publisher(node)

    def publish(self, shot: Shot) -> None:
        """Publish one shot; values that were not measured are NaN."""
        for name, value in shot.measured.items():
            self._shots[name].publish(Float64(data=value))
        if self._truth is not None:
            self._truth.publish(self._message({**shot.inputs, **shot.truth}))

    def publish_uncertainty(self, spread: Mapping[str, float]) -> None:
        """Publish the uncertainty of the machine's model at the current inputs.

        Args:
            spread: Standard deviation of each diagnostic; nothing is published if it is empty.
        """
        if spread:
            self._uncertainty.publish(self._message(spread))

    def _message(self, values: Mapping[str, float]) -> msg.NamedValues:
        return msg.NamedValues(
            header=Header(stamp=self._node.get_clock().now().to_msg()),
            values=named_values(values, self._units),
        )
