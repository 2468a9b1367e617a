"""The declared interfaces are those that the running nodes have."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from rclpy.node import Node

import awa_sim_node.interfaces as machine
from mobo_msgs_py import action, msg
from mobo_tuner.machine import backend
from mobo_tuner.ros import interfaces
from mobo_tuner.runs.records import StopReason
from tests.support.processes import NodeStarter

NODES = ("tuner", "awa_sim", "recorder")
# What rclpy adds to every node, to a lifecycle node and to an action.
OF_ROS = ("rosout", "parameter_events", "transition_event")


def names(found: list[tuple[str, list[str]]], node: str) -> Iterator[tuple[str, str]]:
    """Names and types of the interfaces that the project gives a node."""
    for name, (kind,) in found:
        if not name.endswith(OF_ROS) and not name.startswith(f"/{node}/"):
            yield name.removeprefix("/"), kind


def declared(kind: type) -> str:
    """A type's name as the graph gives it."""
    package, folder, *_ = kind.__module__.split(".")
    return f"{package}/{folder}/{kind.__name__}"


def test_the_nodes_have_the_declared_interfaces_and_no_others(
    node: Node,
    start_node: NodeStarter,
    start_tuner: Callable[..., object],
    start_machine: Callable[..., object],
    spin_until: Callable[..., None],
    tmp_path: Path,
) -> None:
    start_tuner()
    start_machine("publish_clock:=true", "publish_truth:=true")
    start_node(
        "-m", "mobo_tuner.nodes.recorder", "--ros-args", "-p", f"bag_path:={tmp_path / 'bag'}"
    )
    variables = ("x1", "x2")
    diagnostics = ("f1", "f2", "g")
    quantities = {
        "<name>": (*variables, "f1", "f2", "hypervolume", "suggest_seconds"),
        "<device>": variables,
        "<diagnostic>": diagnostics,
    }
    published = {}
    for topic in (*interfaces.TOPICS, *machine.TOPICS):
        for owner in topic.node.replace("machine", "awa_sim").split(", "):
            if owner not in NODES:
                continue
            place = next((place for place in quantities if place in topic.name), "")
            for name in quantities.get(place, ("",)):
                full = topic.name.replace(place, name).removeprefix("/")
                published[owner, full] = declared(topic.kind)
    served = {
        ("awa_sim" if service.node == "machine" else service.node, service.name): declared(
            service.kind
        )
        for service in (*interfaces.SERVICES, *machine.SERVICES)
    }
    actions = {
        ("awa_sim" if action.node == "machine" else action.node, action.name)
        for action in interfaces.ACTIONS
    }

    def graph() -> tuple[dict[tuple[str, str], str], dict[tuple[str, str], str]]:
        topics, services = {}, {}
        for owner in NODES:
            for name, kind in names(node.get_publisher_names_and_types_by_node(owner, "/"), owner):
                topics[owner, name] = kind
            for name, kind in names(node.get_service_names_and_types_by_node(owner, "/"), owner):
                services[owner, name] = kind
        return topics, services

    def served_actions() -> set[tuple[str, str]]:
        return {
            (owner, name.split("/_action/")[0]) for owner, name in graph()[1] if "/_action/" in name
        }

    spin_until(lambda: {*NODES} <= {*node.get_node_names()}, "the nodes")
    spin_until(lambda: graph()[0].keys() >= published.keys(), "the topics")
    spin_until(lambda: graph()[1].keys() >= served.keys(), "the services")
    spin_until(lambda: served_actions() >= actions, "the actions")
    topics, services = graph()
    assert {k: v for k, v in topics.items() if "/_action/" not in k[1]} == published
    assert {k: v for k, v in services.items() if "/_action/" not in k[1]} == served
    assert served_actions() == actions


def constants(kind: type, prefix: str) -> dict[str, str]:
    """The string constants of a message whose names begin with a prefix, by the rest of the name."""
    names = [name for name in dir(type(kind)) if name.startswith(prefix)]
    return {name.removeprefix(prefix): getattr(kind, name) for name in names}


@pytest.mark.parametrize("kind", [action.Tune.Result, msg.TunerStatus])
def test_stop_reasons_are_constants_of_the_messages(kind: type) -> None:
    assert constants(kind, "STOP_REASON_") == {reason.name: reason for reason in StopReason}


@pytest.mark.parametrize(
    ("kind", "names"),
    [
        (action.EvaluateSetpoint.Feedback, {"RAMPING", "SETTLING", "MEASURING"}),
        (action.ApplySetpoint.Feedback, {"RAMPING", "SETTLING"}),
        (action.GoToWorkingPoint.Feedback, {"RAMPING", "SETTLING", "MEASURING"}),
        (msg.TunerStatus, {"RAMPING", "SETTLING", "MEASURING"}),
    ],
)
def test_phases_are_constants_of_the_messages(kind: type, names: set[str]) -> None:
    assert constants(kind, "PHASE_") == {name: getattr(backend, name) for name in names}
