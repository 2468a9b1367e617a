"""Where the machine is left: after a cancel, a stop or an error, a violation, and a tuner that dies."""

from __future__ import annotations

import signal
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from rclpy.node import Node

from mobo_msgs_py import msg
from mobo_msgs_py.action import ApplySetpoint, EvaluateSetpoint, Tune
from mobo_tuner.ros.qos import LATCHED
from tests.support.processes import NodeProcess
from tests.support.tuner import (
    CONFIG,
    GoalClient,
    Listener,
    Services,
    evaluated,
    journal,
    toy_machine,
)

RESULT = EvaluateSetpoint.Result
# Where the simulated injector stands when it is switched on.
BEFORE = {"K1": 475.0, "K2": 230.0, "phi1": -5.0, "phi2": -5.0, "G1": 67.5, "G2": 20.0}


class Position:
    """Where the machine is: a move to nowhere is refused, and says it."""

    def __init__(self, node: Node, spin_until: Callable[..., None]) -> None:
        self._client = GoalClient(node, spin_until, ApplySetpoint, "apply_setpoint")

    def __call__(self) -> dict[str, float]:
        self._client.send(ApplySetpoint.Goal())
        return {item.name: item.value for item in self._client.wait().readbacks}


@pytest.fixture
def position(node: Node, spin_until: Callable[..., None]) -> Position:
    return Position(node, spin_until)


def moving(client: GoalClient, statuses: Listener) -> bool:
    """Whether the machine is on its way to another evaluation than the first."""
    last = statuses.messages[-1] if statuses.messages else msg.TunerStatus()
    return bool(client.feedback) and last.state == last.EVALUATING and last.phase == "ramping"


def test_after_a_cancel_the_machine_goes_back_ramped_and_verified(
    start_tuner: Callable[..., NodeProcess],
    start_machine: Callable[..., NodeProcess],
    client: GoalClient,
    node: Node,
    spin_until: Callable[..., None],
    position: Position,
    tmp_path: Path,
) -> None:
    start_machine("speed:=20.0", "mode:=ideal", config="awa.yaml")
    start_tuner("on_abort:=restore", config="awa.yaml")
    statuses = Listener(node, msg.TunerStatus, "status", LATCHED)
    assert position() == BEFORE
    client.send(Tune.Goal(run_id="canceled", evaluations=50))
    spin_until(lambda: moving(client, statuses), "a move")
    client.cancel()
    spin_until(lambda: statuses.messages[-1].state == msg.TunerStatus.MOVING, "the way back")
    assert position() != BEFORE
    result = client.wait()
    assert result.error_code == Tune.Result.CANCELED
    assert result.error_msg == (
        "the run was stopped: a client canceled it; the machine went to the state before the run"
    )
    assert position() == BEFORE
    assert journal(tmp_path, "canceled")[-1]["error_msg"] == result.error_msg


def test_a_machine_on_its_way_back_is_stopped_by_skip(
    start_tuner: Callable[..., NodeProcess],
    start_machine: Callable[..., NodeProcess],
    client: GoalClient,
    services: Services,
    node: Node,
    spin_until: Callable[..., None],
    position: Position,
) -> None:
    start_machine("speed:=5.0", "mode:=ideal", config="awa.yaml")
    start_tuner("on_abort:=restore", config="awa.yaml")
    statuses = Listener(node, msg.TunerStatus, "status", LATCHED)
    client.send(Tune.Goal(run_id="canceled", evaluations=50))
    spin_until(lambda: moving(client, statuses), "a move", 60.0)
    client.cancel()
    spin_until(lambda: statuses.messages[-1].state == msg.TunerStatus.MOVING, "the way back")
    assert "the state before the run" in statuses.messages[-1].message
    answer = services.trigger("skip")
    assert (answer.success, answer.message) == (True, "the machine stops where it is")
    result = client.wait()
    assert result.error_code == Tune.Result.CANCELED
    assert "the machine was stopped on its way to the state before the run" in result.error_msg
    stopped = position()
    assert stopped != BEFORE
    assert position() == stopped


