"""The live server, read by a client of its protocol that shares no code with it."""

from __future__ import annotations

import contextlib
import json
import re
import struct
import time
from collections.abc import Callable, Iterator
from typing import Any

import pytest
from mcap.records import Schema
from mcap_ros2.decoder import DecoderFactory
from websockets import Subprotocol
from websockets.sync.client import ClientConnection, connect

from mobo_tuner.client import TunerClient
from robustness.processes import NodeProcess, NodeStarter
from tests.support.processes import TIMEOUT, wait_until

PROTOCOL = "foxglove.sdk.v1"
MESSAGE, SERVICE_ANSWER = 1, 3
EMPTY = b"\x00\x01\x00\x00"  # serialized; its header alone


class Viewer:
    """A viewer that subscribes to all topics, and decodes what comes by the definitions that come with it."""

    def __init__(self, socket: ClientConnection) -> None:
        self._socket = socket
        self._decoders: dict[int, tuple[str, Callable[[bytes], Any]]] = {}
        self._factory = DecoderFactory()
        self.services: dict[str, dict[str, Any]] = {}
        self.messages: dict[str, list[Any]] = {}
        self.parameters: dict[str, Any] = {}
        self.sentences: list[str] = []
        self.answers: list[bytes] = []

    def until(self, condition: Callable[[], object], what: str) -> None:
        """Receive until a condition holds."""
        deadline = time.monotonic() + TIMEOUT
        while not condition():
            if time.monotonic() > deadline:
                pytest.fail(f"waited {TIMEOUT:g} s in vain for {what}")
            try:
                self._take(self._socket.recv(timeout=0.1))
            except TimeoutError:
                continue

    def send(self, **message: Any) -> None:
        self._socket.send(json.dumps(message))

    def call(self, name: str) -> tuple[bool, str]:
        """Answer of a service without arguments."""
        service, before = self.services[name], len(self.answers)
        assert service["type"] == "std_srvs/srv/Trigger"
        self._socket.send(struct.pack("<BIII3s", 2, service["id"], 7, 3, b"cdr") + EMPTY)
        self.until(lambda: len(self.answers) > before, f"the answer of {name}")
        response = service["response"]
        assert (response["encoding"], response["schemaEncoding"]) == ("cdr", "ros2msg")
        schema = Schema(id=0, name="a/msg/B", encoding="ros2msg", data=response["schema"].encode())
        decode = self._factory.decoder_for("cdr", schema)
        assert decode
        answer = decode(self.answers[-1])
        return answer.success, answer.message

    def _take(self, data: str | bytes) -> None:
        if isinstance(data, bytes):
            if data[0] == MESSAGE:
                number, _ = struct.unpack_from("<IQ", data, 1)
                topic, decode = self._decoders[number]
                self.messages.setdefault(topic, []).append(decode(data[13:]))
            elif data[0] == SERVICE_ANSWER:
                _, _, length = struct.unpack_from("<III", data, 1)
                self.answers.append(data[13 + length :])
            return
        message = json.loads(data)
        if message["op"] == "advertise":
            self._subscribe(message["channels"])
        elif message["op"] == "advertiseServices":
            self.services |= {service["name"]: service for service in message["services"]}
        elif message["op"] == "parameterValues":
            self.parameters |= {p["name"]: p["value"] for p in message["parameters"]}
        elif message["op"] == "status":
            self.sentences.append(message["message"])

    def _subscribe(self, channels: list[dict[str, Any]]) -> None:
        for channel in channels:
            assert (channel["encoding"], channel["schemaEncoding"]) == ("cdr", "ros2msg")
            text = channel["schema"].encode()
            schema = Schema(
                id=channel["id"], name=channel["schemaName"], encoding="ros2msg", data=text
            )
            decode = self._factory.decoder_for("cdr", schema)
            assert decode
            self._decoders[channel["id"]] = channel["topic"], decode
        wanted = [{"id": c["id"], "channelId": c["id"]} for c in channels]
        self.send(op="subscribe", subscriptions=wanted)

    def evaluations(self) -> list[int]:
        return [e.index for e in self.messages.get("/evaluation", ())]


