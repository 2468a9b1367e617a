"""When a run ends before its budget is spent: decided without any process, and carried out."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Literal

import pytest
from rclpy.node import Node

from mobo_msgs_py import msg
from mobo_msgs_py.action import Tune
from mobo_tuner.machine.double import Answer
from mobo_tuner.ros.qos import LATCHED
from mobo_tuner.runs.records import StopReason
from mobo_tuner.tuner.run.stopping import SUGGESTIONS, Progress
from tests.runs.test_records import EVALUATION
from tests.support.processes import NodeProcess
from tests.support.tuner import GoalClient, Listener, Services, journal, toy_machine
from tests.tuner.run.test_decisions import Clock, parameters


def progress(
    *hypervolumes: float,
    source: Literal["initial", "model"] = "model",
    valid: bool = True,
    start: float = 0.0,
) -> Progress:
    found = Progress(Clock())
    found.begin(start)
    for hypervolume in hypervolumes:
        record = replace(EVALUATION, source=source, valid=valid, hypervolume=hypervolume)
        found.note(record)
    return found


def test_a_run_goes_on_unless_it_is_told_otherwise() -> None:
    made = progress(*[1.0] * 50)
    assert made.reason(parameters()) is None
    assert not any(made.promises_little(0.0, parameters()) for _ in range(9))


def test_the_time_of_a_run_is_that_of_a_steady_clock_from_its_start() -> None:
    clock = Clock()
    made = Progress(clock)
    clock.now += 1000.0
    made.begin(0.0)
    limited = parameters(stop_after=60.0)
    clock.now += 59.9
    assert made.reason(limited) is None
    clock.now += 0.1
    assert made.reason(limited) is StopReason.TIME
    assert made.reason(parameters(stop_after=61.0)) is None  # it may be set during a run


@pytest.mark.parametrize(
    ("hypervolumes", "ends"),
    [
        ((5.0, 5.0), False),
        ((5.0, 5.0, 5.0, 5.0), True),
        ((5.0, 5.0, 5.0, 5.1), False),
        ((5.0, 5.0, 5.1, 5.0), False),
        ((5.0, 5.001, 5.002, 5.003), True),  # less than 0.1 % in all
        ((5.0, 5.004, 5.008, 5.012), False),
        ((9.0, 5.0, 5.0, 5.0), True),  # a belief that was given up is no gain
    ],
)
def test_a_run_stagnates_when_its_last_evaluations_gained_nothing(
    hypervolumes: tuple[float, ...], ends: bool
) -> None:
    expected = StopReason.STAGNATION if ends else None
    assert progress(*hypervolumes).reason(parameters(stop_without_gain=3)) is expected


def test_the_evaluations_before_a_run_and_its_initial_design_do_not_count() -> None:
    limited = parameters(stop_without_gain=2)
    assert progress(*[5.0] * 9, source="initial").reason(limited) is None
    assert progress(*[5.0] * 9, valid=False).reason(limited) is None
    assert progress(5.0, 5.0, start=4.0).reason(limited) is None
    assert progress(5.0, 5.0, start=5.0).reason(limited) is StopReason.STAGNATION
    begun = progress(5.0, 5.0, 5.0)
    begun.count_again(7.0)
    assert begun.reason(limited) is None


def test_only_several_poor_suggestions_in_a_row_end_a_run() -> None:
    limited = parameters(stop_below_expected_gain=1.0)
    made = Progress()
    for _ in range(SUGGESTIONS - 1):
        assert not made.promises_little(0.0099, limited)
    assert not made.promises_little(0.0101, limited)
    for _ in range(SUGGESTIONS - 1):
        assert not made.promises_little(0.0, limited)
    assert not made.promises_little(math.nan, limited)
    answers = [made.promises_little(0.001, limited) for _ in range(SUGGESTIONS)]
    assert answers == [False] * (SUGGESTIONS - 1) + [True]


# ------------------------------------------------------------------ carried out


def test_a_run_that_gains_nothing_ends_at_the_best_point(
    start_tuner: Callable[..., NodeProcess], client: GoalClient, node: Node, tmp_path: Path
) -> None:
    machine = toy_machine(node)
    good, poor = Answer({"f1": 1.0, "f2": 1.0}), Answer({"f1": 4.0, "f2": 4.0})
    machine.answer = lambda goal: good if goal.index == 1 else poor
    start_tuner("initial_evaluations:=3", "stop_without_gain:=4", "on_end:=best")
    client.send(Tune.Goal(run_id="stuck", evaluations=50))
    result = client.wait()
    assert (result.error_code, result.stop_reason, result.evaluations) == (0, "stagnation", 7)
    [point] = result.pareto_front.points
    assert point.index == 1
    best = {item.name: item.value for item in point.setpoint}
    assert machine.position == pytest.approx(best)
    end = journal(tmp_path, "stuck")[-1]
    assert (end["stop_reason"], end["error_msg"]) == ("stagnation", "")


def test_the_time_of_a_run_ends_a_pause_and_the_machine_goes_back(
    start_tuner: Callable[..., NodeProcess],
    client: GoalClient,
    services: Services,
    node: Node,
    spin_until: Callable[..., None],
) -> None:
    machine = toy_machine(node)
    machine.position = before = {"x1": 1.5, "x2": 0.5}
    statuses = Listener(node, msg.TunerStatus, "status", LATCHED)
    start_tuner("initial_evaluations:=50", "on_end:=restore")
    client.send(Tune.Goal(evaluations=1000))
    spin_until(lambda: len(machine.goals) >= 2, "some evaluations")
    assert services.trigger("pause").success
    spin_until(lambda: statuses.messages[-1].state == msg.TunerStatus.PAUSED, "a pause")
    count = len(machine.goals)
    assert services.set(stop_after=0.5).successful
    result = client.wait()
    assert (result.error_code, result.stop_reason, result.evaluations) == (0, "time", count)
    assert machine.position == before
    spin_until(lambda: statuses.messages[-1].state == msg.TunerStatus.IDLE, "the end")
    assert statuses.messages[-1].message == "the machine went to the state before the run"


def test_the_run_of_an_operator_ends_when_little_is_expected(
    start_tuner: Callable[..., NodeProcess], client: GoalClient, node: Node
) -> None:
    machine = toy_machine(node)
    start_tuner("initial_evaluations:=4", "stop_below_expected_gain:=4.0", config="shift.yaml")
    client.send(Tune.Goal(run_id="shift"))
    result = client.wait(60.0)
    assert (result.error_code, result.stop_reason) == (0, "little_expected")
    assert 4 + SUGGESTIONS <= result.evaluations < 25
    assert result.pareto_front.hypervolume > 9.0  # of at most 15
    assert len({(g.setpoint[0].value, g.setpoint[1].value) for g in machine.goals}) == len(
        machine.goals
    )
    for goal in machine.goals:
        at = {item.name: item.value for item in goal.setpoint}
        assert at["x1"] == round(at["x1"] * 20.0) / 20.0  # exactly on its grid
        assert at["x1"] + at["x2"] <= 1.5
    position = {name: pytest.approx(value) for name, value in machine.position.items()}
    front = [{i.name: i.value for i in p.setpoint} for p in result.pareto_front.points]
    assert position in front