def test_a_stopped_tuner_leaves_in_time_and_the_machine_goes_back_by_itself(
    start_tuner: Callable[..., NodeProcess],
    start_machine: Callable[..., NodeProcess],
    client: GoalClient,
    node: Node,
    spin_until: Callable[..., None],
    position: Position,
) -> None:
    machine = start_machine("speed:=5.0", "mode:=ideal", config="awa.yaml")
    tuner = start_tuner("on_abort:=restore", "client_timeout:=2.0", config="awa.yaml")
    statuses = Listener(node, msg.TunerStatus, "status", LATCHED)
    assert position() == BEFORE
    client.send(Tune.Goal(evaluations=50))
    spin_until(lambda: moving(client, statuses), "a move", 60.0)
    assert tuner.stop(signal.SIGTERM, timeout=5.0) == 0
    result = client.wait()
    assert result.error_msg == (
        "the run was stopped: the tuner was asked to stop; "
        "the machine is going to the state before the run by itself"
    )
    spin_until(lambda: position() == BEFORE, "the machine to be back", 30.0)
    assert machine.running


@pytest.mark.parametrize("policy", ["restore", "hold"])
def test_when_the_tuner_is_killed_amid_a_move_the_machine_does_what_it_was_told(
    start_tuner: Callable[..., NodeProcess],
    start_machine: Callable[..., NodeProcess],
    client: GoalClient,
    node: Node,
    spin_until: Callable[..., None],
    position: Position,
    policy: str,
) -> None:
    machine = start_machine("speed:=5.0", "mode:=ideal", config="awa.yaml")
    tuner = start_tuner(f"on_client_lost:={policy}", "client_timeout:=2.0", config="awa.yaml")
    statuses = Listener(node, msg.TunerStatus, "status", LATCHED)
    client.send(Tune.Goal(run_id="killed", evaluations=50))
    spin_until(lambda: moving(client, statuses), "a move", 60.0)
    tuner.kill()
    lost = "the heartbeat of run 'killed' stopped for more than 2 s"
    spin_until(lambda: lost in machine.stderr, "the machine to notice")
    if policy == "restore":
        spin_until(lambda: position() == BEFORE, "the machine to be back", 30.0)
    else:
        assert position() == position() != BEFORE


def test_the_best_point_is_the_one_with_the_largest_box(
    start_tuner: Callable[..., NodeProcess],
    start_machine: Callable[..., NodeProcess],
    client: GoalClient,
    spin_until: Callable[..., None],
    position: Position,
) -> None:
    start_machine("speed:=1000.0")
    start_tuner("on_abort:=best")
    client.send(Tune.Goal(evaluations=1000))
    spin_until(lambda: len(client.feedback) >= 8, "some evaluations")
    client.cancel()
    result = client.wait()
    assert result.error_msg.endswith("; the machine went to the best point")
    boxes = {}
    for point in result.pareto_front.points:
        f1, f2 = (objective.value for objective in point.objectives)
        boxes[(4.3 - f1) * (4.3 - f2)] = {item.name: item.value for item in point.setpoint}
    assert position() == pytest.approx(boxes[max(boxes)], abs=1e-9)


def constrained_toy(tmp_path: Path, constraint: str) -> Path:
    text = (CONFIG / "toy.yaml").read_text(encoding="utf-8")
    old = "    # constraints:\n    #   g: {max: 0.5}\n"
    assert old in text
    path = tmp_path / "constrained.yaml"
    path.write_text(text.replace(old, f"    constraints: {{g: {constraint}}}\n"))
    return path


def test_one_violating_shot_ends_the_evaluation_and_pauses_the_run(
    start_tuner: Callable[..., NodeProcess],
    start_machine: Callable[..., NodeProcess],
    client: GoalClient,
    services: Services,
    node: Node,
    spin_until: Callable[..., None],
    position: Position,
    tmp_path: Path,
) -> None:
    start_machine("speed:=1000.0")
    start_tuner(
        "on_violation:=restore",
        "pause_on_violation:=true",
        "initial_evaluations:=6",
        config=constrained_toy(tmp_path, "{max: 0.5, critical: true}"),
    )
    statuses = Listener(node, msg.TunerStatus, "status", LATCHED)
    # A status that was on its way when the run was resumed is no pause.
    resumed_after = 0  # evaluations

    def paused() -> bool:
        if not statuses.messages:
            return False
        status = statuses.messages[-1]
        return status.state == msg.TunerStatus.PAUSED and status.evaluations > resumed_after

    before = position()
    client.send(Tune.Goal(run_id="violating", evaluations=6))
    violations = 0

    def ended() -> bool:
        return client.result is not None and client.result.done()

    while not ended():
        spin_until(lambda: paused() or ended(), "a violation or the end")
        if paused():
            violations += 1
            assert position() == pytest.approx(before)
            resumed_after = statuses.messages[-1].evaluations
            assert services.trigger("resume").success
    assert client.wait().error_code == 0
    records = evaluated(tmp_path, "violating")
    violating = [r for r in records if r["error_code"] == RESULT.VIOLATION]
    assert [r["setpoint"]["x1"] > 0.5 for r in records] == [r in violating for r in records]
    assert len(violating) >= 2
    assert violations >= len(violating) - 1  # the last one may end the run by its budget
    for record in violating:
        assert not record["valid"]
        assert "g = " in record["error_msg"]
        assert "critical limits" in record["error_msg"]


