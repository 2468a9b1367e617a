"""Evaluations that fail, answers that are not the ones asked for, and machines that go and return."""

from __future__ import annotations

import itertools
import signal
import time
from collections.abc import Callable
from pathlib import Path

import pytest
from rclpy.node import Node

from mobo_msgs_py import msg
from mobo_msgs_py.action import EvaluateSetpoint, Tune
from mobo_tuner.machine.double import Answer, MachineDouble
from mobo_tuner.ros.qos import LATCHED
from tests.support.processes import NodeProcess
from tests.support.tuner import (
    GoalClient,
    Listener,
    Services,
    evaluated,
    toy_machine,
    toy_values,
)

RESULT = EvaluateSetpoint.Result
FAILED = RESULT.INVALID_MEASUREMENT


def identities(machine: MachineDouble) -> list[tuple[int, int]]:
    return [(goal.index, goal.attempt) for goal in machine.goals]


def test_a_failed_evaluation_is_tried_again_after_longer_and_longer(
    start_tuner: Callable[..., NodeProcess], client: GoalClient, node: Node, tmp_path: Path
) -> None:
    def answer(goal: EvaluateSetpoint.Goal) -> Answer:
        if goal.index == 1 and goal.attempt < 2:
            return Answer({}, RESULT.TIMEOUT, "the readback stuck")
        if goal.index == 2:
            return Answer({}, FAILED, "no beam")
        return Answer(toy_values(goal))

    machine = toy_machine(node, answer)
    start_tuner("on_failure:=retry", "max_attempts:=3", "retry_delay:=0.3")
    client.send(Tune.Goal(run_id="again", evaluations=4))
    assert client.wait().error_code == 0
    assert identities(machine) == [(0, 0), (1, 0), (1, 1), (1, 2), (2, 0), (2, 1), (2, 2), (3, 0)]
    assert len({goal.setpoint[0].value for goal in machine.goals[1:4]}) == 1
    pauses = [later - earlier for earlier, later in itertools.pairwise(machine.times)]
    assert pauses[1] > 0.3  # each may last longer, on a busy computer
    assert pauses[2] > 0.6
    records = evaluated(tmp_path, "again")
    assert [r["attempts"] for r in records] == [1, 3, 3, 1]
    assert [r["valid"] for r in records] == [True, True, False, True]
    assert records[2]["error_msg"] == "no beam"


@pytest.mark.parametrize(
    ("code", "policy", "sentence", "count"),
    [
        (FAILED, "abort", "evaluation 1 failed: no", 2),
        (RESULT.INTERLOCK, "retry", "the machine refused evaluation 1: no", 3),
        (RESULT.BUSY, "skip", "the machine refused evaluation 1: no", 3),
        (RESULT.INVALID_SETPOINT, "retry", "the machine refused evaluation 1: no", 2),
        (RESULT.CANCELED, "retry", "the machine stopped: no", 2),
    ],
)
def test_what_cannot_go_on_ends_the_run(
    start_tuner: Callable[..., NodeProcess],
    client: GoalClient,
    node: Node,
    code: int,
    policy: str,
    sentence: str,
    count: int,
) -> None:
    machine = toy_machine(
        node, lambda goal: Answer(toy_values(goal), code if goal.index else RESULT.NONE, "no")
    )
    settings = ("max_attempts:=2", "retry_delay:=0.1", "on_interlock:=retry")
    start_tuner(f"on_failure:={policy}", *settings)
    client.send(Tune.Goal(evaluations=50))
    result = client.wait()
    assert (result.error_code, result.error_msg) == (Tune.Result.MACHINE_ERROR, sentence)
    assert len(machine.goals) == count
    # What failed is kept, what was refused is not an evaluation.
    assert result.evaluations == (2 if policy == "abort" else 1)


