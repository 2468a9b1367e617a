"""The bridge over real DDS, between our interfaces and a machine that knows none of them."""

from __future__ import annotations

import itertools
import math
import re
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import pytest
import yaml
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rcl_interfaces.msg import Parameter, ParameterType, ParameterValue
from rcl_interfaces.srv import SetParameters
from rclpy.node import Node
from sensor_msgs.msg import JointState

from mobo_msgs_py import msg
from mobo_msgs_py.action import ApplySetpoint, EvaluateSetpoint, Tune
from mobo_msgs_py.srv import DescribeMachine
from mobo_tuner.ros.qos import STREAM
from tests.support.processes import NodeProcess, NodeStarter
from tests.support.tuner import CONFIG, GoalClient, Listener, machine_client, tune_client

RESULT = EvaluateSetpoint.Result
EXAMPLE = Path(__file__).parents[2] / "examples" / "foreign_machine.py"
Spin = Callable[..., None]


def goal(index: int, x1: float, x2: float, **fields: Any) -> EvaluateSetpoint.Goal:
    setpoint = [msg.NamedValue(name="x1", value=x1), msg.NamedValue(name="x2", value=x2)]
    return EvaluateSetpoint.Goal(run_id="run", index=index, setpoint=setpoint, **fields)


def values(named: Any) -> dict[str, float]:
    return {item.name: item.value for item in named}


@dataclass
class Bridged:
    """The foreign machine and the bridge, as processes, and clients of both."""

    node: Node
    spin_until: Spin
    client: GoalClient
    machine: NodeProcess
    restart: Callable[[], NodeProcess]
    bridge: NodeProcess
    commands: list[JointState]
    set_parameters: Any
    index: int = 0

    def fault(self, name: str) -> None:
        """Make the machine misbehave, or behave with "none"."""
        value = ParameterValue(type=ParameterType.PARAMETER_STRING, string_value=name)
        request = SetParameters.Request(parameters=[Parameter(name="fault", value=value)])
        done = self.set_parameters.call_async(request)
        self.spin_until(done.done, f"the fault {name}")
        assert done.result().results[0].successful

    def send(self, x1: float, x2: float, **fields: Any) -> None:
        self.index += 1
        self.client.feedback.clear()
        self.client.send(goal(self.index, x1, x2, **fields))

    def evaluate(self, x1: float, x2: float, **fields: Any) -> EvaluateSetpoint.Result:
        self.send(x1, x2, **fields)
        return self.client.wait()

    def until_ready(self) -> None:
        """Until all of the machine is heard: before that, the bridge says what is missing."""
        deadline = time.monotonic() + 20.0
        while (result := self.evaluate(0.0, 0.0)).error_code != RESULT.NONE:
            assert time.monotonic() < deadline, result.error_msg


@pytest.fixture
def start(
    start_node: NodeStarter, node: Node, spin_until: Spin, tmp_path: Path
) -> Callable[..., Bridged]:
    def begin(
        change: Callable[[dict[str, Any]], None] = lambda _: None, *, ready: bool = True
    ) -> Bridged:
        mapping = yaml.safe_load((CONFIG / "bridge_foreign.yaml").read_text(encoding="utf-8"))
        change(mapping)
        file = tmp_path / "mapping.yaml"
        file.write_text(yaml.safe_dump(mapping), encoding="utf-8")
        machine = start_node(str(EXAMPLE))
        options = ("--ros-args", "-p", f"mapping:={file}")
        bridge = start_node("-m", "mobo_tuner.nodes.machine_bridge", *options)
        set_parameters = node.create_client(SetParameters, "/foreign_machine/set_parameters")
        commands: list[JointState] = []
        node.create_subscription(JointState, "supplies/command", commands.append, 100)
        spin_until(set_parameters.service_is_ready, "the foreign machine")
        client = machine_client(node, spin_until)
        bridged = Bridged(
            node,
            spin_until,
            client,
            machine,
            lambda: start_node(str(EXAMPLE)),
            bridge,
            commands,
            set_parameters,
        )
        if ready:
            bridged.until_ready()
        commands.clear()
        return bridged

    return begin


def slow(mapping: dict[str, Any], slew: float = 0.5) -> None:
    """Ramps that last for seconds."""
    for variable in mapping["variables"].values():
        variable["slew"] = slew


