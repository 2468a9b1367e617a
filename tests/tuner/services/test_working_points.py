"""Working points: the front as a list, measured and predicted, and the way to one of its points."""

from __future__ import annotations

import math
import shutil
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from rclpy.node import Node

from mobo_msgs_py import msg
from mobo_msgs_py.action import ApplySetpoint, EvaluateSetpoint, GoToWorkingPoint, Tune
from mobo_msgs_py.srv import ListWorkingPoints
from mobo_tuner.machine.double import Answer, MachineDouble
from mobo_tuner.ros.qos import LATCHED, STREAM
from mobo_tuner.runs.history import History
from mobo_tuner.runs.replay import compare
from tests.support.processes import NodeProcess
from tests.support.tuner import (
    EASY,
    GoalClient,
    Listener,
    Services,
    journal,
    toy_machine,
    toy_values,
    tune_client,
)

Goal = GoToWorkingPoint.Goal
CODES = GoToWorkingPoint.Result
VIOLATING: list[dict[str, float]] = []  # set-points that violate a critical limit


@pytest.fixture
def mover(node: Node, spin_until: Callable[..., None]) -> GoalClient:
    return GoalClient(node, spin_until, GoToWorkingPoint, "go_to_working_point")


def values(named: Any) -> dict[str, float]:
    return {item.name: item.value for item in named}


def plain(point: Any) -> tuple[int, dict[str, float], dict[str, float]]:
    """A point of a front; messages with NaN in them equal nothing."""
    return point.index, values(point.setpoint), values(point.objectives)


def weighted(point: Any, weights: dict[str, float]) -> float:
    objectives = values(point.objectives)
    return sum(weights[name] * objectives[name] for name in weights)


def named(weights: dict[str, float]) -> list[msg.NamedValue]:
    return [msg.NamedValue(name=name, value=value) for name, value in weights.items()]


def listed(services: Services, predict: bool) -> ListWorkingPoints.Response:
    request = ListWorkingPoints.Request(predict=predict)
    return services.call(ListWorkingPoints, "list_working_points", request, 60.0)


def position(node: Node, spin_until: Callable[..., None]) -> dict[str, float]:
    client = GoalClient(node, spin_until, ApplySetpoint, "apply_setpoint")
    client.send(ApplySetpoint.Goal())
    return values(client.wait().readbacks)


def on_its_way(mover: GoalClient, start: dict[str, float]) -> bool:
    """Whether K1 has left where it was."""
    readbacks = values(mover.feedback[-1].readbacks) if mover.feedback else {}
    return abs(readbacks.get("K1", start["K1"]) - start["K1"]) > 1.0


