"""Steering a run that goes on: pause, resume, step, skip, stop after this, and set-points of operators."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from pathlib import Path

import pytest
from rclpy.node import Node

from mobo_msgs_py import msg
from mobo_msgs_py.action import EvaluateSetpoint, Tune
from mobo_msgs_py.srv import ForgetEvaluation, QueueSetpoint
from mobo_tuner.ros.qos import LATCHED
from mobo_tuner.runs.history import History
from mobo_tuner.runs.replay import compare
from tests.support.processes import NodeProcess
from tests.support.tuner import (
    GoalClient,
    Listener,
    Services,
    journal,
    toy_machine,
)

RESULT = EvaluateSetpoint.Result
State = msg.TunerStatus
VERBS = {  # of operators, by the name of their service
    "pause": "pause",
    "resume": "continue",
    "step": "step",
    "skip": "skip",
    "stop_after_this": "stop",
}


class Desk:
    """A run on a machine that the test holds, and the operator's services."""

    def __init__(
        self,
        node: Node,
        client: GoalClient,
        services: Services,
        spin_until: Callable[..., None],
    ) -> None:
        self.machine = toy_machine(node)
        self.statuses = Listener(node, State, "status", LATCHED)
        self.client = client
        self.services = services
        self.spin_until = spin_until

    def start(self, **goal: object) -> None:
        """Begin a run, and hold the machine in its first evaluation."""
        self.machine.held = True
        self.client.send(Tune.Goal(**goal))
        self.spin_until(lambda: self.machine.goals, "the first evaluation")

    def ask(self, name: str) -> str:
        """Call a trigger that must succeed; its message."""
        response = self.services.trigger(name)
        assert response.success, response.message
        return str(response.message)

    def queue(self, **setpoint: float) -> QueueSetpoint.Response:
        named = [msg.NamedValue(name=name, value=value) for name, value in setpoint.items()]
        request = QueueSetpoint.Request(setpoint=named)
        return self.services.call(QueueSetpoint, "queue_setpoint", request)

    def until_paused(self, evaluations: int) -> None:
        def paused() -> bool:
            last = self.statuses.messages[-1]
            return last.state == State.PAUSED and last.evaluations == evaluations

        self.spin_until(paused, f"a pause after {evaluations} evaluations")
        assert len(self.machine.goals) == evaluations


@pytest.fixture
def desk(
    node: Node, client: GoalClient, services: Services, spin_until: Callable[..., None]
) -> Desk:
    return Desk(node, client, services, spin_until)


def test_pause_step_resume_and_stop_after_this(
    start_tuner: Callable[..., NodeProcess], desk: Desk, tmp_path: Path
) -> None:
    start_tuner("initial_evaluations:=4")
    for name, verb in VERBS.items():
        refused = desk.services.trigger(name)
        assert not refused.success
        assert refused.message == f"'{verb}' needs an active run; there is none"

    desk.start(run_id="steered", evaluations=50)
    assert desk.ask("pause") == "the run pauses before evaluation 1"
    desk.machine.held = False
    desk.until_paused(1)
    text = desk.statuses.messages[-1].message
    assert text == "paused before evaluation 1: an operator asked for it"
    desk.ask("step")
    desk.until_paused(2)
    desk.ask("step")
    desk.ask("step")
    desk.until_paused(4)
    desk.ask("resume")
    desk.spin_until(lambda: len(desk.machine.goals) >= 7, "the run to go on")
    desk.machine.held = True
    count = len(desk.machine.goals)
    desk.spin_until(lambda: len(desk.machine.goals) > count, "an evaluation that is held")
    last = desk.machine.goals[-1].index
    assert desk.ask("stop_after_this") == f"the run ends after evaluation {last}"
    desk.machine.held = False
    result = desk.client.wait()
    assert (result.error_code, result.stop_reason) == (0, "stopped")
    assert result.evaluations == last + 1
    assert result.pareto_front.points
    assert journal(tmp_path, "steered")[-1]["stop_reason"] == "stopped"


