"""A machine of plain functions: what it may do wrong, and how each ends."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator, Mapping
from typing import Any

import pytest
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node

from mobo_msgs_py import msg
from mobo_msgs_py.action import EvaluateSetpoint
from mobo_tuner.machine.backend import Failure, Measurement, Operation
from mobo_tuner.machine.ramp import RampedVariable, RampSettings
from mobo_tuner.machine.simple import SimpleMachine

RESULT = EvaluateSetpoint.Result
Spin = Callable[..., None]


class Lab(SimpleMachine):
    """One supply that follows at once, and a screen; each function does what the test says."""

    def __init__(self, node: Node, executor: SingleThreadedExecutor) -> None:
        self.current = 0.0
        self.written: list[float] = []
        self.forbids = ""
        self.fault: Callable[[str], None] = lambda _: None
        self.offset = 0.0
        self.shots_taken = 0
        super().__init__(
            node,
            executor,
            name="lab",
            variables=[
                RampedVariable(
                    name="q", unit="A", minimum=-1.0, maximum=1.0, max_step=0.25, slew=100.0,
                    tolerance=0.01,
                )
            ],
            diagnostics={"size": "mm"},
            settings=RampSettings(rate=50.0, settle_time=0.05, settle_timeout=0.3),
            shots=3,
            timeout=0.5,
            shot_timeout=0.5,
        )  # fmt: skip

    def write(self, setpoint: Mapping[str, float]) -> None:
        self.fault("write")
        self.written.append(setpoint["q"])
        self.current = setpoint["q"]

    def read(self) -> Mapping[str, float]:
        self.fault("read")
        return {"q": self.current + self.offset}

    def shot(self) -> Mapping[str, float]:
        self.shots_taken += 1
        self.fault("shot")
        return {"size": 2.0 + self.shots_taken}

    def interlock(self) -> str:
        return self.forbids


@pytest.fixture
def lab(node: Node, executor: SingleThreadedExecutor, spin_until: Spin) -> Iterator[Lab]:
    lab = Lab(node, executor)
    spin_until(lambda: lab.refusal() is None, "the first reading")
    yield lab
    lab.close()


@pytest.fixture
def run(executor: SingleThreadedExecutor, spin_until: Spin) -> Callable[..., Any]:
    def run(function: Callable[..., Any], *arguments: Any) -> Any:
        task = executor.create_task(function, *arguments)
        spin_until(task.done, "the end of a coroutine")
        return task.result()

    return run


@pytest.fixture
def operation(lab: Lab, executor: SingleThreadedExecutor) -> Operation:
    critical = [msg.Constraint(name="size", min=-math.inf, max=100.0)]
    return Operation(executor, lab.hold, critical)


def breaks(where: str, act: Callable[[], None]) -> Callable[[str], None]:
    """A fault in one function alone."""
    return lambda function: act() if function == where else None


def fails() -> None:
    raise OSError("no answer from 10.0.0.7")


def hangs() -> None:
    time.sleep(0.8)  # longer than any of the time limits


def test_it_ramps_and_averages(lab: Lab, operation: Operation, run: Callable[..., Any]) -> None:
    assert run(lab.move, {"q": 1.0}, operation) is None
    assert lab.written == [0.25, 0.5, 0.75, 1.0]
    measured: Measurement = run(lab.measure, 0, operation)
    assert (measured.failure, measured.shots) == (None, 3)
    (size,) = measured.diagnostics
    assert (size.value, size.unit) == (4.0, "mm")
    assert size.stddev == pytest.approx(1.0 / math.sqrt(3.0))
    (q,) = measured.readbacks
    assert q.value == 1.0


@pytest.mark.parametrize(
    ("fault", "code", "word"),
    [
        (breaks("write", fails), RESULT.MACHINE_LOST, "OSError: no answer from 10.0.0.7"),
        (breaks("write", hangs), RESULT.MACHINE_LOST, "within 0.5 s"),
        (breaks("read", fails), RESULT.MACHINE_LOST, "OSError: no answer from 10.0.0.7"),
    ],
)
def test_a_fault_ends_a_move(
    lab: Lab,
    operation: Operation,
    run: Callable[..., Any],
    fault: Callable[[str], None],
    code: int,
    word: str,
) -> None:
    lab.fault = fault
    failure = run(lab.move, {"q": 1.0}, operation)
    assert (failure.code, word in failure.message) == (code, True), failure
    assert len(lab.written) < 2


def test_a_readback_that_does_not_follow_times_out(
    lab: Lab, operation: Operation, run: Callable[..., Any]
) -> None:
    lab.offset = 0.02
    failure = run(lab.move, {"q": 0.2}, operation)
    assert failure.code == RESULT.TIMEOUT
    assert "q reads 0.22 A, which is not within 0.01 of its set-point 0.2" in failure.message


@pytest.mark.parametrize(
    ("fault", "code", "word"),
    [
        (breaks("shot", fails), RESULT.INVALID_MEASUREMENT, "OSError"),
        (breaks("shot", hangs), RESULT.TIMEOUT, "longer than 0.5 s"),
    ],
)
def test_a_fault_ends_a_measurement(
    lab: Lab,
    operation: Operation,
    run: Callable[..., Any],
    fault: Callable[[str], None],
    code: int,
    word: str,
) -> None:
    assert run(lab.move, {"q": 0.0}, operation) is None
    lab.fault = fault
    measured = run(lab.measure, 2, operation)
    assert (measured.failure.code, measured.shots) == (code, 0)
    assert word in measured.failure.message


def test_a_shot_beyond_a_critical_limit_is_the_last(
    lab: Lab, operation: Operation, run: Callable[..., Any]
) -> None:
    assert run(lab.move, {"q": 0.0}, operation) is None
    lab.shots_taken = 97
    measured = run(lab.measure, 50, operation)
    assert operation.failure is not None
    assert operation.failure.code == RESULT.VIOLATION
    assert (measured.failure, measured.shots) == (None, 2)


def test_an_interlock_stops_the_ramp_where_it_is_and_forbids_the_next(
    lab: Lab, operation: Operation, executor: SingleThreadedExecutor, spin_until: Spin
) -> None:
    lab.ramped = {
        "q": RampedVariable(
            name="q", minimum=-1.0, maximum=1.0, max_step=0.01, slew=100.0, tolerance=0.01
        )
    }
    task = executor.create_task(lab.move, {"q": 1.0}, operation)
    spin_until(lambda: len(lab.written) > 5, "the ramp")
    lab.forbids = "the vacuum is bad"
    spin_until(task.done, "the end of the ramp")
    assert operation.failure == Failure(RESULT.INTERLOCK, "the vacuum is bad")
    assert lab.current < 0.9
    assert lab.refusal() == Failure(RESULT.INTERLOCK, "the vacuum is bad")
    lab.forbids = ""
    spin_until(lambda: lab.refusal() is None, "the machine to be free again")


def test_a_machine_that_cannot_be_read_is_lost_until_it_can(lab: Lab, spin_until: Spin) -> None:
    lab.fault = breaks("read", fails)
    spin_until(lambda: lab.refusal() is not None, "the loss")
    refusal = lab.refusal()
    assert refusal is not None
    assert refusal.code == RESULT.MACHINE_LOST
    assert "no answer from 10.0.0.7" in refusal.message
    assert math.isnan(next(iter(lab.readbacks())).value)
    lab.fault = lambda _: None
    spin_until(lambda: lab.refusal() is None, "the machine to return")


def test_a_variable_that_somebody_moved_is_not_moved_on(
    lab: Lab, operation: Operation, run: Callable[..., Any], spin_until: Spin
) -> None:
    assert run(lab.move, {"q": 0.0}, operation) is None
    lab.current = 0.9
    spin_until(lambda: lab.refusal() is not None, "the refusal")
    refusal = lab.refusal()
    assert refusal is not None
    assert refusal.code == RESULT.INTERLOCK
    assert "q reads 0.9 A, but was set to 0 A" in refusal.message
