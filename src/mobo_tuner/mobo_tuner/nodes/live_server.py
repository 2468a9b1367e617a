"""The live server: it passes every topic on to Lichtblick, Foxglove and PlotJuggler, without ROS on their side.

Messages go out as they are (CDR, with their definitions), by the protocol `foxglove.sdk.v1`. A viewer that comes late
gets what late subscribers of the topic get: the last message, or all evaluations.
"""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any

from rclpy.executors import Executor
from rclpy.node import Node
from rclpy.serialization import serialize_message
from std_srvs.srv import Trigger

from mobo_tuner.addresses import address, is_local
from mobo_tuner.client import TunerClient, TunerError
from mobo_tuner.client.values import problem_of
from mobo_tuner.core.problem import Problem
from mobo_tuner.displays.settings import setting_value, settings_of
from mobo_tuner.nodes.parameters import LIVE_SERVER
from mobo_tuner.nodes.topic_discovery import FoundTopic, TopicDiscovery
from mobo_tuner.ros import interfaces
from mobo_tuner.ros.parameters import declare, refuse_undeclared, take_given
from mobo_tuner.ros.process import Program, StartError, exit_process, run_node
from mobo_tuner.ros.waiting import STEADY_CLOCK

if TYPE_CHECKING:
    import foxglove
    from foxglove.websocket import ChannelView, Client

DISCOVERY_PERIOD = 0.5  # [s]
BACKLOG = 4096  # messages that may wait for a slow viewer; the oldest are dropped first
TRIGGER_RESPONSE = b"bool success\nstring message\n"
PROGRAM = Program(
    "live_server", "Shows all topics live in Lichtblick, Foxglove or PlotJuggler.", LIVE_SERVER
)


class KeptChannel:
    """A channel, and the messages that a viewer that comes late gets.

    Args:
        channel: Channel of the topic.
        depth: Number of messages to keep.
    """

    def __init__(self, channel: foxglove.Channel, depth: int) -> None:
        self._channel = channel
        self._kept: deque[tuple[bytes, int]] = deque(maxlen=depth)
        self._lock = threading.Lock()

    def pass_on(self, data: bytes, info: Mapping[str, int]) -> None:
        """Send a message to all viewers of the channel."""
        stamp = info["received_timestamp"]
        with self._lock:
            self._kept.append((data, stamp))
        self._channel.log(data, log_time=stamp)

    def catch_up(self, viewer: int) -> None:
        """Send the kept messages to one viewer."""
        with self._lock:
            kept = list(self._kept)
        for data, stamp in kept:
            self._channel.log(data, log_time=stamp, sink_id=viewer)