def test_it_moves_in_small_steps_and_measures(start: Callable[..., Bridged]) -> None:
    machine = start()
    result = machine.evaluate(1.5, -0.5, shots=3)
    assert (result.error_code, result.error_msg, result.shots) == (RESULT.NONE, "", 3)
    assert values(result.readbacks) == pytest.approx({"x1": 1.5, "x2": -0.5}, abs=0.01)
    expected = {"f1": math.hypot(0.5, 1.5), "f2": math.hypot(2.5, 0.5)}
    assert values(result.diagnostics) == pytest.approx(expected, abs=0.02)
    assert [list(c.name) for c in machine.commands] == [["Q1", "Q2"]] * len(machine.commands)
    # 4 units/s at 20 Hz: steps of 0.2, that is 200 mA; all on a straight line.
    positions = [(0.0, 0.0), *(tuple(c.position) for c in machine.commands)]
    assert len(positions) == 9
    for (q1, q2), (p1, p2) in zip(positions[1:], positions, strict=False):
        assert q1 - p1 == pytest.approx(1500.0 / 8, abs=2.0)
        assert q2 - p2 == pytest.approx(-500.0 / 8, abs=2.0)
    assert positions[-1] == pytest.approx((1500.0, -500.0))
    stamps = [c.header.stamp.sec + 1e-9 * c.header.stamp.nanosec for c in machine.commands]
    gaps = [after - before for before, after in itertools.pairwise(stamps)]
    assert min(gaps) > 0.04
    assert {f.phase for f in machine.client.feedback} == {"ramping", "settling", "measuring"}


def impatient(mapping: dict[str, Any]) -> None:
    """Short waits for what never comes."""
    mapping["move"]["timeout"] = 1.0
    for diagnostic in mapping["diagnostics"].values():
        diagnostic["read"]["timeout"] = 0.5


SUPPLIES, CAMERA = "the topic 'supplies/state'", "the service 'camera/look'"
# How an evaluation ends that begins when a fault is there, what it says, and whether anything moved.
FAULTS = {
    "offset": (RESULT.INTERLOCK, "x1 reads 0.5, but was set to 0", False),
    "nan": (RESULT.MACHINE_LOST, "(it is nan)", False),
    "frozen": (RESULT.MACHINE_LOST, "(its stamp does not advance)", False),
    "late": (RESULT.MACHINE_LOST, "(its stamp is 5.", False),
    "silent": (RESULT.MACHINE_LOST, f"x1 is not known: {SUPPLIES} gave no value for", False),
    "no_permit": (RESULT.INTERLOCK, "interlock permit forbids to move", False),
    "doubled": (RESULT.NONE, "", True),
    "deaf": (RESULT.TIMEOUT, "x1 reads 0, which is not within 0.01 of its set-point 0.02", True),
    "unlit": (RESULT.INVALID_MEASUREMENT, f"{CAMERA} gave no number (it is nan)", True),
    "jammed": (RESULT.INVALID_MEASUREMENT, "failed: the shutter is jammed", True),
    "slow": (RESULT.TIMEOUT, f"f1: {CAMERA} did not answer within 0.5 s", True),
}
UNSEEN_AT_REST = ("doubled", "deaf")


def test_every_fault_at_rest_ends_as_documented(start: Callable[..., Bridged]) -> None:
    machine = start(impatient)
    health = Listener(machine.node, DiagnosticArray, "/diagnostics", STREAM)

    def faults() -> list[str]:
        """What the latest message on /diagnostics complains about."""
        latest = health.messages[-1].status if health.messages else []
        return [s.message for s in latest if s.level != DiagnosticStatus.OK]

    for fault, (code, sentence, moves) in FAULTS.items():
        machine.fault(fault)
        deadline = time.monotonic() + 10.0
        while fault not in UNSEEN_AT_REST and machine.evaluate(0.0, 0.0).error_code == RESULT.NONE:
            assert time.monotonic() < deadline, fault  # until the bridge sees it
        machine.commands.clear()
        result = machine.evaluate(0.02, 0.0)
        assert (fault, result.error_code) == (fault, code), result.error_msg
        assert sentence in result.error_msg
        assert bool(machine.commands) == moves, fault
        seen = {d.name for d in result.diagnostics}
        assert seen == ({"f1", "f2"} if fault in ("unlit", "doubled") else set()), fault
        assert all(math.isnan(d.value) == (fault == "unlit") for d in result.diagnostics)
        # Refused, the goal has no readbacks: nobody asked the machine for any.
        assert {r.name for r in result.readbacks} == ({"x1", "x2"} if moves else set())
        told = sentence.partition(" gave no value for")[0]
        if told:
            machine.spin_until(
                lambda: any(told in text for text in faults()),  # noqa: B023
                f"{fault} on /diagnostics: {faults()}",
            )
        machine.fault("none")
        machine.until_ready()
        machine.spin_until(lambda: health.messages and not faults(), f"the end of {fault}")
    parts = {s.name.partition(": ")[2] for s in health.messages[-1].status}
    assert parts == {"machine", "variables", "interlocks", "connections"}
    assert "Traceback" not in machine.bridge.stderr