def test_the_front_is_listed_gone_to_and_held(
    start_tuner: Callable[..., NodeProcess],
    start_machine: Callable[..., NodeProcess],
    client: GoalClient,
    mover: GoalClient,
    services: Services,
    node: Node,
    spin_until: Callable[..., None],
    tmp_path: Path,
) -> None:
    start_machine()
    tuner = start_tuner("initial_evaluations:=6")
    nothing = "no run has begun here, so that there is no front; name an earlier run (--run ID)"
    assert listed(services, False).message == nothing
    mover.send(Goal(choice=Goal.BY_INDEX, index=0))
    refused = mover.wait()
    assert (refused.error_code, refused.error_msg) == (CODES.INVALID_GOAL, nothing)

    client.send(Tune.Goal(run_id="front", evaluations=20))
    front = client.wait().pareto_front
    points = listed(services, True)
    assert points.success, points.message
    assert list(map(plain, points.measured.points)) == list(map(plain, front.points))
    assert points.measured.run_id == points.predicted.run_id == "front"
    assert points.predicted.hypervolume > front.hypervolume
    assert len(points.predicted.points) > 50
    for point in points.predicted.points:
        x, f = values(point.setpoint), values(point.objectives)
        assert f["f1"] == pytest.approx(math.hypot(x["x1"] - 1, x["x2"] - 1), abs=0.2)
        assert f["f2"] == pytest.approx(math.hypot(x["x1"] + 1, x["x2"] + 1), abs=0.2)
        assert all(item.stddev > 0.0 for item in point.objectives)

    weights = {"f1": 1.0, "f2": 2.5}
    best = min(front.points, key=lambda point: weighted(point, weights))
    mover.send(Goal(choice=Goal.BY_WEIGHTS, weights=named(weights)))
    result = mover.wait()
    assert (result.error_code, result.error_msg) == (CODES.NONE, "")
    assert (plain(result.point), result.evaluations) == (plain(best), 0)
    assert position(node, spin_until) == pytest.approx(values(best.setpoint), abs=1e-9)
    assert values(result.readbacks) == pytest.approx(values(best.setpoint), abs=1e-9)

    evaluations = Listener(node, msg.Evaluation, "evaluation", STREAM)
    spin_until(lambda: node.get_publishers_info_by_topic("/evaluation"), "the tuner's topic")
    chosen = front.points[0]
    mover.send(Goal(choice=Goal.BY_INDEX, index=chosen.index, hold_evaluations=5, radius=0.05))
    result = mover.wait()
    assert (result.error_code, result.evaluations) == (CODES.NONE, 5)
    assert plain(result.point) == plain(chosen)
    assert [f.evaluations for f in mover.feedback if f.phase == "measuring"][-5:] == [1, 2, 3, 4, 5]
    # The run that holds begins with the evaluations of the first one, so that it is whole by itself.
    spin_until(lambda: len(evaluations.messages) == 25, "the evaluations")
    told = evaluations.messages[20:]
    assert len({m.run_id for m in evaluations.messages}) == 1
    assert [m.index for m in told] == [20, 21, 22, 23, 24]
    assert told[0].source == msg.Evaluation.OPERATOR
    assert values(told[0].setpoint) == values(chosen.setpoint)
    for message in told:
        for name, value in values(message.setpoint).items():
            assert abs(value - values(chosen.setpoint)[name]) <= 0.05 * 4.0 + 1e-9
    held = {name: 1.0 / (4.3 - value) for name, value in values(chosen.objectives).items()}
    best = min(told, key=lambda point: weighted(point, held))
    assert position(node, spin_until) == pytest.approx(values(best.setpoint), abs=1e-9)
    records = journal(tmp_path, told[0].run_id)
    kinds = [r["type"] for r in records]
    assert kinds == ["start", *["evaluation"] * 20, "state", *["evaluation"] * 5, "end"]
    history = History.from_records(records)
    assert len(history.evaluations) == 25
    assert not any(comparison.differs for comparison in compare(history))
    # What was measured while holding is in the first run, too, and on the list.
    records = journal(tmp_path, "front")
    moves = [["move", "state"] * 2, ["move", "state"]]
    kinds = [
        "start",
        "state",
        *["evaluation"] * 20,
        "end",
        *moves[0],
        *["evaluation"] * 5,
        *moves[1],
    ]
    assert [r["type"] for r in records] == kinds
    added = [r for r in records if r["type"] == "evaluation"][20:]
    assert [(r["index"], r["source"]) for r in added] == [(n, "operator") for n in range(20, 25)]
    assert [r["setpoint"] for r in added] == [values(m.setpoint) for m in told]
    assert added[-1]["hypervolume"] >= front.hypervolume
    now = listed(services, False).measured
    assert {point.index for point in now.points} & {20, 21, 22, 23, 24}

    # A tuner that knows nothing yet reads the run from its folder; all of it is there after a kill.
    tuner.kill()
    start_tuner("initial_evaluations:=6")
    request = ListWorkingPoints.Request(run_id="front")
    read = services.call(ListWorkingPoints, "list_working_points", request, 60.0)
    assert list(map(plain, read.measured.points)) == list(map(plain, now.points))
    assert read.measured.hypervolume == now.hypervolume
    mover.send(Goal(run_id="front", choice=Goal.BY_WEIGHTS, weights=named({"f2": 1.0})))
    least = min(now.points, key=lambda point: values(point.objectives)["f2"])
    assert plain(mover.wait().point) == plain(least)
    assert position(node, spin_until) == pytest.approx(values(least.setpoint), abs=1e-9)
    assert [r["type"] for r in journal(tmp_path, "front")][-3:] == ["state", "move", "state"]