class LiveServer:
    """Connects the topics of a ROS domain with the viewers; by default they only look."""

    exit_code = None

    def __init__(self, executor: Executor) -> None:
        """Begin to listen, and print the address.

        Raises:
            UserError: If a parameter is not allowed.
            StartError: If nobody can listen there, or the library is not installed.
        """
        self.node = Node("live_server", automatically_declare_parameters_from_overrides=True)
        self._client = TunerClient(node=self.node, executor=executor)
        self._channels: dict[str, KeptChannel] = {}
        self._problem: Problem | None = None
        self._budget = 0
        try:
            given = take_given(self.node)
            parameters = declare(self.node, LIVE_SERVER)
            refuse_undeclared(self.node, given)
            self._read_only = bool(parameters["read_only"])
            self._serve(str(parameters["host"]), int(parameters["port"]))
        except BaseException:
            self._client.close()
            self.node.destroy_node()
            raise
        self._depths = {
            self.node.resolve_topic_name(topic.name): topic.qos.depth
            for topic in interfaces.TOPICS
            if "<" not in topic.name
        }
        interfaces.PROBLEM.subscription(self.node, self._on_problem)
        interfaces.STATUS.subscription(self.node, self._on_status)
        self._discovery = TopicDiscovery(self.node)
        self.node.create_timer(DISCOVERY_PERIOD, self._discover, clock=STEADY_CLOCK)
        self._discover()

    def _serve(self, host: str, port: int) -> None:
        try:
            import foxglove
            from foxglove.websocket import Capability
        except ModuleNotFoundError as error:
            raise StartError(
                f"{error.name} is not installed; the live server needs: pip install 'mobo_tuner[live]'"
            ) from None
        if not self._read_only and not is_local(host):
            raise StartError(
                f"the parameter read_only is false and host is '{host}'; viewers may act on this host's own "
                "addresses alone, such as 127.0.0.1"
            )
        self._context = foxglove.Context()
        services = [] if self._read_only else self._services()
        try:
            self._server = foxglove.start_server(
                name=f"mobo, ROS domain {self.node.context.get_domain_id()}",
                host=host,
                port=port,
                capabilities=[Capability.Parameters, Capability.Services],
                supported_encodings=["cdr"],
                services=services,
                server_listener=_Listener(self),
                context=self._context,
                message_backlog_size=BACKLOG,
            )
        except RuntimeError as error:
            raise StartError(
                f"the live server cannot listen on {host}, port {port}: {error}"
            ) from None
        print(f"live server: {address('ws', host, self._server.port)}", flush=True)

    async def stop(self) -> None:
        """End the server."""
        self._server.stop()

    def close(self) -> None:
        """Release everything."""
        self._server.stop()
        self._client.close()
        self.node.destroy_node()

    # ------------------------------------------------------------------ topics

    def _discover(self) -> None:
        from foxglove import Channel, Schema

        for topic in self._discovery.new_topics():
            schema = Schema(
                name=topic.type_name, encoding="ros2msg", data=topic.definition.text.encode()
            )
            channel = Channel(
                topic.name, schema=schema, message_encoding="cdr", context=self._context
            )
            kept = KeptChannel(channel, self._depth(topic))
            self._channels[topic.name] = kept
            topic.subscribe(self.node, kept.pass_on)

    def _depth(self, topic: FoundTopic) -> int:
        """Return how many messages of a topic late subscribers get."""
        return self._depths.get(topic.name, 1) if topic.is_latched else 0

    def catch_up(self, viewer: int, topic: str) -> None:
        """Send a viewer that subscribes the kept messages of a topic."""
        if topic in self._channels:
            self._channels[topic].catch_up(viewer)

    # ------------------------------------------------------------------ parameters

    def _on_problem(self, message: Any) -> None:
        self._problem = problem_of(message)
        self._server.publish_parameter_values(self.parameters())

    def _on_status(self, message: Any) -> None:
        if message.budget != self._budget:
            self._budget = message.budget
            self._server.publish_parameter_values(self.parameters())

    def parameters(self, names: Sequence[str] = ()) -> list[foxglove.Parameter]:
        """Return the parameters of the tuner that can be changed during a run.

        Args:
            names: Names of those that are wanted; empty for all.
        """
        from foxglove import Parameter

        if self._problem is None:
            return []
        return [
            Parameter(setting.name, value=setting_value(setting.name, setting.value))
            for setting in settings_of(self._problem, self._budget)
            if not names or setting.name in names
        ]

    def set_parameters(self, wanted: Mapping[str, Any]) -> bool:
        """Set parameters of the tuner: all of them, or none, which is told to all viewers."""
        from foxglove import StatusLevel

        if self._read_only:
            refusal = "nothing is changed: this server was started with read_only"
        else:
            try:
                self._client.set(wanted)
                return True
            except TunerError as error:
                refusal = str(error)
        self._server.publish_status(refusal, StatusLevel.Warning)
        return False

    # ------------------------------------------------------------------ services

    def _services(self) -> list[foxglove.Service]:
        """Return the buttons of an operator, as services without arguments."""
        requests = {
            interfaces.PAUSE: self._client.pause,
            interfaces.RESUME: self._client.resume,
            interfaces.STEP: self._client.step,
            interfaces.SKIP: self._client.skip,
            interfaces.STOP_AFTER_THIS: self._client.stop,
        }
        return [
            self._service(self.node.resolve_service_name(service.name), request)
            for service, request in requests.items()
        ]

    def _service(self, name: str, request: Callable[[], str]) -> foxglove.Service:
        from foxglove import MessageSchema, Schema, Service, ServiceSchema

        def part(suffix: str, text: bytes) -> MessageSchema:
            schema = Schema(name=f"std_srvs/srv/Trigger_{suffix}", encoding="ros2msg", data=text)
            return MessageSchema(encoding="cdr", schema=schema)

        schema = ServiceSchema(
            "std_srvs/srv/Trigger",
            request=part("Request", b""),
            response=part("Response", TRIGGER_RESPONSE),
        )
        return Service(name, schema=schema, handler=partial(_answer, request))


class _Listener:
    """Requests of the viewers, on the threads of the library; what is not here, no viewer may do."""

    def __init__(self, server: LiveServer) -> None:
        self._server = server

    def on_subscribe(self, client: Client, channel: ChannelView) -> None:
        """Send what late subscribers get."""
        # The library numbers its clients and their sinks together.
        self._server.catch_up(client.id, channel.topic)

    def on_get_parameters(
        self, _client: Client, names: list[str], *_: object
    ) -> list[foxglove.Parameter]:
        """Return parameters."""
        return self._server.parameters(names)

    def on_set_parameters(
        self, _client: Client, parameters: list[foxglove.Parameter], *_: object
    ) -> list[foxglove.Parameter]:
        """Set parameters; return those that the tuner took, and otherwise the values of now."""
        wanted = {p.name: _number(p.name, p.get_value()) for p in parameters}
        if self._server.set_parameters(wanted):
            return parameters
        return self._server.parameters([*wanted])

    def __getattr__(self, name: str) -> Callable[..., None]:
        if not name.startswith("on_"):
            raise AttributeError(name)
        return _ignore


def _ignore(*_: object) -> None:
    """Take note of nothing."""


def _number(name: str, value: Any) -> Any:
    """Return a value of the type of the parameter; JSON has one type of numbers."""
    is_number = isinstance(value, int | float) and not isinstance(value, bool)
    return setting_value(name, value) if is_number else value


def _answer(request: Callable[[], str], _: foxglove.ServiceRequest) -> bytes:
    """Make a request of the tuner; return its answer, which may be a refusal, serialized."""
    try:
        response = Trigger.Response(success=True, message=request())
    except TunerError as error:
        response = Trigger.Response(success=False, message=str(error))
    return bytes(serialize_message(response))


def main() -> None:
    """Run the node until a signal stops it."""
    exit_process(run_node(LiveServer, PROGRAM))


if __name__ == "__main__":
    main()