def test_the_manual_says_how_every_fault_ends() -> None:
    manual = (EXAMPLE.parents[1] / "docs" / "bridge.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| `(\w+)` \|.*\| (`\w+`|none) \|$", manual, flags=re.MULTILINE)
    documented = {fault: ending.strip("`") for fault, ending in rows}
    endings = ("INTERLOCK", "MACHINE_LOST", "TIMEOUT", "INVALID_MEASUREMENT")
    names = {getattr(RESULT, name): name for name in endings} | {RESULT.NONE: "none"}
    assert documented == {fault: names[code] for fault, (code, _, _) in FAULTS.items()}


def test_a_machine_that_dies_is_lost_and_taken_up_again(start: Callable[..., Bridged]) -> None:
    machine = start()
    machine.send(0.0, 0.0, shots=100)
    machine.spin_until(
        lambda: any(f.phase == "measuring" for f in machine.client.feedback), "the measurement"
    )
    machine.machine.kill()
    result = machine.client.wait()
    assert result.error_code in (RESULT.MACHINE_LOST, RESULT.INTERLOCK, RESULT.TIMEOUT)
    assert "gave no value for" in result.error_msg or "did not answer" in result.error_msg
    machine.commands.clear()
    gone = machine.evaluate(0.5, 0.0)
    assert gone.error_code in (RESULT.MACHINE_LOST, RESULT.INTERLOCK)
    assert machine.commands == []
    machine.restart()
    machine.until_ready()
    assert machine.evaluate(0.5, 0.0).error_code == RESULT.NONE


def test_what_is_not_there_is_said_before_anything_moves(start: Callable[..., Bridged]) -> None:
    def elsewhere(mapping: dict[str, Any]) -> None:
        mapping["diagnostics"]["f2"]["read"]["service"] = "camera/nowhere"

    machine = start(elsewhere, ready=False)
    deadline = time.monotonic() + 20.0
    while "camera/nowhere" not in (result := machine.evaluate(0.5, 0.0)).error_msg:
        assert time.monotonic() < deadline, result.error_msg
    assert result.error_code == RESULT.MACHINE_LOST
    assert result.error_msg == "the service 'camera/nowhere' is not there"
    assert machine.commands == []


@pytest.mark.parametrize(
    ("fault", "code", "sentence"),
    [
        ("no_permit", RESULT.INTERLOCK, "interlock permit forbids to move"),
        ("silent", RESULT.MACHINE_LOST, "the readback of x1 is not known"),
        ("offset", RESULT.TIMEOUT, "x1 reads 1.5, which is not within 0.01 of its set-point 1"),
    ],
)
def test_a_fault_amid_a_move_ends_it(
    start: Callable[..., Bridged], fault: str, code: int, sentence: str
) -> None:
    machine = start(slow)  # two seconds to go
    machine.send(1.0, 0.0)
    machine.spin_until(lambda: len(machine.commands) > 5, "the ramp to begin")
    machine.fault(fault)
    asked = time.monotonic()
    result = machine.client.wait()
    assert (result.error_code, sentence in result.error_msg) == (code, True), result.error_msg
    if fault == "no_permit":
        assert time.monotonic() - asked < 1.0
    # Nothing jumps, whatever happens: neither on the ramp nor when it is held.
    positions = [0.0, *(c.position[0] for c in machine.commands)]
    largest = max(abs(b - a) for a, b in itertools.pairwise(positions))
    assert largest <= 250.0
    if fault != "offset":
        assert positions[-1] < 990.0
        others = [values(feedback.readbacks)["x2"] for feedback in machine.client.feedback]
        known = [value for value in others if math.isfinite(value)]  # silent, neither is, soon
        assert known[-1] == pytest.approx(0.0, abs=0.01)