def test_goals_that_cannot_be_served_and_a_cancel_on_the_way(
    start_tuner: Callable[..., NodeProcess],
    start_machine: Callable[..., NodeProcess],
    client: GoalClient,
    mover: GoalClient,
    services: Services,
    node: Node,
    spin_until: Callable[..., None],
    tmp_path: Path,
) -> None:
    config = tmp_path / "easy.yaml"
    config.write_text(EASY)
    machine = start_machine("speed:=20.0", "mode:=ideal", config="awa.yaml")
    start_tuner("machine_timeout:=1.0", "discovery_timeout:=10.0", config=config)
    statuses = Listener(node, msg.TunerStatus, "status", LATCHED)
    client.send(Tune.Goal(run_id="short", evaluations=50))
    spin_until(
        lambda: client.feedback and client.feedback[-1].evaluation.hypervolume > 0.0,
        "a point of the front",
        60.0,
    )
    assert listed(services, False).measured.points  # also while a run goes on
    mover.send(Goal(choice=Goal.BY_INDEX))
    assert "run 'short' is active" in mover.wait().error_msg
    client.cancel()
    [*_, point] = client.wait().pareto_front.points

    # Another folder's run, which is whole but none of this tuner's.
    shutil.copytree(tmp_path / "runs" / "short", tmp_path / "elsewhere" / "linked")
    (tmp_path / "runs" / "linked").symlink_to(tmp_path / "elsewhere" / "linked")
    some = dict.fromkeys(values(point.objectives), 1.0)
    for goal, sentence in (
        (
            Goal(choice=Goal.BY_INDEX, index=999),
            "index is 999, of an evaluation of run 'short'; 0 to",
        ),
        (Goal(choice=7), "choice is 7; BY_INDEX, BY_WEIGHTS and BEFORE_RUN are allowed"),
        (Goal(choice=Goal.BY_INDEX, index=point.index, radius=-1.0), "radius is -1"),
        (Goal(choice=Goal.BY_INDEX, index=point.index, radius=math.nan), "radius is nan"),
        (Goal(index=point.index, hold_evaluations=3, radius=1e-9), "radius is 1e-09"),
        (Goal(choice=Goal.BY_INDEX, hold_evaluations=10**9), "hold_evaluations is 1000000000"),
        (Goal(choice=Goal.BY_WEIGHTS), "weights are "),
        (Goal(choice=Goal.BY_WEIGHTS, weights=named({"f9": 1.0})), "'f9': 1.0"),
        (Goal(run_id="none", index=0), "none"),
        (Goal(run_id="../x", index=0), "../x"),
        (Goal(run_id="linked", index=0), "the run 'linked' is a link out of "),
        (Goal(choice=Goal.BY_WEIGHTS, weights=named(some) * 2), "the list of weights names "),
        (Goal(choice=Goal.BY_WEIGHTS, weights=named(some | {"dE": -1.0})), "weights are "),
    ):
        mover.send(goal)
        result = mover.wait()
        assert result.error_code == CODES.INVALID_GOAL
        assert sentence in result.error_msg

    # Away from the point and back again, in the middle of which it is stopped.
    away = GoalClient(node, spin_until, ApplySetpoint, "apply_setpoint")
    k1 = values(point.setpoint)["K1"]
    far = values(point.setpoint) | {"K1": 400.0 if k1 > 475.0 else 550.0}
    away.send(ApplySetpoint.Goal(setpoint=named(far)))
    assert away.wait().error_code == ApplySetpoint.Result.NONE
    mover.feedback.clear()
    mover.send(Goal(choice=Goal.BY_INDEX, index=point.index))
    spin_until(lambda: on_its_way(mover, far), "a move")
    assert statuses.messages[-1].state == msg.TunerStatus.MOVING
    busy = tune_client(node, spin_until)
    busy.send(Tune.Goal(evaluations=5))
    assert "the machine is moving to a working point" in busy.wait().error_msg
    mover.cancel()
    started = time.monotonic()
    result = mover.wait()
    assert time.monotonic() - started < 2.0  # one, and one more for a busy computer
    assert result.error_code == CODES.CANCELED
    assert result.error_msg == "it was stopped: a client canceled it"
    where = values(result.readbacks)["K1"]
    assert min(k1, far["K1"]) < where < max(k1, far["K1"])

    mover.send(Goal(choice=Goal.BY_INDEX, index=point.index, hold_evaluations=3))
    spin_until(lambda: "-hold-" in statuses.messages[-1].run_id, "the holding", 60.0)
    assert mover.result is not None
    assert not mover.result.done()
    mover.cancel()
    assert mover.wait().error_code == CODES.CANCELED
    spin_until(lambda: statuses.messages[-1].state == msg.TunerStatus.IDLE, "an idle tuner")

    machine.kill()
    mover.send(Goal(choice=Goal.BY_INDEX, index=point.index))
    result = mover.wait()
    assert result.error_code in (CODES.MACHINE_UNAVAILABLE, CODES.MACHINE_LOST)
    client.send(Tune.Goal(evaluations=5))  # the tuner is free again
    assert client.wait().error_code == Tune.Result.MACHINE_UNAVAILABLE


