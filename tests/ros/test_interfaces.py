"""The declared interfaces are those that the running nodes have."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

from rclpy.node import Node

import awa_sim_node.interfaces as machine
from mobo_tuner.ros import interfaces
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
