"""What tests of the simulated machine's node share."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
from rclpy.node import Node
from rclpy.qos import QoSProfile

from mobo_msgs_py import msg
from mobo_msgs_py.action import EvaluateSetpoint
from tests.support import tuner as tuning_support
from tests.support.processes import NodeProcess, NodeStarter

MIDDLE = {"K1": 475.0, "K2": 230.0, "phi1": -5.0, "phi2": -5.0, "G1": 67.5, "G2": 20.0}
LOSSY = MIDDLE | {"K1": 400.0, "K2": 180.0, "G1": 75.0}
CONFIGURE = Transition.TRANSITION_CONFIGURE
ACTIVATE = Transition.TRANSITION_ACTIVATE
DEACTIVATE = Transition.TRANSITION_DEACTIVATE
CLEANUP = Transition.TRANSITION_CLEANUP
SHUTDOWN = Transition.TRANSITION_INACTIVE_SHUTDOWN


def start_machine(start_node: NodeStarter, namespace: str = "", **parameters: Any) -> NodeProcess:
    """Start the simulated machine with these parameters."""
    options = ["-r", f"__ns:={namespace}"] if namespace else []
    for name, value in parameters.items():
        options += ["-p", f"{name}:={str(value).lower() if isinstance(value, bool) else value}"]
    return start_node("-m", "awa_sim_node.node", "--ros-args", *options)


def evaluation_goal(setpoint: dict[str, float], **fields: Any) -> EvaluateSetpoint.Goal:
    """A goal of `evaluate_setpoint`."""
    named = [msg.NamedValue(name=name, value=value) for name, value in setpoint.items()]
    return EvaluateSetpoint.Goal(**{"run_id": "run", "setpoint": named, **fields})


class Services(tuning_support.Services):
    """Calls services of the machine's node and waits for the answers."""

    def __init__(self, node: Node, spin_until: Callable[..., None]) -> None:
        super().__init__(node, spin_until, of="awa_sim")

    def change_state(self, transition: int) -> bool:
        """Ask for a transition of the node's life; whether it succeeded."""
        request = ChangeState.Request(transition=Transition(id=transition))
        return bool(self.call(ChangeState, "awa_sim/change_state", request).success)


class Listener:
    """Keeps every message of a topic."""

    def __init__(self, node: Node, message: type, topic: str, qos: QoSProfile | int = 100) -> None:
        self.messages: list[Any] = []
        node.create_subscription(message, topic, self.messages.append, qos)

    @property
    def data(self) -> list[Any]:
        """What the messages of `std_msgs` say."""
        return [message.data for message in self.messages]