def test_a_tuner_that_is_killed_on_the_way_leaves_the_machine_at_the_working_point(
    start_tuner: Callable[..., NodeProcess],
    start_machine: Callable[..., NodeProcess],
    client: GoalClient,
    mover: GoalClient,
    node: Node,
    spin_until: Callable[..., None],
    tmp_path: Path,
) -> None:
    config = tmp_path / "easy.yaml"
    config.write_text(EASY)
    start_machine("speed:=20.0", "mode:=ideal", config="awa.yaml")
    settings = ("client_timeout:=1.0", "on_client_lost:=hold", "initial_evaluations:=2")
    tuner = start_tuner(*settings, config=config)
    client.send(Tune.Goal(run_id="short", evaluations=2))
    [*_, point] = client.wait(60.0).pareto_front.points
    goal = values(point.setpoint)
    far = goal | {"K1": 400.0 if goal["K1"] > 475.0 else 550.0}
    away = GoalClient(node, spin_until, ApplySetpoint, "apply_setpoint")
    away.send(ApplySetpoint.Goal(setpoint=named(far)))
    assert away.wait().error_code == ApplySetpoint.Result.NONE
    mover.send(Goal(choice=Goal.BY_INDEX, index=point.index))
    spin_until(lambda: on_its_way(mover, far), "a move")
    tuner.kill()
    on_the_way = position(node, spin_until)
    assert on_the_way != pytest.approx(goal, abs=0.1)
    spin_until(lambda: position(node, spin_until) == pytest.approx(goal, abs=1e-6), "the arrival")

    # The machine is free again, also for the tuner that comes after.
    start_tuner(*settings, config=config)
    mover.send(Goal(run_id="short", choice=Goal.BY_INDEX, index=point.index))
    assert mover.wait().error_code == CODES.NONE


def test_bounds_fence_the_way_to_a_point_and_a_word_leads_across_them(
    start_tuner: Callable[..., NodeProcess],
    client: GoalClient,
    mover: GoalClient,
    services: Services,
    node: Node,
    tmp_path: Path,
) -> None:
    machine = toy_machine(node, answer_but_violate_in_the_third)
    start = {"x1": 0.5, "x2": -0.5}
    machine.position = dict(start)
    tuner = start_tuner("initial_evaluations:=20", "on_abort:=best")
    client.send(Tune.Goal(run_id="wide", evaluations=10))
    front = client.wait().pareto_front.points
    check_other_places(mover, machine, start, {point.index for point in front})
    check_a_violation(mover, machine)
    check_approach(mover, machine, services, tmp_path)
    far = max(front, key=lambda point: values(point.setpoint)["x1"])
    where = values(far.setpoint)
    limit = where["x1"] - 0.001
    assert services.set(variables__x1__max=limit).successful

    before, kept = dict(machine.position), journal(tmp_path, "wide")
    for goal in (Goal(index=far.index), Goal(index=far.index, hold_evaluations=3, anyway=True)):
        mover.send(goal)
        result = mover.wait()
        assert result.error_code == CODES.INVALID_GOAL
        assert f"point {far.index} is out of bounds: set-point x1 is " in result.error_msg
        assert machine.position == before
    assert journal(tmp_path, "wide") == kept

    mover.send(Goal(index=far.index, anyway=True))
    assert mover.wait().error_code == CODES.NONE
    assert machine.position == where
    asked, ended = History.from_records(journal(tmp_path, "wide")).moves[-1]
    assert (asked.evaluation, asked.setpoint, asked.by) == (far.index, where, "operator")
    assert asked.anyway
    assert ended is not None
    assert (ended.readbacks, ended.error_msg) == (where, "")
    assert "the machine is sent across the bounds, as operator has said" in tuner.stderr

    # The run with that record in its journal is read as before, and a new one stays inside.
    read = services.call(
        ListWorkingPoints, "list_working_points", ListWorkingPoints.Request(run_id="wide"), 60.0
    )
    assert [point.index for point in read.measured.points] == [point.index for point in front]
    machine.goals.clear()
    client.send(Tune.Goal(run_id="narrow", resume_from="wide", evaluations=12))
    assert client.wait().error_code == 0
    for goal in machine.goals:
        assert values(goal.setpoint)["x1"] <= limit
    assert len(machine.goals) == 2

    # The state before a run that is read from its folder; the newer run began elsewhere.
    mover.send(Goal(run_id="wide", choice=Goal.BEFORE_RUN))
    assert mover.wait().run_id == "wide"
    assert machine.position == start

    # A look at an earlier run does not change which run is meant without a name.
    services.call(
        ListWorkingPoints, "list_working_points", ListWorkingPoints.Request(run_id="wide"), 60.0
    )
    [*_, point] = listed(services, False).measured.points
    mover.send(Goal(index=point.index))
    assert mover.wait().run_id == "narrow"


