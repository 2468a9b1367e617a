"""What a run does after an answer or an evaluation, decided without any process."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import pytest

from mobo_msgs_py.action import EvaluateSetpoint
from mobo_tuner.tuner.machine_client import Answer
from mobo_tuner.tuner.parameters import TUNER, TunerParameters, tuner_specs
from mobo_tuner.tuner.run.attempts import LONGEST_DELAY, Decision, Loss, decide
from mobo_tuner.tuner.run.loop import Verdict, judge
from tests.runs.test_records import EVALUATION

CODES = EvaluateSetpoint.Result
FAILURES = (CODES.TIMEOUT, CODES.INVALID_MEASUREMENT, CODES.UNKNOWN)


def parameters(**changes: Any) -> TunerParameters:
    values: Mapping[str, Any] = {spec.name: spec.default for spec in tuner_specs({})}
    return TunerParameters.from_values({**values, **changes})


def answer(code: int) -> Answer:
    return Answer(code, "why", 0.0)


class Clock:
    """A clock that the test sets."""

    def __init__(self) -> None:
        self.now = 100.0

    def __call__(self) -> float:
        return self.now


@pytest.mark.parametrize("code", [CODES.MACHINE_LOST, CODES.CLIENT_LOST])
def test_a_lost_machine_is_waited_for_and_costs_no_attempt(code: int) -> None:
    for tries in (1, 99):
        decision = decide(answer(code), tries, Loss(60.0), parameters())
        assert decision == Decision("wait", counts=False)


OBSTACLES = {
    "on_fault": (CODES.MACHINE_LOST, CODES.CLIENT_LOST),
    "on_interlock": (CODES.INTERLOCK, CODES.NOT_ACTIVE),
}


@pytest.mark.parametrize(
    ("policy", "code"), [(policy, code) for policy, codes in OBSTACLES.items() for code in codes]
)
def test_what_keeps_the_machine_from_moving_is_handled_by_one_scheme(
    policy: str, code: int
) -> None:
    def decisions(choice: str) -> list[Decision]:
        given = parameters(**{policy: choice}, max_attempts=3, retry_delay=0.5, on_failure="abort")
        return [decide(answer(code), tries, Loss(60.0), given) for tries in (1, 2, 3)]

    assert decisions("wait") == [Decision("wait", counts=False)] * 3
    assert decisions("pause") == [Decision("pause", counts=False)] * 3
    assert decisions("abort") == [Decision("fail")] * 3
    assert decisions("retry") == [Decision("again", 0.5), Decision("again", 1.0), Decision("fail")]
    assert parameters().values[policy] == "wait"


def test_a_failure_is_asked_about() -> None:
    for code in (CODES.TIMEOUT, CODES.INVALID_MEASUREMENT):
        decision = decide(answer(code), 1, Loss(60.0), parameters(on_failure="ask"))
        assert decision == Decision("pause", counts=False)
    assert judge(BAD, 1, parameters(on_failure="ask")).action == "continue"


@pytest.mark.parametrize("code", [CODES.BUSY, CODES.INTERLOCK, CODES.NOT_ACTIVE])
def test_a_machine_that_has_just_returned_may_not_be_ready(code: int) -> None:
    loss = Loss(60.0)
    loss.begin()
    given = parameters(on_interlock="abort", max_attempts=1)
    assert decide(answer(code), 5, loss, given) == Decision("again", 1.0, counts=False)
    loss.end()
    assert decide(answer(code), 5, loss, given).action == "fail"


@pytest.mark.parametrize("code", FAILURES)
def test_a_failure_is_learned_from_or_retried_as_the_policy_says(code: int) -> None:
    loss = Loss(60.0)
    assert decide(answer(code), 1, loss, parameters(on_failure="skip")).action == "accept"
    patient = parameters(on_failure="retry", max_attempts=3, retry_delay=0.5)
    delays = [decide(answer(code), tries, loss, patient) for tries in (1, 2, 3)]
    assert delays == [Decision("again", 0.5), Decision("again", 1.0), Decision("accept")]


def test_delays_between_attempts_double_up_to_a_limit() -> None:
    patient = parameters(on_failure="retry", max_attempts=100, retry_delay=3.0)
    delays = [decide(answer(CODES.TIMEOUT), n, Loss(0.0), patient).delay for n in range(1, 12)]
    assert delays[:4] == [3.0, 6.0, 12.0, 24.0]
    assert delays[-1] == LONGEST_DELAY


@pytest.mark.parametrize("code", [CODES.INVALID_SETPOINT, CODES.CANCELED])
def test_what_no_retry_can_change_ends_the_run(code: int) -> None:
    assert decide(answer(code), 1, Loss(0.0), parameters(on_failure="retry")).action == "fail"


def test_a_busy_machine_is_tried_again_whatever_the_policy() -> None:
    impatient = parameters(on_failure="skip", max_attempts=2)
    assert decide(answer(CODES.BUSY), 1, Loss(0.0), impatient).action == "again"
    assert decide(answer(CODES.BUSY), 2, Loss(0.0), impatient).action == "fail"


def test_a_violation_is_an_evaluation() -> None:
    assert decide(answer(CODES.VIOLATION), 1, Loss(0.0), parameters()).action == "accept"


def test_a_loss_lasts_until_the_machine_works_again_or_patience_ends() -> None:
    clock = Clock()
    loss = Loss(30.0, clock)
    assert (loss.active, loss.remaining()) == (False, 0.0)
    assert loss.begin()
    clock.now += 10.0
    assert not loss.begin()  # the same loss
    assert (loss.active, loss.remaining()) == (True, 20.0)
    clock.now += 25.0
    assert (loss.active, loss.remaining()) == (False, 0.0)
    assert loss.end() == 35.0  # how long it did not work
    assert loss.end() is None


def test_a_machine_that_comes_and_goes_is_not_waited_for_without_end() -> None:
    clock = Clock()
    loss = Loss(30.0, clock)
    assert loss.begin()
    assert loss.told("no permit") == "no permit"
    for count in range(2, 32):
        clock.now += 1.0  # for which it forbids to move
        assert loss.end() == 1.0
        clock.now += 0.5  # for which it does not
        assert loss.begin()
        assert loss.count == count
        assert loss.remaining() == 31 - count
    assert not loss.active
    assert loss.told("no permit") == "no permit, 31 times in this evaluation"


def test_the_node_s_parameters_are_attributes_of_the_right_types() -> None:
    made = parameters()
    names = {spec.name for spec in TUNER}
    for name, value in vars(made).items():
        if name != "values":
            assert name in names
            assert value == made.values[name]
    made.update({"evaluations": 7})
    assert (made.evaluations, made.values["evaluations"]) == (7, 7)
    assert parameters(journal=False).run_dir("run") is None


GOOD = replace(EVALUATION, valid=True, error_code=CODES.NONE, error_msg="")
BAD = replace(EVALUATION, valid=False, error_code=CODES.TIMEOUT, error_msg="no beam")


def test_a_good_evaluation_lets_the_run_continue() -> None:
    assert judge(GOOD, 0, parameters(on_failure="abort")) == Verdict("continue")


def test_a_failed_evaluation_ends_the_run_where_the_policy_says_so() -> None:
    verdict = judge(BAD, 1, parameters(on_failure="abort"))
    assert verdict.action == "end"
    assert "no beam" in verdict.reason
    assert judge(BAD, 1, parameters(on_failure="skip")) == Verdict("continue")


def test_too_many_failures_in_a_row_end_the_run() -> None:
    limit = parameters(max_consecutive_failures=4)
    assert judge(BAD, 3, limit).action == "continue"
    assert judge(BAD, 4, limit).action == "end"


def test_skipping_is_not_a_failure() -> None:
    skipped = replace(BAD, error_code=CODES.CANCELED)
    assert judge(skipped, 99, parameters(on_failure="abort")) == Verdict("continue")


def test_a_violation_pauses_the_run_where_the_policy_says_so() -> None:
    violation = replace(BAD, error_code=CODES.VIOLATION)
    assert judge(violation, 1, parameters(pause_on_violation=True)).action == "pause"
    assert judge(violation, 1, parameters()).action == "continue"
    assert judge(BAD, 1, parameters(pause_on_violation=True)).action == "continue"


def test_a_pause_has_its_reason() -> None:
    verdict = judge(BAD, 1, parameters(on_failure="pause"))
    assert verdict == Verdict("pause", f"evaluation {BAD.index} failed: no beam")
