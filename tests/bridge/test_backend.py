"""The bridge's machine: what of a mapping does not fit the types, and controls by services and actions."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml
from rcl_interfaces.msg import ParameterValue, SetParametersResult
from rcl_interfaces.srv import GetParameters, SetParameters
from rclpy.action import ActionServer, CancelResponse
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from std_msgs.msg import Float32, String

from mobo_msgs_py import msg
from mobo_msgs_py.action import ApplySetpoint, EvaluateSetpoint
from mobo_tuner.bridge.backend import BridgeBackend
from mobo_tuner.bridge.mapping import parse_mapping
from mobo_tuner.bridge.section import MappingError
from mobo_tuner.machine.backend import Failure, Operation
from mobo_tuner.ros.qos import LATCHED

RESULT = EvaluateSetpoint.Result
MANUAL = Path(__file__).parents[2] / "docs" / "bridge.md"
Spin = Callable[..., None]
APPLY = "mobo_msgs_py/action/ApplySetpoint"


def variable(name: str, setpoint: dict[str, Any], readback: dict[str, Any]) -> dict[str, Any]:
    return {
        "min": 0.0, "max": 10.0, "unit": "A", "max_step": 1.0, "slew": 100.0, "tolerance": 0.1,
        "setpoint": {"field": f"parameters[name={name}].value.double_value", **setpoint},
        "readback": readback,
    }  # fmt: skip


def lab() -> dict[str, Any]:
    """Controls whose two variables are set by one service and by an action, and read by a service."""
    read = {"service": "lab/get", "type": "rcl_interfaces/srv/GetParameters", "period": 0.05}
    field = "values[0].double_value"
    setpoint = {"service": "lab/set", "type": "rcl_interfaces/srv/SetParameters"}
    return {
        "name": "lab",
        "move": {"rate": 50.0, "settle_time": 0.1, "timeout": 1.0},
        "variables": {
            "a": variable(
                "a",
                setpoint | {"success": "results[0].successful"},
                read | {"message": {"names": ["a"]}, "field": field},
            ),
            "b": variable(
                "b",
                {"action": "lab/go", "type": APPLY, "field": "setpoint[name=b].value"},
                read | {"message": {"names": ["b"]}, "field": field},
            )
            | {"settled": {"topic": "lab/b", "type": "std_msgs/msg/String", "field": "data",
                           "equals": "at rest", "stale_after": math.inf, "qos": "latched"}},
        },
        "diagnostics": {
            "sum": {"unit": "mm", "read": {"action": "lab/go", "type": APPLY, "timeout": 1.0,
                                           "field": "readbacks[name=sum].value"}},
            "beat": {"read": {"topic": "lab/beat", "type": "std_msgs/msg/Float32", "field": "data",
                              "scale": 2.0, "offset": 1.0, "timeout": 1.0},
                     "average": {"seconds": 0.3}},
        },
    }  # fmt: skip


class Lab:
    """A machine of services and actions; its variables jump."""

    def __init__(self, node: Node) -> None:
        self.values = {"a": 2.0, "b": 5.0}
        self.sent: list[tuple[str, float]] = []
        self.broken = ""
        self.deaf = False
        node.create_service(SetParameters, "lab/set", self._set)
        node.create_service(GetParameters, "lab/get", self._get)
        self._server = ActionServer(
            node, ApplySetpoint, "lab/go", self._go, cancel_callback=lambda _: CancelResponse.ACCEPT
        )
        self._beat = node.create_publisher(Float32, "lab/beat", 10)
        node.create_timer(0.05, lambda: self._beat.publish(Float32(data=3.0)))
        self.rest = node.create_publisher(String, "lab/b", LATCHED)
        self.rest.publish(String(data="at rest"))

    def _put(self, name: str, value: float) -> None:
        self.values[name] = value
        self.sent.append((name, value))

    def _set(self, request: Any, response: Any) -> Any:
        for parameter in request.parameters:
            if not self.broken:
                self._put(parameter.name, parameter.value.double_value)
        result = SetParametersResult(successful=not self.broken, reason=self.broken)
        response.results = [result for _ in request.parameters]
        return response

    def _get(self, request: Any, response: Any) -> Any:
        response.values = [ParameterValue(double_value=self.values[n]) for n in request.names]
        return response

    def _go(self, handle: Any) -> Any:
        for item in handle.request.setpoint:
            self._put(item.name, item.value)
        handle.succeed()
        total = msg.NamedValue(name="sum", value=sum(self.values.values()))
        return ApplySetpoint.Result(readbacks=[total])


@pytest.fixture
def backend(
    node: Node, executor: SingleThreadedExecutor, spin_until: Spin
) -> Iterator[Callable[..., tuple[Lab, BridgeBackend]]]:
    nodes: list[Node] = []

    def make(mapping: dict[str, Any] | None = None) -> tuple[Lab, BridgeBackend]:
        other = Node("lab", context=node.context)
        nodes.append(other)
        executor.add_node(other)
        machine = Lab(other)
        bridge = BridgeBackend(node, parse_mapping(mapping or lab(), "lab.yaml"), executor)
        spin_until(lambda: bridge.refusal() is None, "all of the lab")
        return machine, bridge

    yield make
    for other in nodes:
        executor.remove_node(other)
        other.destroy_node()


def run(executor: SingleThreadedExecutor, spin_until: Spin, function: Any, *args: Any) -> Any:
    task = executor.create_task(function, *args)
    spin_until(task.done, "the end of a coroutine")
    return task.result()


def test_services_and_actions_move_and_measure(
    backend: Callable[..., tuple[Lab, BridgeBackend]],
    executor: SingleThreadedExecutor,
    spin_until: Spin,
) -> None:
    machine, bridge = backend()
    operation = Operation(executor, bridge.hold)
    assert run(executor, spin_until, bridge.move, {"a": 4.0, "b": 3.5}, operation) is None
    # Both arrive together, in two steps of at most 1 A.
    assert machine.sent == [("a", 3.0), ("b", 4.25), ("a", 4.0), ("b", 3.5)]
    measured = run(executor, spin_until, bridge.measure, 0, operation)
    assert measured.failure is None
    assert measured.shots == 1
    found = {d.name: (d.value, d.unit) for d in measured.diagnostics}
    assert found == {"sum": (7.5, "mm"), "beat": (7.0, "")}
    assert {r.name: r.value for r in measured.readbacks} == {"a": 4.0, "b": 3.5}


def test_a_setpoint_that_is_not_taken_ends_the_move(
    backend: Callable[..., tuple[Lab, BridgeBackend]],
    executor: SingleThreadedExecutor,
    spin_until: Spin,
) -> None:
    machine, bridge = backend()
    machine.broken = "in local mode"
    operation = Operation(executor, bridge.hold)
    failure = run(executor, spin_until, bridge.move, {"a": 4.0, "b": 5.0}, operation)
    assert failure == Failure(RESULT.UNKNOWN, "the service 'lab/set' failed: no reason")
    assert machine.sent == []


def test_a_variable_that_is_not_settled_by_its_own_account_times_out(
    backend: Callable[..., tuple[Lab, BridgeBackend]],
    executor: SingleThreadedExecutor,
    spin_until: Spin,
) -> None:
    machine, bridge = backend()
    operation = Operation(executor, bridge.hold)
    machine.rest.publish(String(data="moving"))
    failure = run(executor, spin_until, bridge.move, {"a": 2.5, "b": 5.0}, operation)
    assert failure is not None
    assert failure.code == RESULT.TIMEOUT
    assert failure.message == "b is not settled by its own account, 1 s after the end of the ramp"


def test_a_variable_that_leaves_its_setpoint_while_measured_spoils_the_measurement(
    backend: Callable[..., tuple[Lab, BridgeBackend]],
    executor: SingleThreadedExecutor,
    spin_until: Spin,
) -> None:
    machine, bridge = backend()
    operation = Operation(executor, bridge.hold)
    assert run(executor, spin_until, bridge.move, {"a": 2.0, "b": 5.0}, operation) is None
    machine.values["a"] = 3.5
    measured = run(executor, spin_until, bridge.measure, 20, operation)
    assert measured.failure.code == RESULT.INVALID_MEASUREMENT
    assert "A while measured, more than 0.1 from its set-point 2" in measured.failure.message
    # Somebody moved it, or its readback lies: nothing moves until that is clear.
    refusal = bridge.refusal()
    assert refusal is not None
    assert refusal.code == RESULT.INTERLOCK
    assert refusal.message.startswith("a reads 3.5 A, but was set to 2 A")


def test_a_moved_variable_is_followed_where_the_mapping_says_so(
    backend: Callable[..., tuple[Lab, BridgeBackend]],
    executor: SingleThreadedExecutor,
    spin_until: Spin,
) -> None:
    mapping = lab()
    mapping["move"]["if_moved"] = "follow"
    machine, bridge = backend(mapping)
    operation = Operation(executor, bridge.hold)
    assert run(executor, spin_until, bridge.move, {"a": 2.0, "b": 5.0}, operation) is None
    machine.values["a"] = 8.0
    spin_until(lambda: {r.name: r.value for r in bridge.readbacks()}["a"] == 8.0, "the readback")
    assert bridge.refusal() is None
    machine.sent.clear()
    assert run(executor, spin_until, bridge.move, {"a": 7.0, "b": 5.0}, operation) is None
    assert ("a", 7.0) in machine.sent
    machine.values["a"] = 10.2  # beyond its limits: from there, nothing moves
    spin_until(lambda: bridge.refusal() is not None, "the refusal")
    refusal = bridge.refusal()
    assert refusal is not None
    assert "a reads 10.2 A, which is outside its limits, 0 to 10 A" in refusal.message


def changed(path: str, value: Any) -> dict[str, Any]:
    content = lab()
    branch: Any = content
    *parents, leaf = path.split("/")
    for parent in parents:
        branch = branch[parent]
    branch[leaf] = value
    return content


JOINT = {"topic": "joints", "type": "sensor_msgs/msg/JointState"}


@pytest.mark.parametrize(
    ("path", "value", "sentence"),
    [
        (
            "variables/a/readback/type",
            "no_such/srv/Type",
            "lab.yaml: variables.a.readback.type: the type no_such/srv/Type is not installed",
        ),
        (
            "variables/a/readback/field",
            "value",
            "lab.yaml: variables.a.readback.field: GetParameters_Response has no field 'value'",
        ),
        (
            "variables/a/setpoint/success",
            "results",
            "lab.yaml: variables.a.setpoint.success: results is an array of",
        ),
        (
            "variables/a/setpoint/message",
            {"names": []},
            "lab.yaml: variables.a.setpoint.message: SetParameters_Request has no field 'names'",
        ),
        (
            "variables/a/setpoint",
            JOINT | {"field": "position[1]"},
            "lab.yaml: variables.a.setpoint: position[0] would be sent as well",
        ),
        (
            "variables/a/setpoint",
            JOINT | {"field": "header.stamp.sec", "scale": 1e-12},
            "variables.a.setpoint.field: header.stamp.sec would be 10000000000000; int32 takes",
        ),
        (
            "variables/b/setpoint",
            {"service": "lab/set", "type": "rcl_interfaces/srv/SetParameters",
             "field": "parameters[name=b].value.double_value"},
            "lab.yaml: variables.b.setpoint.success differs from that of a",
        ),
        (
            "diagnostics/beat/read/stamp",
            "data",
            "lab.yaml: diagnostics.beat.read.stamp: data is float; builtin_interfaces/msg/Time",
        ),
        (
            "diagnostics/beat/read/topic",
            "lab//beat",
            "lab.yaml: diagnostics.beat.read.topic is 'lab//beat'; it must be the name of a topic",
        ),
    ],
)  # fmt: skip
def test_a_mapping_that_does_not_fit_the_types_is_refused(
    node: Node, executor: SingleThreadedExecutor, path: str, value: Any, sentence: str
) -> None:
    with pytest.raises(MappingError) as caught:
        BridgeBackend(node, parse_mapping(changed(path, value), "lab.yaml"), executor)
    assert sentence in str(caught.value)


def manual_example() -> Any:
    """The whole example of the manual."""
    text = MANUAL.read_text(encoding="utf-8")
    found = re.search(r"<!-- A test loads this. -->\n```yaml\n(.*?)```", text, flags=re.DOTALL)
    assert found is not None
    return yaml.safe_load(found[1])


def test_the_manuals_example_fits_the_types(node: Node, executor: SingleThreadedExecutor) -> None:
    mapping = parse_mapping(manual_example(), "manual")
    bridge = BridgeBackend(node, mapping, executor)
    assert [(v.name, v.min, v.max, v.unit) for v in bridge.variables] == [
        ("Q1", -10.0, 10.0, "A"),
        ("phase", -30.0, 30.0, "deg"),
    ]
    refusal = bridge.refusal()
    assert refusal is not None
    assert refusal.code == RESULT.MACHINE_LOST  # nothing of it is there
    assert refusal.message.startswith("interlock permit is not known: ")


def test_an_array_without_gaps_is_accepted_with_its_template(
    node: Node, executor: SingleThreadedExecutor
) -> None:
    setpoint = JOINT | {"field": "position[1]", "message": {"position": [0.0], "name": ["x", "y"]}}
    BridgeBackend(node, parse_mapping(changed("variables/a/setpoint", setpoint), "m"), executor)
    assert node.get_publishers_info_by_topic("/joints")