def answer_but_violate_in_the_third(goal: EvaluateSetpoint.Goal) -> Answer:
    """Measure the toy problem; the third set-point violates a critical limit, whenever it is measured."""
    if (goal.run_id, goal.index) == ("wide", 2):
        VIOLATING.append(values(goal.setpoint))
    if values(goal.setpoint) in VIOLATING:
        return Answer({}, EvaluateSetpoint.Result.VIOLATION, "f1 = 9 in one shot is outside")
    return Answer(toy_values(goal))


def check_a_violation(mover: GoalClient, machine: MachineDouble) -> None:
    """Go to the point that violated a critical limit, which takes a word, and does so again."""
    before = dict(machine.position)
    mover.send(Goal(index=2))
    result = mover.wait()
    assert result.error_code == CODES.INVALID_GOAL
    assert "point 2 violated a critical limit: f1 = 9 in one shot is outside" in result.error_msg
    assert machine.position == before
    mover.send(Goal(index=2, anyway=True, measure=True))
    result = mover.wait()
    assert (result.error_code, list(result.measured)) == (CODES.NONE, [])
    assert result.error_msg == "point 2 was not measured: f1 = 9 in one shot is outside"
    assert machine.position == VIOLATING[0]


def check_approach(
    mover: GoalClient, machine: MachineDouble, services: Services, tmp_path: Path
) -> None:
    """Go to a point from the side from which its evaluation was."""
    assert services.set(variables__x2__approach=0.125).successful
    mover.send(Goal(index=6))
    assert mover.wait().error_code == CODES.NONE
    history = History.from_records(journal(tmp_path, "wide"))
    earlier, there = history.evaluations[5].setpoint, history.evaluations[6].setpoint
    move = history.moves[-1].asked
    assert move.setpoint == there == machine.position
    assert move.via == values(machine.moves[-1].via)
    back = earlier["x2"] - there["x2"]
    assert abs(back) > 0.125
    assert move.via is not None
    assert move.via["x1"] == there["x1"]
    assert move.via["x2"] == pytest.approx(there["x2"] + math.copysign(0.125, back))
    # Where a bound bars that side, the machine goes straight, and says so.
    bound = "min" if back < 0.0 else "max"
    limit = there["x2"] + math.copysign(0.0625, back)
    assert services.set(**{f"variables__x2__{bound}": limit}).successful
    mover.send(Goal(index=6))
    result = mover.wait()
    assert (result.error_code, machine.moves[-1].via) == (CODES.NONE, [])
    assert "straight" in result.error_msg
    assert f"set-point x2 is {move.via['x2']:g}" in result.error_msg
    widened = math.copysign(2.0, back)
    assert services.set(
        **{f"variables__x2__{bound}": widened}, variables__x2__approach=0.0
    ).successful


def check_other_places(
    mover: GoalClient, machine: MachineDouble, start: dict[str, float], front: set[int]
) -> None:
    """Go to an evaluation that is not on the front, and to where the machine was before the run."""
    index = next(n for n in range(10) if n not in front)
    there = values(machine.goals[index].setpoint)
    mover.send(Goal(index=index, measure=True))
    result = mover.wait()
    assert (result.error_code, machine.position) == (CODES.NONE, there)
    assert result.point.index == index
    assert values(result.measured) == pytest.approx(values(result.point.objectives))
    mover.send(Goal(index=index, hold_evaluations=3))
    assert "only a point of the front can be held" in mover.wait().error_msg
    mover.send(Goal(choice=Goal.BEFORE_RUN))
    result = mover.wait()
    assert (result.error_code, machine.position) == (CODES.NONE, start)
    assert (values(result.point.setpoint), list(result.point.objectives)) == (start, [])
