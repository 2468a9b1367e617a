"""Profiles as `rosbag2_py` has them: setters in place of attributes, and enumerations of rmw."""

from __future__ import annotations

from enum import IntEnum
from typing import NamedTuple

from rosbags.interfaces import (
    Qos,
    QosDurability,
    QosHistory,
    QosLiveliness,
    QosReliability,
    QosTime,
)


class rmw_qos_history_policy_t(IntEnum):  # noqa: N801
    RMW_QOS_POLICY_HISTORY_SYSTEM_DEFAULT = 0
    RMW_QOS_POLICY_HISTORY_KEEP_LAST = 1
    RMW_QOS_POLICY_HISTORY_KEEP_ALL = 2
    RMW_QOS_POLICY_HISTORY_UNKNOWN = 3


class rmw_qos_reliability_policy_t(IntEnum):  # noqa: N801
    RMW_QOS_POLICY_RELIABILITY_SYSTEM_DEFAULT = 0
    RMW_QOS_POLICY_RELIABILITY_RELIABLE = 1
    RMW_QOS_POLICY_RELIABILITY_BEST_EFFORT = 2
    RMW_QOS_POLICY_RELIABILITY_UNKNOWN = 3


class rmw_qos_durability_policy_t(IntEnum):  # noqa: N801
    RMW_QOS_POLICY_DURABILITY_SYSTEM_DEFAULT = 0
    RMW_QOS_POLICY_DURABILITY_TRANSIENT_LOCAL = 1
    RMW_QOS_POLICY_DURABILITY_VOLATILE = 2
    RMW_QOS_POLICY_DURABILITY_UNKNOWN = 3


class rmw_qos_liveliness_policy_t(IntEnum):  # noqa: N801
    RMW_QOS_POLICY_LIVELINESS_SYSTEM_DEFAULT = 0
    RMW_QOS_POLICY_LIVELINESS_AUTOMATIC = 1
    RMW_QOS_POLICY_LIVELINESS_MANUAL_BY_TOPIC = 3
    RMW_QOS_POLICY_LIVELINESS_UNKNOWN = 4


class Duration(NamedTuple):
    seconds: int
    nanoseconds: int


class QoS:
    def __init__(self, history_depth: int) -> None:
        self._depth = history_depth

    def history(self, policy: rmw_qos_history_policy_t) -> None:
        self._history = rmw_qos_history_policy_t(policy)

    def reliability(self, policy: rmw_qos_reliability_policy_t) -> None:
        self._reliability = rmw_qos_reliability_policy_t(policy)

    def durability(self, policy: rmw_qos_durability_policy_t) -> None:
        self._durability = rmw_qos_durability_policy_t(policy)

    def liveliness(self, policy: rmw_qos_liveliness_policy_t) -> None:
        self._liveliness = rmw_qos_liveliness_policy_t(policy)

    def deadline(self, duration: Duration) -> None:
        self._deadline = Duration(*duration)

    def lifespan(self, duration: Duration) -> None:
        self._lifespan = Duration(*duration)

    def liveliness_lease_duration(self, duration: Duration) -> None:
        self._lease = Duration(*duration)

    def avoid_ros_namespace_conventions(self, avoid: bool) -> None:
        self._avoid = avoid

    def profile(self) -> Qos:
        """The same for rosbags."""

        def name(policy: IntEnum) -> str:
            return policy.name.split("_POLICY_")[1].split("_", 1)[1]

        return Qos(
            history=QosHistory[name(self._history)],
            depth=self._depth,
            reliability=QosReliability[name(self._reliability)],
            durability=QosDurability[name(self._durability)],
            deadline=QosTime(*self._deadline),
            lifespan=QosTime(*self._lifespan),
            liveliness=QosLiveliness[name(self._liveliness)],
            liveliness_lease_duration=QosTime(*self._lease),
            avoid_ros_namespace_conventions=self._avoid,
        )