@pytest.mark.parametrize("ahead", [3600.0, -3600.0])
def test_answers_to_other_evaluations_are_dropped_with_a_warning(
    start_tuner: Callable[..., NodeProcess],
    client: GoalClient,
    node: Node,
    tmp_path: Path,
    ahead: float,
) -> None:
    machine = toy_machine(node)

    def identity(goal: EvaluateSetpoint.Goal) -> tuple[str, int, int]:
        wrong = {1: ("another", 1, 0), 2: (goal.run_id, 1, 0), 3: (goal.run_id, 3, 7)}
        return wrong.get(goal.index, (goal.run_id, goal.index, goal.attempt))

    machine.identity = identity
    machine.ahead = ahead  # such a stamp is not kept: all that is predicted would be of that time
    tuner = start_tuner()
    client.send(Tune.Goal(run_id="mine", evaluations=5))
    assert client.wait().error_code == 0
    records = evaluated(tmp_path, "mine")
    assert [r["valid"] for r in records] == [True, False, False, False, True]
    assert [r["diagnostics"] for r in records[1:4]] == [{}, {}, {}]
    for text in (
        "evaluation 1, attempt 0 of run 'another', not for evaluation 1, attempt 0 of run 'mine'",
        "evaluation 1, attempt 0 of run 'mine', not for evaluation 2, attempt 0 of run 'mine'",
        "evaluation 3, attempt 7 of run 'mine', not for evaluation 3, attempt 0 of run 'mine'",
    ):
        assert f"{text}; that answer is dropped" in tuner.stderr
    assert all(abs(r["stamp"] - time.time()) < 600.0 for r in records)
    assert tuner.stderr.count("set its clock") == 1


def test_a_machine_that_was_silent_is_asked_again_and_its_late_answer_dropped(
    start_tuner: Callable[..., NodeProcess],
    client: GoalClient,
    node: Node,
    spin_until: Callable[..., None],
    tmp_path: Path,
) -> None:
    machine = toy_machine(node)
    tuner = start_tuner("machine_timeout:=1.0", "machine_return_timeout:=20.0")
    machine.silent = True
    client.send(Tune.Goal(run_id="slow", evaluations=3))
    spin_until(lambda: len(machine.goals) == 2, "the second attempt")
    machine.silent = False
    assert client.wait().error_code == 0
    assert identities(machine) == [(0, 0), (0, 1), (1, 0), (2, 0)]
    assert "the machine has been silent for 1.0 s; the run waits up to 20 s" in tuner.stderr
    late = "the answer to evaluation 0, attempt 0 of run 'slow' came too late and is dropped"
    spin_until(lambda: late in tuner.stderr, "the warning")
    records = evaluated(tmp_path, "slow")
    assert [(r["index"], r["attempts"]) for r in records] == [(0, 2), (1, 1), (2, 1)]


def test_a_run_goes_on_when_its_machine_returns(
    start_tuner: Callable[..., NodeProcess],
    start_machine: Callable[..., NodeProcess],
    client: GoalClient,
    node: Node,
    spin_until: Callable[..., None],
    tmp_path: Path,
) -> None:
    machine = start_machine("speed:=50.0", config="awa.yaml")
    start_tuner("machine_timeout:=1.0", "machine_return_timeout:=60.0", config="awa.yaml")
    statuses = Listener(node, msg.TunerStatus, "status", LATCHED)
    client.send(Tune.Goal(run_id="returns", evaluations=5))
    spin_until(lambda: len(client.feedback) >= 2, "two evaluations")
    machine.kill()
    spin_until(lambda: statuses.messages[-1].state == msg.TunerStatus.WAITING, "a waiting tuner")
    assert "waiting for its return" in statuses.messages[-1].message
    start_machine("speed:=1000.0", config="awa.yaml")
    result = client.wait(60.0)
    assert (result.error_code, result.stop_reason) == (0, "budget")
    records = evaluated(tmp_path, "returns")
    assert [r["index"] for r in records] == list(range(5))
    assert all(r["valid"] for r in records)
    assert max(r["attempts"] for r in records) == 2


