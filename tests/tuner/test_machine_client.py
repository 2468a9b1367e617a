"""What the tuner asks of a machine that takes its time: nothing before what was stopped has ended."""

from __future__ import annotations

import math
from collections.abc import Callable, Coroutine, Mapping
from typing import Any

import pytest
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.task import Future

from mobo_msgs_py import msg
from mobo_msgs_py.action import ApplySetpoint, EvaluateSetpoint
from mobo_tuner.machine.backend import RAMPING, Failure, MachineBackend, Measurement, Operation
from mobo_tuner.machine.server import MachineServer
from mobo_tuner.ros.waiting import first_of
from mobo_tuner.tuner.machine_client import (
    CANCEL_TIMEOUT,
    Answer,
    MachineClient,
    MachineLostError,
)

RESULT = EvaluateSetpoint.Result
TIME_TO_STOP = 2.0 * CANCEL_TIMEOUT


class SluggishMachine(MachineBackend):
    """Never arrives at x = 1, goes anywhere else at once, and is slow to end what was stopped."""

    name = "sluggish"
    variables = (msg.Variable(name="x", min=0.0, max=1.0),)
    diagnostics = ()
    max_shots = 1

    def __init__(self, node: Node) -> None:
        self._node = node
        self.x = 0.0
        self.ramping = False

    def refusal(self) -> Failure | None:
        return None

    def readbacks(self) -> list[msg.NamedValue]:
        return [msg.NamedValue(name="x", value=self.x)]

    async def move(self, setpoint: Mapping[str, float], operation: Operation) -> Failure | None:
        if setpoint["x"] == 1.0:
            self.ramping = True
            operation.progress(RAMPING, 0.5)
            await first_of(self._node, operation.interrupt, timeout=20.0)
            await first_of(self._node, timeout=TIME_TO_STOP)
            self.ramping = False
        else:
            self.x = setpoint["x"]
        return None

    async def measure(self, shots: int, operation: Operation) -> Measurement:
        del shots, operation
        return Measurement()

    def hold(self) -> None:
        """It stands still all the time."""


@pytest.fixture
def machine(node: Node, executor: SingleThreadedExecutor) -> SluggishMachine:
    machine = SluggishMachine(node)
    MachineServer(node, machine, executor)
    return machine


@pytest.fixture
def client(machine: SluggishMachine, node: Node, run: Callable[..., Any]) -> MachineClient:
    del machine  # must be there to be met
    client = MachineClient(node, silence_timeout=5.0, evaluation_timeout=30.0)
    run(client.describe(10.0))
    return client


@pytest.fixture
def run(executor: SingleThreadedExecutor, spin_until: Callable[..., None]) -> Callable[..., Any]:
    """Run a coroutine on the test's executor, to its end."""

    def run(coroutine: Coroutine[Any, Any, Any]) -> Any:
        async def carry_out() -> Any:
            return await coroutine

        task = executor.create_task(carry_out)
        spin_until(task.done, "the end of a coroutine")
        return task.result()

    return run


def point(x: float) -> list[msg.NamedValue]:
    return [msg.NamedValue(name="x", value=x)]


def move(x: float) -> ApplySetpoint.Goal:
    return ApplySetpoint.Goal(setpoint=point(x))


async def stopped(
    client: MachineClient, machine: SluggishMachine, node: Node, early: bool
) -> Answer:
    """An evaluation that is interrupted on its way, or before the machine has even accepted it."""
    interrupt: Future = Future(executor=node.executor)

    def watch() -> None:
        if (early or machine.ramping) and not interrupt.done():
            interrupt.set_result(None)

    timer = node.create_timer(0.001 if early else 0.05, watch)
    try:
        goal = EvaluateSetpoint.Goal(run_id="run", setpoint=point(1.0))
        return await client.evaluate(goal, lambda _: None, interrupt)
    finally:
        node.destroy_timer(timer)


@pytest.mark.parametrize("early", [False, True], ids=["on its way", "before it was accepted"])
def test_what_was_stopped_has_ended_before_the_machine_is_asked_for_more(
    machine: SluggishMachine,
    client: MachineClient,
    node: Node,
    run: Callable[..., Any],
    early: bool,
) -> None:
    assert run(stopped(client, machine, node, early)).error_code == RESULT.CANCELED
    answer = run(client.apply(move(0.25), lambda _: None))
    assert (answer.error_code, answer.error_msg) == (RESULT.NONE, "")
    assert machine.x == 0.25


def test_a_machine_is_sent_off_once_what_was_stopped_has_ended(
    machine: SluggishMachine,
    client: MachineClient,
    node: Node,
    run: Callable[..., Any],
    spin_until: Callable[..., None],
) -> None:
    assert run(stopped(client, machine, node, early=False)).error_code == RESULT.CANCELED
    assert machine.ramping
    assert run(client.send_off(move(0.5), timeout=4.0))
    spin_until(lambda: machine.x == 0.5, "the move")


def test_nothing_is_asked_for_once_interrupted(
    client: MachineClient, node: Node, run: Callable[..., Any]
) -> None:
    interrupt: Future = Future(executor=node.executor)
    interrupt.set_result(None)
    answer = run(client.apply(move(0.5), lambda _: None, interrupt))
    assert answer.error_code == RESULT.CANCELED
    assert run(client.where()) == {"x": 0.0}


def test_a_machine_that_has_just_started_is_asked_again_where_it_is(
    machine: SluggishMachine, client: MachineClient, node: Node, run: Callable[..., Any]
) -> None:
    machine.x = math.nan
    with pytest.raises(MachineLostError, match="where it is"):
        run(client.where())
    asked: list[None] = []
    readbacks = machine.readbacks

    def third_time() -> list[msg.NamedValue]:
        asked.append(None)
        machine.x = 0.25 if len(asked) > 2 else math.nan
        return readbacks()

    machine.readbacks = third_time  # type: ignore[method-assign]
    assert run(client.where(patience=20.0)) == {"x": 0.25}
    interrupt: Future = Future(executor=node.executor)
    interrupt.set_result(None)
    assert run(client.where(interrupt, patience=20.0)) is None