def test_a_paused_run_is_canceled_or_stopped_at_once(
    start_tuner: Callable[..., NodeProcess], desk: Desk
) -> None:
    start_tuner("initial_evaluations:=4")
    desk.start(run_id="one", evaluations=50)
    desk.ask("pause")
    desk.machine.held = False
    desk.until_paused(1)
    desk.client.cancel()
    started = time.monotonic()
    assert desk.client.wait().error_code == Tune.Result.CANCELED
    assert time.monotonic() - started < 2.0  # one, and one more for a busy computer

    desk.machine.goals.clear()
    desk.start(run_id="two", evaluations=50)  # and it does not begin paused
    desk.ask("pause")
    desk.machine.held = False
    desk.until_paused(1)
    assert desk.ask("stop_after_this") == "the run ends before evaluation 1"
    result = desk.client.wait()
    assert (result.error_code, result.stop_reason, result.evaluations) == (0, "stopped", 1)

    # What is asked for during the last evaluation is refused, or extends the run; nothing is lost.
    desk.machine.goals.clear()
    desk.start(run_id="three", evaluations=1)
    for name in ("pause", "step"):
        refused = desk.services.trigger(name)
        assert not refused.success
        assert "evaluation 0 is the last one" in refused.message
    assert "evaluation 0 is the last one" in desk.queue(x1=0.0, x2=0.0).message
    assert desk.services.set(evaluations=2).successful
    assert desk.queue(x1=0.25, x2=0.5).success
    assert desk.ask("pause") == "the run pauses before evaluation 1"
    desk.machine.held = False
    desk.until_paused(1)
    desk.ask("step")
    result = desk.client.wait()
    assert (result.stop_reason, result.evaluations) == ("budget", 2)
    assert {s.name: s.value for s in desk.machine.goals[-1].setpoint} == {"x1": 0.25, "x2": 0.5}
    desk.spin_until(
        lambda: "ended before a pause" in desk.statuses.messages[-1].message, "what was not done"
    )


def test_skip_ends_the_evaluation_in_flight_and_no_other(
    start_tuner: Callable[..., NodeProcess], desk: Desk, tmp_path: Path
) -> None:
    start_tuner("initial_evaluations:=4", "max_consecutive_failures:=1")
    desk.start(run_id="skipped", evaluations=5)
    assert desk.ask("skip") == "evaluation 0 is skipped, which counts as failed"
    desk.spin_until(lambda: len(desk.machine.goals) == 2, "the next evaluation")
    assert [goal.index for goal in desk.machine.goals] == [0, 1]
    desk.ask("pause")
    desk.machine.held = False
    desk.until_paused(2)
    # Nothing is in flight: what an operator queues now is measured all the same.
    refused = desk.services.trigger("skip")
    assert not refused.success
    assert refused.message == "'skip' needs an evaluation in flight; there is none"
    assert desk.queue(x1=0.25, x2=0.5).success
    # The machine has measured when it is to stop: the evaluation counts, and the answer says so.
    desk.machine.held = desk.machine.finishes = True
    desk.ask("step")
    desk.spin_until(lambda: len(desk.machine.goals) == 3, "an evaluation in flight")
    late = desk.services.trigger("skip")
    assert not late.success
    assert late.message == "'skip' comes too late: evaluation 2 had ended"
    desk.until_paused(3)
    desk.machine.held = False
    desk.ask("resume")
    assert desk.client.wait().error_code == 0
    assert [goal.index for goal in desk.machine.goals] == [0, 1, 2, 3, 4]
    records = [r for r in journal(tmp_path, "skipped") if r["type"] == "evaluation"]
    assert [r["valid"] for r in records] == [False, True, True, True, True]
    assert records[2]["setpoint"] == {"x1": 0.25, "x2": 0.5}
    assert records[0]["error_code"] == RESULT.CANCELED
    assert records[0]["error_msg"] == "skipped by an operator"
    assert records[0]["diagnostics"] == {}
    assert len({tuple(r["setpoint"].values()) for r in records}) == 5


