"""Topics, services and actions of the suite: the name, type and purpose of each, in one place.

The nodes make their publishers, servers and clients from these declarations, and docs/interfaces.md is
generated from them. All names but `/diagnostics` are relative, so that they follow namespaces and
remappings.
"""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from dataclasses import dataclass
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.action import ActionClient
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.client import Client
from rclpy.event_handler import PublisherEventCallbacks
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile
from rclpy.service import Service as RclpyService
from rclpy.subscription import Subscription
from std_msgs.msg import Float64
from std_srvs.srv import Trigger

from mobo_msgs_py import action, msg, srv
from mobo_tuner.ros.action_server import Goal, GoalServer
from mobo_tuner.ros.qos import KEPT, LATCHED, STREAM


@dataclass(frozen=True)
class Topic:
    """A topic.

    Attributes:
        name: Name; a part in angle brackets stands for the name of a quantity.
        kind: Message type.
        qos: Quality of service of its publishers and subscribers.
        node: Node that publishes it.
        purpose: Content of the messages, and when they are published.
    """

    name: str
    kind: type
    qos: QoSProfile
    node: str
    purpose: str

    def publisher(self, node: Node, quantity: str = "") -> Publisher:
        """Create a publisher.

        Args:
            node: Node that publishes.
            quantity: Name of the quantity, if the topic's name has a part for it.
        """
        # Without rclpy's own events, of which the executor would look at two per publisher whenever it
        # waits; the subscriber warns of an incompatible QoS or type, too.
        events = PublisherEventCallbacks(use_default_callbacks=False)
        return node.create_publisher(
            self.kind, self._name_of(quantity), self.qos, event_callbacks=events
        )

    def subscription(
        self,
        node: Node,
        callback: Callable[[Any], None],
        quantity: str = "",
        *,
        raw: bool = False,
    ) -> Subscription:
        """Create a subscription.

        Args:
            node: Node that subscribes.
            callback: Function that takes the messages.
            quantity: Name of the quantity, if the topic's name has a part for it.
            raw: Whether the messages stay serialised.
        """
        return node.create_subscription(
            self.kind, self._name_of(quantity), callback, self.qos, raw=raw
        )

    def _name_of(self, quantity: str) -> str:
        before, opening, rest = self.name.partition("<")
        return f"{before}{quantity}{rest.partition('>')[2]}" if opening else self.name


@dataclass(frozen=True)
class Service:
    """A service.

    Attributes:
        name: Name.
        kind: Service type.
        node: Node that serves it.
        purpose: Effect of a call.
    """

    name: str
    kind: type
    node: str
    purpose: str

    def server(
        self, node: Node, callback: Callable[[Any, Any], Any], *, waits: bool = False
    ) -> RclpyService:
        """Create a server.

        Args:
            node: Node that serves.
            callback: Function or coroutine function that takes a request and an empty response, and
                returns the response.
            waits: Whether the callback waits for what other callbacks of the node do.
        """
        group = ReentrantCallbackGroup() if waits else None
        return node.create_service(self.kind, self.name, callback, callback_group=group)

    def client(self, node: Node) -> Client:
        """Create a client.

        Args:
            node: Node that calls the service.
        """
        return node.create_client(self.kind, self.name)


@dataclass(frozen=True)
class Action:
    """An action.

    Attributes:
        name: Name.
        kind: Action type.
        node: Node that serves it.
        purpose: Effect of a goal.
    """

    name: str
    kind: Any
    node: str
    purpose: str

    def server(self, node: Node, execute: Callable[[Goal], Awaitable[Any]]) -> GoalServer:
        """Create a server.

        Args:
            node: Node that serves.
            execute: Coroutine function that serves a goal and returns the action's result.
        """
        return GoalServer(node, self.kind, self.name, execute)

    def client(self, node: Node) -> ActionClient:
        """Create a client.

        Args:
            node: Node that sends goals.
        """
        return ActionClient(node, self.kind, self.name)