def test_a_machine_that_does_not_return_in_time_ends_the_run(
    start_tuner: Callable[..., NodeProcess],
    client: GoalClient,
    node: Node,
    spin_until: Callable[..., None],
) -> None:
    machine = toy_machine(node)
    start_tuner("machine_timeout:=1.0", "machine_return_timeout:=1.5")
    machine.held = True
    client.send(Tune.Goal(evaluations=5))
    spin_until(lambda: machine.goals, "an evaluation")
    machine.close()
    result = client.wait()
    assert result.error_code == Tune.Result.MACHINE_LOST
    assert "silent for 1.0 s, and did not return within 1.5 s" in result.error_msg


def test_a_machine_that_returns_may_take_its_time_to_be_ready(
    start_tuner: Callable[..., NodeProcess],
    client: GoalClient,
    node: Node,
    spin_until: Callable[..., None],
) -> None:
    machine = toy_machine(node)
    codes = [RESULT.MACHINE_LOST, *[RESULT.NOT_ACTIVE] * 3, *[RESULT.BUSY] * 3]

    def answer(goal: EvaluateSetpoint.Goal) -> Answer:
        code = codes.pop(0) if codes else RESULT.NONE
        return Answer(toy_values(goal), code, "not yet" if code else "")

    machine.answer = answer
    start_tuner("retry_delay:=0.1", "max_attempts:=2", "machine_return_timeout:=30.0")
    client.send(Tune.Goal(evaluations=2))
    assert client.wait().error_code == 0
    assert identities(machine) == [*((0, attempt) for attempt in range(8)), (1, 0)]
    # And one that never gets ready is not waited for without end.
    codes.extend([RESULT.MACHINE_LOST] * 1000)
    client.send(Tune.Goal(evaluations=2))
    count = len(machine.goals)
    spin_until(lambda: len(machine.goals) > count + 2, "further attempts")
    client.cancel()
    assert client.wait().error_code == Tune.Result.CANCELED


def test_a_tuner_that_was_frozen_goes_on_where_it_was(
    start_tuner: Callable[..., NodeProcess],
    start_machine: Callable[..., NodeProcess],
    client: GoalClient,
    node: Node,
    spin_until: Callable[..., None],
    tmp_path: Path,
) -> None:
    machine = start_machine("speed:=10.0", "mode:=ideal", config="awa.yaml")
    settings = ("client_timeout:=1.5", "on_client_lost:=restore", "machine_return_timeout:=60.0")
    tuner = start_tuner("machine_timeout:=2.0", *settings, config="awa.yaml")
    statuses = Listener(node, msg.TunerStatus, "status", LATCHED)
    client.send(Tune.Goal(run_id="frozen", evaluations=4))
    spin_until(
        lambda: client.feedback and statuses.messages[-1].phase == "ramping", "the second move"
    )
    tuner.popen.send_signal(signal.SIGSTOP)
    lost = "the heartbeat of run 'frozen' stopped for more than 1.5 s"
    spin_until(lambda: lost in machine.stderr, "the machine to notice")
    tuner.popen.send_signal(signal.SIGCONT)
    result = client.wait(60.0)
    assert (result.error_code, result.evaluations) == (0, 4)
    records = evaluated(tmp_path, "frozen")
    assert all(r["valid"] for r in records)
    assert max(r["attempts"] for r in records) >= 2


def test_an_interlock_that_passes_is_waited_for_and_shown_until_it_ends(
    start_tuner: Callable[..., NodeProcess],
    client: GoalClient,
    node: Node,
    spin_until: Callable[..., None],
    tmp_path: Path,
) -> None:
    machine = toy_machine(node)
    forbidden = True

    def answer(goal: EvaluateSetpoint.Goal) -> Answer:
        if goal.index == 1 and forbidden:
            return Answer({}, RESULT.INTERLOCK, "interlock water forbids to move")
        return Answer(toy_values(goal))

    machine.answer = answer
    statuses = Listener(node, msg.TunerStatus, "status", LATCHED)
    start_tuner("retry_delay:=0.1", "max_attempts:=1", "interlock_timeout:=60.0")
    client.send(Tune.Goal(run_id="permit", evaluations=3))
    spin_until(lambda: len(machine.goals) > 5, "attempts")
    spin_until(lambda: statuses.messages[-1].state == msg.TunerStatus.WAITING, "the wait")
    last = statuses.messages[-1]
    assert "interlock water forbids to move; waiting up to 60 s" in last.message
    assert last.last_failure == "evaluation 1: interlock water forbids to move"
    forbidden = False
    assert client.wait().error_code == 0
    spin_until(lambda: statuses.messages[-1].state == msg.TunerStatus.IDLE, "the end")
    assert statuses.messages[-1].message == ""
    records = evaluated(tmp_path, "permit")
    assert [r["valid"] for r in records] == [True] * 3
    assert records[1]["attempts"] > 3


