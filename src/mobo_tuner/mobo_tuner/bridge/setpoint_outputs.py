"""Outputs of set-points: variables that share a topic, service or action are sent in one message."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from functools import partial
from typing import Any

from rclpy.node import Node
from rclpy.qos import QoSProfile

from mobo_tuner.bridge.calls import Call, Wait, check, create, load
from mobo_tuner.bridge.field_path import Element, Field, FieldPath
from mobo_tuner.bridge.interface_types import check_time, fill, read, write
from mobo_tuner.bridge.mapping import Endpoint, Target, Variable
from mobo_tuner.bridge.section import MappingError
from mobo_tuner.ros.qos import LATCHED


class SetpointOutput:
    """The set-points of the variables that share one target.

    Args:
        node: Node that sends.
        variables: Variables that share the target, at least one.

    Raises:
        MappingError: If they do not fit the target's type or each other.
    """

    def __init__(self, node: Node, variables: Sequence[Variable]) -> None:
        self._node = node
        self._variables = variables
        self._endpoint = endpoint = variables[0].setpoint
        self._check_agreement()
        self._publisher: Any = None
        self._call: Call | None = None
        if endpoint.target.kind == "topic":
            self._type = load(endpoint)
            check(endpoint, "message", lambda: fill(self._type(), endpoint.message))
            if endpoint.stamp is not None:
                stamp = endpoint.stamp
                check(endpoint, "stamp", lambda: check_time(self._type, stamp))
        else:
            self._call = Call(node, endpoint)
            self._type = self._call.request_type
        self._check_values()
        if self._call is None:
            qos = LATCHED if endpoint.qos == "latched" else QoSProfile(depth=10)
            self._publisher = create(
                endpoint, lambda: node.create_publisher(self._type, endpoint.target.name, qos)
            )

    @property
    def problem(self) -> str:
        """Reason why set-points would not arrive, in a few words; empty if they would."""
        if self._call is not None:
            return "" if self._call.ready else f"the {self._endpoint.target} is not there"
        if self._publisher.get_subscription_count() > 0:
            return ""
        return f"nobody listens to the {self._endpoint.target}"

    async def send(self, setpoint: Mapping[str, float], wait: Wait) -> None:
        """Send a set-point, and wait for the response of a service or an action.

        Raises:
            CallError: If it was not accepted.
        """
        if self._call is None:
            self._publisher.publish(self._message(setpoint))
        else:
            await self._call(wait, self._numbers(setpoint))

    def send_now(self, setpoint: Mapping[str, float]) -> None:
        """Send a set-point without waiting."""
        if self._call is None:
            self._publisher.publish(self._message(setpoint))
        else:
            self._call.cancel()
            self._call.send(self._numbers(setpoint))

    def cancel(self) -> None:
        """Cancel a running action."""
        if self._call is not None:
            self._call.cancel()

    def _message(self, setpoint: Mapping[str, float]) -> Any:
        message = self._type()
        fill(message, self._endpoint.message)
        for path, number in self._numbers(setpoint).items():
            write(message, path, number)
        if self._endpoint.stamp is not None:
            stamp = read(message, self._endpoint.stamp)
            now = self._node.get_clock().now().to_msg()
            stamp.sec, stamp.nanosec = now.sec, now.nanosec
        return message

    def _numbers(self, setpoint: Mapping[str, float]) -> dict[FieldPath, float | str]:
        return {_path(v.setpoint): v.setpoint.raw(setpoint[v.name]) for v in self._variables}

    def _check_agreement(self) -> None:
        """Check that the variables agree on how the message is sent, and use different fields."""
        first = self._endpoint
        seen: dict[FieldPath, str] = {}
        for variable in self._variables:
            endpoint = variable.setpoint
            for key in ("message", "success", "stamp", "timeout", "qos"):
                if getattr(endpoint, key) != getattr(first, key):
                    raise MappingError(
                        f"{endpoint.where}.{key} differs from that of "
                        f"{self._variables[0].name}, which shares the {first.target}"
                    )
            path = _path(endpoint)
            if path in seen:
                raise MappingError(
                    f"{endpoint.where}.field is {path}, where {seen[path]} is sent already"
                )
            seen[path] = variable.name

    def _check_values(self) -> None:
        """Check that all set-points within the limits fit their fields, and that arrays have no gaps."""
        message = self._type()
        fill(message, self._endpoint.message)
        mapped: dict[FieldPath, set[int]] = {}
        for variable in self._variables:
            path = _path(variable.setpoint)
            for value in (variable.minimum, variable.maximum):
                raw = variable.setpoint.raw(value)
                check(variable.setpoint, "field", partial(write, message, path, raw))
            for place, step in enumerate(path.steps):
                if isinstance(step, Element):
                    mapped.setdefault(FieldPath(path.steps[:place]), set()).add(step.index)
        for array, indices in mapped.items():
            given = _length(self._endpoint.message, array)
            for index in range(given, len(read(message, array))):
                if index not in indices:
                    raise MappingError(
                        f"{self._endpoint.where}: {array}[{index}] would be sent as well, but it is "
                        "neither mapped to a variable nor given in message"
                    )


def group_outputs(node: Node, variables: Iterable[Variable]) -> list[SetpointOutput]:
    """Return one output per target of the variables.

    Raises:
        MappingError: If they do not fit the target's type or each other.
    """
    groups: dict[Target, list[Variable]] = {}
    for variable in variables:
        groups.setdefault(variable.setpoint.target, []).append(variable)
    return [SetpointOutput(node, group) for group in groups.values()]


def _path(endpoint: Endpoint) -> FieldPath:
    assert endpoint.field is not None
    return endpoint.field


def _length(content: object, array: FieldPath) -> int:
    """Return the number of an array's elements that a file gives."""
    for step in array.steps:
        if not isinstance(step, Field) or not isinstance(content, Mapping):
            return 0
        content = content.get(step.name)
    return len(content) if isinstance(content, list) else 0