PROBLEM = Topic(
    "problem",
    msg.Problem,
    LATCHED,
    "tuner",
    "Problem of the run, at its start and after each change.",
)
RUN_RECORDS = Topic(
    "run_records",
    msg.RunRecords,
    LATCHED,
    "tuner",
    "Set-up of the run, its changes and its moves; a bag needs them for `rebuild`.",
)
EVALUATION = Topic(
    "evaluation", msg.Evaluation, KEPT, "tuner", "Exactly one message per evaluation."
)
LATEST_EVALUATION = Topic(
    "latest_evaluation",
    msg.Evaluation,
    LATCHED,
    "tuner",
    "The same message; a late subscriber gets the newest at once, and no other.",
)
PARETO_FRONT = Topic(
    "pareto_front",
    msg.ParetoFront,
    LATCHED,
    "tuner",
    "Whole Pareto front, at the start and the end of a run, after a change of the problem, and whenever a "
    "tenth of its points has changed. `list_working_points` returns it at any time; `status` has its size.",
)
STATUS = Topic(
    "status",
    msg.TunerStatus,
    LATCHED,
    "tuner",
    "State of the tuner, after each change of state and at 1 Hz.",
)
MACHINE_SETPOINT = Topic(
    "machine_setpoint",
    msg.NamedValues,
    LATCHED,
    "tuner",
    "Set-point to which the tuner sends the machine, before each evaluation and each move.",
)
MACHINE_READBACKS = Topic(
    "machine_readbacks",
    msg.NamedValues,
    LATCHED,
    "tuner",
    "Readbacks while the machine is on its way there, at 10 Hz at most, and at its arrival.",
)
PLOT = Topic(
    "plot/<name>",
    Float64,
    STREAM,
    "tuner",
    "Value of a variable, a diagnostic, `hypervolume` or `suggest_seconds`, once per evaluation, for "
    "plotting tools.",
)
HEARTBEAT = Topic(
    "heartbeat", msg.Heartbeat, STREAM, "tuner", "Sign of life to the machine, during a run."
)
RECORDER_STATUS = Topic(
    "recorder_status",
    msg.RecorderStatus,
    LATCHED,
    "recorder",
    "State of the recorder, after each change and at 1 Hz.",
)
DIAGNOSTICS = Topic(
    "/diagnostics",
    DiagnosticArray,
    STREAM,
    "tuner, recorder, machine",
    "Health of the node's parts, at 1 Hz.",
)
PAUSE = Service("pause", Trigger, "tuner", "Pauses the run after the current evaluation.")
RESUME = Service("resume", Trigger, "tuner", "Continues a paused run.")
STEP = Service("step", Trigger, "tuner", "Does one evaluation of a paused run.")
SKIP = Service(
    "skip", Trigger, "tuner", "Ends the current evaluation, which counts as a failed one."
)
STOP_AFTER_THIS = Service(
    "stop_after_this", Trigger, "tuner", "Ends the run after the current evaluation."
)
QUEUE_SETPOINT = Service(
    "queue_setpoint",
    srv.QueueSetpoint,
    "tuner",
    "Adds an operator's set-point, which the run evaluates next.",
)
FORGET = Service(
    "forget",
    srv.ForgetEvaluation,
    "tuner",
    "Withdraws an evaluation of the run, or one diagnostic of it: it counts as never measured.",
)
UNFORGET = Service(
    "unforget", srv.ForgetEvaluation, "tuner", "Ends a withdrawal: the evaluation counts again."
)
LIST_WORKING_POINTS = Service(
    "list_working_points",
    srv.ListWorkingPoints,
    "tuner",
    "Returns the Pareto front, measured and predicted.",
)
ASK = Service(
    "ask", srv.Ask, "tuner", "Returns the next set-point, for clients that own their loop."
)
TELL = Service("tell", srv.Tell, "tuner", "Adds a measurement, for clients that own their loop.")
DESCRIBE_MACHINE = Service(
    "describe_machine",
    srv.DescribeMachine,
    "machine",
    "Returns the machine's variables and diagnostics.",
)
TUNE = Action("tune", action.Tune, "tuner", "Carries out a run.")
GO_TO_WORKING_POINT = Action(
    "go_to_working_point",
    action.GoToWorkingPoint,
    "tuner",
    "Moves the machine to a point of the Pareto front.",
)
EVALUATE_SETPOINT = Action(
    "evaluate_setpoint",
    action.EvaluateSetpoint,
    "machine",
    "Moves the machine to a set-point and measures there.",
)
APPLY_SETPOINT = Action(
    "apply_setpoint",
    action.ApplySetpoint,
    "machine",
    "Moves the machine to a set-point without a measurement.",
)

TOPICS = tuple(item for item in list(globals().values()) if isinstance(item, Topic))
SERVICES = tuple(item for item in list(globals().values()) if isinstance(item, Service))
ACTIONS = tuple(item for item in list(globals().values()) if isinstance(item, Action))