def test_an_operators_setpoints_come_next(
    start_tuner: Callable[..., NodeProcess], desk: Desk, tmp_path: Path
) -> None:
    start_tuner("initial_evaluations:=2")
    assert "there is none" in desk.queue(x1=0.0, x2=0.0).message
    desk.start(run_id="queued", evaluations=6)
    for setpoint, sentence in (
        ({"x1": 0.0}, "the set-point lacks the variable 'x2'"),
        ({"x1": 0.0, "x2": 0.0, "x3": 0.0}, "'x3' is unknown in the set-point"),
        ({"x1": 0.0, "x2": 2.5}, "set-point x2 is 2.5; -2 to 2 is allowed"),
        ({"x1": 0.0, "x2": math.nan}, "set-point x2 must be a finite number"),
    ):
        response = desk.queue(**setpoint)
        assert not response.success
        assert sentence in response.message
        assert response.waiting == 0
    twice = [msg.NamedValue(name="x1"), msg.NamedValue(name="x1"), msg.NamedValue(name="x2")]
    request = QueueSetpoint.Request(setpoint=twice)
    response = desk.services.call(QueueSetpoint, "queue_setpoint", request)
    assert response.message == "the set-point names 'x1' twice"
    assert [desk.queue(x1=0.25, x2=y).waiting for y in (0.5, 0.75)] == [1, 2]
    desk.machine.held = False
    assert desk.client.wait().error_code == 0
    asked = [{s.name: s.value for s in goal.setpoint} for goal in desk.machine.goals]
    assert asked[1:3] == [{"x1": 0.25, "x2": 0.5}, {"x1": 0.25, "x2": 0.75}]
    records = journal(tmp_path, "queued")
    sources = [r["source"] for r in records if r["type"] == "evaluation"]
    assert sources == ["initial", "operator", "operator", "model", "model", "model"]
    waiting = [r["setpoint"] for r in records if r["type"] == "queued"]  # kept, to be resumed with
    assert waiting == [{"x1": 0.25, "x2": 0.5}, {"x1": 0.25, "x2": 0.75}]
    told = [feedback.evaluation.source for feedback in desk.client.feedback]
    assert told[1:4] == [msg.Evaluation.OPERATOR, msg.Evaluation.OPERATOR, msg.Evaluation.MODEL]


def test_an_evaluation_and_a_diagnostic_are_withdrawn_and_count_again(
    start_tuner: Callable[..., NodeProcess], desk: Desk, tmp_path: Path
) -> None:
    def call(name: str, index: int, diagnostic: str = "") -> ForgetEvaluation.Response:
        request = ForgetEvaluation.Request(index=index, diagnostic=diagnostic)
        return desk.services.call(ForgetEvaluation, name, request)

    start_tuner("initial_evaluations:=4")
    assert "there is none" in call("forget", 0).message
    desk.start(run_id="withdrawn", evaluations=8)
    desk.ask("pause")
    desk.machine.held = False
    desk.until_paused(1)
    assert "0 to 0 are allowed" in call("forget", 1).message
    assert "'beam'" in call("forget", 0, "beam").message
    assert "was not withdrawn" in call("unforget", 0).message
    assert call("forget", 0).success
    assert "withdrawn already" in call("forget", 0).message
    for _ in range(5):
        desk.ask("step")
    desk.until_paused(6)
    assert desk.statuses.messages[-1].failed == 0  # but withdrawn, as the report says, too
    assert desk.statuses.messages[-1].feasible == 5
    assert call("unforget", 0).success
    assert call("forget", 3, "f1").success
    desk.ask("resume")
    assert desk.client.wait().error_code == 0
    kept = [r for r in journal(tmp_path, "withdrawn") if r["type"] == "forget"]
    assert [(r["index"], r["evaluation"], r["diagnostic"], r["withdrawn"]) for r in kept] == [
        (1, 0, "", True),
        (6, 0, "", False),
        (6, 3, "f1", True),
    ]
    history = History.from_records(journal(tmp_path, "withdrawn"))
    assert not any(comparison.differs for comparison in compare(history))