def test_a_permit_that_does_not_come_in_time_ends_the_run(
    start_tuner: Callable[..., NodeProcess], client: GoalClient, node: Node
) -> None:
    toy_machine(node, lambda _: Answer({}, RESULT.INTERLOCK, "no permit"))
    start_tuner("retry_delay:=0.1", "interlock_timeout:=0.5")
    client.send(Tune.Goal(evaluations=3))
    result = client.wait()
    assert result.error_code == Tune.Result.MACHINE_ERROR
    assert result.error_msg == "the machine refused evaluation 0: no permit, for 0.5 s now"


def test_a_run_pauses_during_an_evaluation_and_tries_it_again_when_resumed(
    start_tuner: Callable[..., NodeProcess],
    client: GoalClient,
    services: Services,
    node: Node,
    spin_until: Callable[..., None],
) -> None:
    machine = toy_machine(node)
    codes = {1: [RESULT.INTERLOCK], 2: [RESULT.MACHINE_LOST], 3: [RESULT.INTERLOCK] * 99}

    def answer(goal: EvaluateSetpoint.Goal) -> Answer:
        left = codes.get(goal.index, [])
        return Answer(toy_values(goal), left.pop() if left else RESULT.NONE, "the door is open")

    machine.answer = answer
    statuses = Listener(node, msg.TunerStatus, "status", LATCHED)
    start_tuner("on_interlock:=pause", "on_fault:=pause")
    client.send(Tune.Goal(evaluations=10))
    for index in (1, 2, 3):
        text = f"paused during evaluation {index}: the door is open"

        def paused(text: str = text) -> bool:
            last = statuses.messages[-1] if statuses.messages else msg.TunerStatus()
            return last.state == msg.TunerStatus.PAUSED and last.message == text

        spin_until(paused, text)
        if index < 3:
            assert services.trigger("resume").success
    answer_of_stop = services.trigger("stop_after_this")
    assert answer_of_stop.message == "the run ends before evaluation 3"
    result = client.wait()
    assert (result.error_code, result.stop_reason, result.evaluations) == (0, "stopped", 3)
    assert identities(machine) == [(0, 0), (1, 0), (1, 1), (2, 0), (2, 1), (3, 0)]


def test_a_pause_after_a_failure_says_why(
    start_tuner: Callable[..., NodeProcess],
    client: GoalClient,
    services: Services,
    node: Node,
    spin_until: Callable[..., None],
) -> None:
    toy_machine(
        node,
        lambda goal: (
            Answer({}, FAILED, "no beam")
            if goal.index == 1
            else Answer(
                toy_values(goal), RESULT.VIOLATION if goal.index == 2 else RESULT.NONE, "g = 9"
            )
        ),
    )
    statuses = Listener(node, msg.TunerStatus, "status", LATCHED)
    start_tuner("on_failure:=pause")
    client.send(Tune.Goal(evaluations=4))
    for index, why in ((2, "evaluation 1 failed: no beam"), (3, "evaluation 2 failed: g = 9")):
        text = f"paused before evaluation {index}: {why}"
        spin_until(
            lambda text=text: statuses.messages and statuses.messages[-1].message == text,
            text,
        )
        assert services.trigger("resume").success
    assert client.wait().error_code == 0
    assert statuses.messages[-1].failed == 2
    assert statuses.messages[-1].last_failure == "evaluation 2: g = 9"