def address_of(process: NodeProcess) -> str:
    wait_until(lambda: "live server: " in process.stdout or not process.running, "the address")
    found = re.search(r"^live server: (ws://\S+)$", process.stdout, flags=re.MULTILINE)
    assert found, process.stderr
    return found[1]


@pytest.fixture
def view() -> Iterator[Callable[[str], Viewer]]:
    with contextlib.ExitStack() as sockets:

        def open_viewer(address: str) -> Viewer:
            connection = connect(
                address,
                subprotocols=[Subprotocol(PROTOCOL)],
                max_size=None,
                max_queue=None,
                close_timeout=1.0,
            )
            return Viewer(sockets.enter_context(connection))

        yield open_viewer


def test_viewers_see_the_run_and_only_look_unless_they_may_steer(
    start_node: NodeStarter,
    start_tuner: Callable[..., NodeProcess],
    start_machine: Callable[..., NodeProcess],
    view: Callable[[str], Viewer],
    ros_domain: int,
) -> None:
    module = ("-m", "mobo_tuner.nodes.live_server", "--ros-args", "-p", "port:=0")
    steering = start_node(*module, "-p", "read_only:=false")
    looking = start_node(*module)
    assert address_of(steering) != address_of(looking)  # both listen before anything is published
    start_machine()
    start_tuner("initial_evaluations:=5")
    with TunerClient(domain_id=ros_domain, timeout=TIMEOUT) as client:
        client.tune(evaluations=5, run_id="seen")
    first = view(address_of(steering))
    first.until(lambda: len(first.evaluations()) >= 5, "the whole run")
    second = view(address_of(steering))
    second.until(lambda: len(second.evaluations()) >= 5, "the whole run, for a second viewer")
    assert first.evaluations() == second.evaluations() == [0, 1, 2, 3, 4]
    first.until(lambda: "/problem" in first.messages, "the problem")
    first.until(lambda: any(f.points for f in first.messages.get("/pareto_front", ())), "the front")
    problem, front = first.messages["/problem"][0], first.messages["/pareto_front"][-1]
    assert [v.name for v in problem.variables] == ["x1", "x2"]
    assert front.run_id == "seen"
    assert {o.name for o in front.points[0].objectives} == {"f1", "f2"}
    first.until(
        lambda: "/diagnostics" in first.messages, "what machine and tuner say of themselves"
    )

    agreed, sentence = first.call("/pause")
    assert not agreed
    assert "needs an active run" in sentence
    first.send(op="getParameters", parameterNames=["variables.x1.max"], id="1")
    first.until(lambda: first.parameters.get("variables.x1.max") == 2.0, "the bound")
    wanted = [{"name": "variables.x1.max", "value": 1.5, "type": "float64"}]
    first.send(op="setParameters", parameters=wanted, id="2")
    first.until(lambda: first.parameters["variables.x1.max"] == 1.5, "the new bound")
    first.send(op="setParameters", parameters=[{"name": "variables.x1.max", "value": -7}], id="3")
    first.until(lambda: first.sentences, "the refusal")
    assert "x1" in first.sentences[0]

    third = view(address_of(looking))
    third.until(lambda: len(third.evaluations()) >= 5, "the whole run")
    assert third.services == {}
    third.send(op="setParameters", parameters=wanted, id="4")
    third.until(lambda: third.sentences, "the refusal")
    assert "read_only" in third.sentences[0]
    for process in (steering, looking):
        assert process.stop() == 0


@pytest.mark.usefixtures("ros_domain")
def test_nobody_steers_from_another_host(start_node: NodeStarter) -> None:
    given = ("-p", "host:=0.0.0.0", "-p", "port:=0", "-p", "read_only:=false")
    process = start_node("-m", "mobo_tuner.nodes.live_server", "--ros-args", *given)
    assert process.wait() == 2
    assert "read_only is false and host is '0.0.0.0'" in process.stderr