def test_a_cancel_holds_the_ramp_where_it_is(start: Callable[..., Bridged]) -> None:
    machine = start(partial(slow, slew=0.05))  # twenty seconds to go
    machine.send(1.0, -1.0)
    machine.spin_until(lambda: len(machine.commands) > 10, "the ramp to begin")
    machine.client.cancel()
    result = machine.client.wait()
    assert result.error_code == RESULT.CANCELED
    where = values(result.readbacks)
    assert 0.02 < where["x1"] < 0.9
    assert where["x2"] == pytest.approx(-where["x1"], abs=0.02)
    # Judged by where it is sent, because commands that are on their way are heard late.
    over = time.monotonic() + 1.5
    machine.spin_until(
        lambda: time.monotonic() > over, "time"
    )  # a ramp that goes on is 0.075 farther
    for name, sent in zip(("x1", "x2"), machine.commands[-1].position, strict=True):
        assert 1e-3 * sent == pytest.approx(where[name], abs=0.03)
    # The next move goes on from there.
    assert machine.evaluate(where["x1"] + 0.05, where["x2"]).error_code == RESULT.NONE


def test_the_bridge_serves_what_every_machine_serves(
    start: Callable[..., Bridged], node: Node, spin_until: Spin
) -> None:
    machine = start()
    describe = node.create_client(DescribeMachine, "describe_machine")
    spin_until(describe.service_is_ready, "the description")
    answer = describe.call_async(DescribeMachine.Request())
    spin_until(answer.done, "the description")
    limits = [(v.name, v.min, v.max) for v in answer.result().variables]
    assert limits == [("x1", -2.0, 2.0), ("x2", -2.0, 2.0)]
    assert [d.name for d in answer.result().diagnostics] == ["f1", "f2"]

    assert machine.evaluate(2.1, 0.0).error_code == RESULT.INVALID_SETPOINT
    assert machine.commands == []
    back = goal(0, -0.2, 0.0).setpoint
    critical = [msg.Constraint(name="f1", min=-math.inf, max=1.0)]
    result = machine.evaluate(0.2, 0.0, shots=50, critical=critical, if_violated=back)
    assert (result.error_code, result.shots <= 1) == (RESULT.VIOLATION, True)
    mover = GoalClient(node, spin_until, ApplySetpoint, "apply_setpoint")
    mover.send(ApplySetpoint.Goal())
    assert values(mover.wait().readbacks)["x1"] == pytest.approx(-0.2, abs=0.01)

    result = machine.evaluate(0.2, 0.0, shots=50, client_timeout=0.5, if_client_lost=back)
    assert result.error_code == RESULT.CLIENT_LOST
    mover.send(ApplySetpoint.Goal(setpoint=goal(0, 0.0, 0.1).setpoint))
    arrived = mover.wait()
    assert arrived.error_code == ApplySetpoint.Result.NONE
    assert values(arrived.readbacks) == pytest.approx({"x1": 0.0, "x2": 0.1}, abs=0.01)
    assert machine.bridge.stop() == 0


def test_the_tuner_tunes_a_machine_that_knows_none_of_its_types(
    start: Callable[..., Bridged],
    start_node: NodeStarter,
    node: Node,
    spin_until: Spin,
    tmp_path: Path,
) -> None:
    start()
    config = ("--ros-args", "--params-file", str(CONFIG / "toy.yaml"))
    start_node("-m", "mobo_tuner.nodes.tuner", *config, "-p", f"runs_dir:={tmp_path}")
    client = tune_client(node, spin_until)
    client.send(Tune.Goal(evaluations=6))
    result = client.wait(60.0)
    assert (result.stop_reason, result.evaluations) == ("budget", 6)
    assert result.pareto_front.hypervolume > 0.0
    for feedback in client.feedback:
        x, f = values(feedback.evaluation.setpoint), values(feedback.evaluation.objectives)
        assert f["f1"] == pytest.approx(math.hypot(x["x1"] - 1.0, x["x2"] - 1.0), abs=0.02)
