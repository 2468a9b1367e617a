"""The topics of a ROS domain, found as they appear, for nodes that pass on every message as it is."""

from __future__ import annotations

import importlib
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from rclpy.topic_endpoint_info import TopicEndpointInfo

from mobo_tuner.runs.definitions import Definition, DefinitionError, find_definition

QUEUE_DEPTH = 1000  # messages of a topic that may wait to be taken

OnRaw = Callable[..., None]
"""Function that takes a serialized message and facts about it, such as `received_timestamp` [ns]."""


class FoundTopic(NamedTuple):
    """A topic that has a publisher.

    Attributes:
        name: Resolved name.
        type_name: Name of its message type.
        definition: Definition of the type.
        offers: Profiles of its publishers.
    """

    name: str
    type_name: str
    definition: Definition
    offers: Sequence[QoSProfile]

    @property
    def qos(self) -> QoSProfile:
        """The strictest profile that all publishers satisfy."""
        reliable = all(offer.reliability == ReliabilityPolicy.RELIABLE for offer in self.offers)
        return QoSProfile(
            history=HistoryPolicy.KEEP_LAST,
            depth=QUEUE_DEPTH,
            reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
            durability=(
                DurabilityPolicy.TRANSIENT_LOCAL if self.is_latched else DurabilityPolicy.VOLATILE
            ),
        )

    @property
    def is_latched(self) -> bool:
        """Whether all publishers keep messages for late subscribers."""
        return all(offer.durability == DurabilityPolicy.TRANSIENT_LOCAL for offer in self.offers)

    @property
    def kind(self) -> type:
        """Class of its messages."""
        return _message_class(self.type_name)

    def subscribe(self, node: Node, take: OnRaw) -> None:
        """Subscribe to the serialized messages.

        Args:
            node: Node that subscribes.
            take: Function that takes each message.
        """
        node.create_subscription(self.kind, self.name, take, self.qos, raw=True)


class TopicDiscovery:
    """Looks for topics with a publisher; each is found or refused once.

    Hidden topics, those of actions and service events, are omitted.

    Args:
        node: Node that looks.

    Attributes:
        refused: Reason why each refused topic cannot be passed on, by its name.
    """

    def __init__(self, node: Node) -> None:
        self.refused: dict[str, str] = {}
        self._node = node
        self._found: set[str] = set()

    def new_topics(self) -> list[FoundTopic]:
        """Return the topics that have appeared since the last call."""
        found = []
        for name, type_names in self._node.get_topic_names_and_types():
            if any(part.startswith("_") for part in name.split("/")):
                continue
            if name in self._found or name in self.refused:
                continue
            publishers = self._node.get_publishers_info_by_topic(name)
            if not publishers:
                continue
            if len(type_names) > 1:
                self.refused[name] = f"it has several types: {', '.join(type_names)}"
                continue
            try:
                found.append(_found_topic(name, type_names[0], publishers))
            except DefinitionError as error:
                self.refused[name] = str(error)
                continue
            self._found.add(name)
        return found


def _found_topic(name: str, type_name: str, publishers: Sequence[TopicEndpointInfo]) -> FoundTopic:
    """Return a topic whose type is installed.

    Raises:
        DefinitionError: If it is not, or a publisher uses another version of it.
    """
    definition = find_definition(type_name)
    for publisher in publishers:
        type_hash = publisher.topic_type_hash
        if type_hash.version > 0 and str(type_hash) != definition.type_hash:
            raise DefinitionError(
                f"{publisher.node_name} publishes another version of {publisher.topic_type} than "
                "is installed here"
            )
    _message_class(type_name)
    offers = [publisher.qos_profile for publisher in publishers]
    return FoundTopic(name, type_name, definition, offers)


def _message_class(type_name: str) -> type[Any]:
    package, _, name = type_name.split("/")
    try:
        message_class: type[Any] = getattr(importlib.import_module(f"{package}.msg"), name)
    except (ImportError, AttributeError):
        raise DefinitionError(f"the Python type of {type_name} is not installed") from None
    return message_class
