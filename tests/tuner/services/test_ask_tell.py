"""The services ask and tell, for clients that own their loop."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from rclpy.node import Node

from mobo_msgs_py import msg
from mobo_msgs_py.action import EvaluateSetpoint, GoToWorkingPoint, Tune
from mobo_msgs_py.srv import Ask, ListWorkingPoints, Tell
from mobo_tuner.core import Optimizer, Problem
from mobo_tuner.ros.qos import LATCHED, STREAM
from tests.support.processes import NodeProcess
from tests.support.tuner import (
    CONFIG,
    GoalClient,
    Listener,
    Services,
    journal,
    toy_machine,
    toy_values,
)


class Loop:
    """A client that owns its loop, and measures by itself."""

    def __init__(self, services: Services) -> None:
        self._services = services

    def ask(self) -> Ask.Response:
        return self._services.call(Ask, "ask")

    def tell(
        self,
        setpoint: list[msg.NamedValue] | dict[str, float],
        diagnostics: dict[str, float] | list[msg.NamedValue] | None = None,
        **identity: Any,
    ) -> Tell.Response:
        """Tell of a set-point what the toy problem gives there, or something else."""
        if isinstance(setpoint, dict):
            setpoint = [msg.NamedValue(name=n, value=v) for n, v in setpoint.items()]
        if diagnostics is None:
            diagnostics = toy_values(EvaluateSetpoint.Goal(setpoint=setpoint))
        if isinstance(diagnostics, dict):
            diagnostics = [
                msg.NamedValue(name=n, value=v, stddev=math.nan) for n, v in diagnostics.items()
            ]
        request = Tell.Request(setpoint=setpoint, diagnostics=diagnostics, **identity)
        return self._services.call(Tell, "tell", request)


@pytest.fixture
def loop(services: Services) -> Loop:
    return Loop(services)


def test_a_loop_of_ones_own_gets_what_the_library_would_ask(
    start_tuner: Callable[..., NodeProcess],
    loop: Loop,
    services: Services,
    node: Node,
    spin_until: Callable[..., None],
    tmp_path: Path,
) -> None:
    start_tuner("seed:=5", "initial_evaluations:=4")
    evaluations = Listener(node, msg.Evaluation, "evaluation", STREAM)
    fronts = Listener(node, msg.ParetoFront, "pareto_front", LATCHED)
    statuses = Listener(node, msg.TunerStatus, "status", LATCHED)
    oracle = Optimizer(Problem.from_yaml(CONFIG / "toy.yaml"), seed=5, initial_evaluations=4)
    for index in range(8):
        asked = loop.ask()
        assert asked.success, asked.message
        assert asked.index == index
        assert asked.source == (msg.Evaluation.INITIAL if index < 4 else msg.Evaluation.MODEL)
        x = {item.name: item.value for item in asked.setpoint}
        assert x == oracle.ask()
        assert {item.name: item.value for item in loop.ask().setpoint} == x
        told = loop.tell(asked.setpoint)
        assert told.success, told.message
        oracle.tell(x, toy_values(EvaluateSetpoint.Goal(setpoint=asked.setpoint)))
        assert told.evaluation.index == index
        assert told.evaluation.source == asked.source
        assert told.evaluation.hypervolume == oracle.hypervolume

    own = loop.tell({"x1": 0.0, "x2": 0.0})
    assert own.evaluation.source == msg.Evaluation.OPERATOR
    partly = loop.tell({"x1": 1.9, "x2": 1.9}, {"f1": 1.0, "f2": math.nan})
    assert partly.success
    assert partly.evaluation.valid
    assert not partly.evaluation.feasible
    failed = loop.tell({"x1": 1.8, "x2": 1.9}, {"f1": math.nan, "f2": math.nan})
    assert failed.success
    assert not failed.evaluation.valid
    assert failed.evaluation.error_code == EvaluateSetpoint.Result.INVALID_MEASUREMENT
    spin_until(lambda: len(evaluations.messages) == 11, "all evaluations")
    run_id = evaluations.messages[0].run_id
    assert {m.run_id for m in evaluations.messages} == {run_id}
    spin_until(lambda: statuses.messages[-1].evaluations == 11, "the status of that run")
    assert (statuses.messages[-1].run_id, statuses.messages[-1].budget) == (run_id, 0)
    listed = services.call(ListWorkingPoints, "list_working_points").measured
    assert listed.run_id == run_id
    assert [p.index for p in listed.points] == [p.index for p in fronts.messages[-1].points]
    records = journal(tmp_path, run_id)
    assert [r["type"] for r in records] == ["start", *["evaluation"] * 11]
    assert [r["valid"] for r in records[1:]] == [True] * 10 + [False]

    # A run that holds a point of it takes the status, until the client asks again.
    toy_machine(node)
    mover = GoalClient(node, spin_until, GoToWorkingPoint, "go_to_working_point")
    mover.send(GoToWorkingPoint.Goal(index=listed.points[0].index, hold_evaluations=1))
    assert mover.wait().error_code == 0
    spin_until(lambda: statuses.messages[-1].stop_reason == "budget", "the end of the holding")
    assert "-hold-" in statuses.messages[-1].run_id
    assert loop.ask().run_id == run_id
    spin_until(lambda: statuses.messages[-1].run_id == run_id, "the status of the client's run")
    last = statuses.messages[-1]
    assert (last.evaluations, last.budget, last.stop_reason) == (11, 0, "")


def test_readbacks_that_are_told_are_kept_and_learned_from(
    start_tuner: Callable[..., NodeProcess], loop: Loop, tmp_path: Path
) -> None:
    start_tuner("seed:=5", "initial_evaluations:=3", "model_input:=readback")
    oracle = Optimizer(Problem.from_yaml(CONFIG / "toy.yaml"), seed=5, initial_evaluations=3)
    offset = 0.3
    for index in range(6):
        asked = loop.ask()
        x = {item.name: item.value for item in asked.setpoint}
        assert x == oracle.ask()
        readbacks = {"x1": x["x1"] - offset * x["x1"]} if index != 1 else {"x1": math.nan}
        named = [msg.NamedValue(name=n, value=v) for n, v in readbacks.items()]
        told = loop.tell(asked.setpoint, readbacks=named, run_id=asked.run_id, index=index)
        assert told.success, told.message
        oracle.tell(x, toy_values(EvaluateSetpoint.Goal(setpoint=asked.setpoint)), readbacks)
        assert [item.name for item in told.evaluation.readbacks] == ["x1"]
    kept = [r["readbacks"]["x1"] for r in journal(tmp_path, asked.run_id)[1:]]
    assert kept[1] is None
    assert kept[5] == readbacks["x1"]


def test_what_is_told_wrong_teaches_nothing(
    start_tuner: Callable[..., NodeProcess], loop: Loop
) -> None:
    start_tuner()
    values = {"f1": 1.0, "f2": 1.0}
    twice = [msg.NamedValue(name="x1"), msg.NamedValue(name="x1")]
    for setpoint, diagnostics, sentence in (
        ({"x1": 0.0}, values, "the set-point lacks the variable 'x2'"),
        ({"x1": 0.0, "y": 0.0}, values, "'y' is unknown in the set-point"),
        ({"x1": 0.0, "x2": math.inf}, values, "set-point x2 must be a finite number"),
        (twice, values, "the set-point names 'x1' twice"),
        ({"x1": 0.0, "x2": 0.0}, twice, "the list of diagnostics names 'x1' twice"),
    ):
        told = loop.tell(setpoint, diagnostics)
        assert not told.success
        assert sentence in told.message
    for readbacks, sentence in (
        (twice, "the list of readbacks names 'x1' twice"),
        ([msg.NamedValue(name="f1")], "the readbacks name 'f1'; allowed are x1, x2"),
    ):
        told = loop.tell({"x1": 0.0, "x2": 0.0}, readbacks=readbacks)
        assert not told.success
        assert told.message == sentence
    assert loop.ask().index == 0


def test_answers_that_are_late_double_or_foreign_are_dropped_with_a_warning(
    start_tuner: Callable[..., NodeProcess], loop: Loop, tmp_path: Path
) -> None:
    tuner = start_tuner("initial_evaluations:=4")
    x = {"x1": 0.0, "x2": 0.0}
    stray = "run 'another' is not the run of the last ask"
    assert loop.tell(x, run_id="another").message == stray
    asked = loop.ask()
    identity = {"run_id": asked.run_id, "index": asked.index}
    assert loop.tell(x, run_id="another").message == stray
    early = loop.tell(asked.setpoint, run_id=asked.run_id, index=3)
    assert early.message == f"evaluation 3 of run '{asked.run_id}' was not asked for yet"
    told = loop.tell(asked.setpoint, **identity)
    assert (told.success, told.evaluation.index) == (True, 0)
    for _ in range(2):
        double = loop.tell(asked.setpoint, **identity)
        assert not double.success
        assert double.message == f"evaluation 0 of run '{asked.run_id}' was told already"
    assert loop.tell(x).evaluation.index == 1  # no answer, but a set-point of one's own
    late = loop.tell(asked.setpoint, run_id=asked.run_id, index=1)
    assert late.message == f"evaluation 1 of run '{asked.run_id}' was told already"
    for response in (early, double, late):
        assert f"an answer is dropped: {response.message}" in tuner.stderr
    assert [r["type"] for r in journal(tmp_path, asked.run_id)] == ["start", *["evaluation"] * 2]


def test_runs_and_loops_do_not_mix_and_changes_reach_both(
    start_tuner: Callable[..., NodeProcess],
    loop: Loop,
    services: Services,
    client: GoalClient,
    node: Node,
    spin_until: Callable[..., None],
    tmp_path: Path,
) -> None:
    machine = toy_machine(node)
    evaluations = Listener(node, msg.Evaluation, "evaluation", STREAM)
    tuner = start_tuner("initial_evaluations:=4")
    spin_until(lambda: node.get_publishers_info_by_topic("/evaluation"), "the tuner's topic")
    first = loop.tell(loop.ask().setpoint).evaluation.run_id
    assert services.set(variables__x1__max=-1.0).successful
    asked = [loop.ask()]
    loop.tell(asked[0].setpoint)
    assert asked[0].setpoint[0].value <= -1.0

    machine.held = True
    client.send(Tune.Goal(run_id="between", evaluations=3))
    spin_until(lambda: machine.goals, "an evaluation")
    for response in (loop.ask(), loop.tell({"x1": 0.0, "x2": 0.0})):
        assert not response.success
        assert response.message == "run 'between' is active; one run at a time is allowed"
    machine.held = False
    assert client.wait().evaluations == 3

    again = loop.ask()  # of a fresh run
    assert again.index == 0
    second = loop.tell(again.setpoint).evaluation.run_id
    assert len({first, second, "between"}) == 3
    spin_until(lambda: len(evaluations.messages) == 6, "all evaluations")
    assert [r["type"] for r in journal(tmp_path, first)] == [
        *("start", "evaluation", "change", "evaluation", "end")
    ]
    assert tuner.stop() == 0
    assert journal(tmp_path, second)[-1]["stop_reason"] == "stopped"