@pytest.mark.parametrize("event", ["on_abort", "on_violation", "on_client_lost"])
def test_a_machine_that_cannot_say_where_it_is_cannot_be_restored(
    start_tuner: Callable[..., NodeProcess], client: GoalClient, node: Node, event: str
) -> None:
    machine = toy_machine(node)
    start_tuner(f"{event}:=restore", "discovery_timeout:=4.0")
    client.send(Tune.Goal(evaluations=5))
    result = client.wait()
    assert result.error_code == Tune.Result.MACHINE_UNAVAILABLE
    assert f"{event} is 'restore', but the state before the run is unknown: " in result.error_msg
    assert machine.goals == []


def test_goals_tell_the_machine_what_to_do_without_the_tuner(
    start_tuner: Callable[..., NodeProcess],
    client: GoalClient,
    node: Node,
) -> None:
    machine = toy_machine(node)
    start_tuner("on_client_lost:=best", "client_timeout:=7.5", "initial_evaluations:=6")
    client.send(Tune.Goal(evaluations=6))
    assert client.wait().error_code == 0
    goals: list[Any] = machine.goals
    assert {goal.client_timeout for goal in goals} == {7.5}
    assert not any(goal.if_violated for goal in goals)
    assert not goals[0].if_client_lost  # there is no front yet
    setpoints = [{item.name: item.value for item in goal.setpoint} for goal in goals]
    best = {item.name: item.value for item in goals[-1].if_client_lost}
    assert best in setpoints[:-1]


def test_no_fallback_leads_across_bounds_that_were_narrowed_meanwhile(
    start_tuner: Callable[..., NodeProcess],
    client: GoalClient,
    services: Services,
    node: Node,
    spin_until: Callable[..., None],
) -> None:
    machine = toy_machine(node)
    machine.position = {"x1": 1.5, "x2": 0.0}
    start_tuner("on_abort:=restore", "on_client_lost:=best", "initial_evaluations:=50")
    client.send(Tune.Goal(evaluations=50))
    spin_until(lambda: len(machine.goals) >= 5, "some evaluations")
    assert services.trigger("pause").success
    assert services.set(variables__x1__max=0.5).successful
    count = len(machine.goals) + 1  # one may have been on its way
    assert services.trigger("step").success
    assert services.trigger("step").success
    spin_until(lambda: len(machine.goals) > count, "an evaluation")
    goal = machine.goals[-1]
    for setpoint in (goal.setpoint, goal.if_client_lost):
        assert {item.name: item.value for item in setpoint}["x1"] <= 0.5
    client.cancel()
    result = client.wait()
    assert "the machine holds: the state before the run is out of bounds" in result.error_msg
    assert machine.position["x1"] <= 0.5


@pytest.mark.parametrize(
    ("policy", "code"),
    [("restore", Tune.Result.INVALID_GOAL), ("restore_anyway", Tune.Result.CANCELED)],
)
def test_a_state_outside_the_bounds_is_restored_on_a_word_only(
    start_tuner: Callable[..., NodeProcess],
    client: GoalClient,
    services: Services,
    node: Node,
    spin_until: Callable[..., None],
    policy: str,
    code: int,
) -> None:
    machine = toy_machine(node)
    machine.position = before = {"x1": 1.5, "x2": 0.0}
    start_tuner(f"on_abort:={policy}")
    assert services.set(variables__x1__max=0.5).successful
    client.send(Tune.Goal(evaluations=1000))
    if policy == "restore_anyway":
        spin_until(lambda: machine.goals, "an evaluation")
        client.cancel()
    result = client.wait()
    assert result.error_code == code
    assert machine.position == before
    if policy == "restore":
        assert machine.goals == []
        assert "set-point x1 is 1.5; -2 to 0.5 is allowed" in result.error_msg
