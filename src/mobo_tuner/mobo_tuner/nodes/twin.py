"""A worker of a campaign whose points are evaluated by a machine's node.

`python -m mobo_tuner.nodes.twin FOLDER --ros-args -r __ns:=/stand_a` joins the campaign in that folder, which
listens for workers, and has its points evaluated one at a time by the machine of its namespace. Several of them,
each in the namespace of a machine, keep several machines busy: twins of a simulation server, or test stands.
A machine that is lost gives its point back, for another one, and joins again when it has returned.
"""

from __future__ import annotations

import argparse
import math
import secrets
import signal
import sys
import time
from collections.abc import Callable, Coroutine, Mapping, Sequence
from pathlib import Path
from typing import Any, NoReturn, TypeVar

import rclpy
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from rclpy.task import Future
from rclpy.utilities import remove_ros_args

from mobo_msgs_py.action import EvaluateSetpoint
from mobo_tuner.core import Problem
from mobo_tuner.errors import UserError
from mobo_tuner.offline import worker
from mobo_tuner.offline.hosts import FILE_NAME
from mobo_tuner.offline.simulation import Outcome
from mobo_tuner.ros.executor_thread import ExecutorThread
from mobo_tuner.ros.process import exit_process
from mobo_tuner.ros.waiting import STEADY_CLOCK
from mobo_tuner.tuner.gate import EvaluationRequest, Gate
from mobo_tuner.tuner.machine_client import Answer, MachineClient, MachineLostError
from mobo_tuner.tuner.messages import constraint_messages, machine_facts
from mobo_tuner.tuner.topics import Heartbeat

_CLIENT_TIMEOUT = 5.0  # [s] after which a machine holds, if this process is lost
_LOOK = 5.0  # [s] for which a machine is looked for before the campaign is looked for again
_CODES = EvaluateSetpoint.Result
_OF_THE_POINT = (_CODES.TIMEOUT, _CODES.INVALID_MEASUREMENT, _CODES.VIOLATION)

T = TypeVar("T")


class Twin:
    """The machine of one namespace, as the work of a campaign's worker.

    Args:
        node: Node in the machine's namespace.
        thread: Thread of its executor.
        run_id: Id of the campaign's run.
        silence: Silence of the machine after which it counts as lost [s].
    """

    def __init__(self, node: Node, thread: ExecutorThread, run_id: str, silence: float) -> None:
        self._node, self._thread = node, thread
        # A machine refuses what is older than what it had last: the id is of this worker alone.
        self._run_id = f"{run_id}-{secrets.token_hex(4)}"
        self._count = 0
        self._client = thread.call(MachineClient, node, silence, math.inf)
        self._beating = thread.call(Heartbeat, node, _CLIENT_TIMEOUT).of(self._run_id)
        thread.call(self._beating.__enter__)
        self._interrupt: Future | None = None

    def find(self) -> bool:
        """Return whether the machine answers within some seconds."""
        try:
            return self._wait(lambda: self._client.describe(_LOOK)) is not None
        except MachineLostError:
            return False

    def begin(self, task: Mapping[str, Any]) -> worker.Evaluate:
        """Take on the task of a campaign.

        Raises:
            UserError: If the machine does not suit the problem, or does not answer any more.
        """
        problem = Problem.from_dict(task["problem"])
        gate = Gate(self._client, bounds=lambda: problem)
        try:
            machine = self._wait(lambda: gate.describe(_LOOK))
        except MachineLostError as error:
            raise UserError(str(error)) from None
        assert machine is not None  # nothing interrupts it
        machine_facts(machine).check(problem)
        self._node.get_logger().info(f"'{machine.name}' has joined the campaign")
        self._interrupt = interrupt = Future(executor=self._node.executor)
        critical = constraint_messages(problem, critical_only=True)

        async def carry_out(point: Mapping[str, float]) -> Answer | None:
            """Return the machine's answer; None if it took too long."""
            self._count += 1
            request = EvaluationRequest(
                run_id=self._run_id,
                index=self._count,
                attempt=0,
                setpoint=point,
                critical=critical,
                client_timeout=_CLIENT_TIMEOUT,
            )
            late = Future(executor=self._node.executor)
            timer = self._node.create_timer(
                task["timeout"], lambda: late.done() or late.set_result(None), clock=STEADY_CLOCK
            )
            try:
                answer = await gate.evaluate(
                    request, problem.units, lambda _: None, interrupt, late
                )
            finally:
                self._node.destroy_timer(timer)
            return None if late.done() else answer

        def evaluate(_number: int, point: Mapping[str, float]) -> Outcome | None:
            started = time.monotonic()
            try:
                answer = self._wait(lambda: carry_out(point))
            except MachineLostError as error:
                return self._given_back(str(error))
            seconds = time.monotonic() - started
            if answer is None:
                return Outcome({}, seconds, f"the evaluation took more than {task['timeout']:g} s")
            if answer.error_code == _CODES.NONE:
                means = {name: mean for name, (mean, _) in answer.diagnostics.items()}
                return Outcome(means, seconds, "")
            if answer.error_code in _OF_THE_POINT:
                return Outcome({}, seconds, answer.error_msg)
            return self._given_back(answer.error_msg)

        return evaluate

    def stop(self) -> None:
        """Stop what is being evaluated."""
        interrupt = self._interrupt
        if interrupt is not None and not interrupt.done():
            self._thread.call(interrupt.set_result, None)

    def close(self) -> None:
        """End the heartbeat, so that the machine knows that the end is intended."""
        self._thread.call(self._beating.__exit__, None, None, None)

    def _given_back(self, reason: str) -> Outcome | None:
        """Log why a point is given back, and give it back."""
        self._node.get_logger().warning(f"a point is given back: {reason}")
        return None

    def _wait(self, begin: Callable[[], Coroutine[Any, Any, T]]) -> T:
        """Return the result of a coroutine on the executor's thread, or raise its error."""

        async def carry_out() -> Callable[[], T]:
            try:
                result = await begin()
            except (MachineLostError, UserError) as error:  # for this thread, not the executor's
                found = error
                return lambda: _raise(found)
            return lambda: result

        executor = self._node.executor
        assert executor is not None
        give: Callable[[], T] = self._thread.start(lambda: executor.create_task(carry_out)).result()
        return give()


def _raise(error: Exception) -> NoReturn:
    raise error


def work(twin: Twin, folder: Path, patience: float) -> None:
    """Work for the campaign of a folder until it ends.

    Args:
        twin: Machine that evaluates.
        folder: Folder of the run.
        patience: Longest wait for the machine and for the campaign, each at the start [s].

    Raises:
        UserError: If one of the two is not there in time, or the machine does not suit.
    """
    deadline, joined = time.monotonic() + patience, False
    while True:
        while not twin.find():
            if joined and not (folder / FILE_NAME).exists():
                return
            if not joined and time.monotonic() > deadline:
                raise UserError(f"no machine answered within {patience:g} s")
        if joined and not (folder / FILE_NAME).exists():
            return
        with worker.join(folder, patience) as campaign:
            if worker.serve(campaign, twin):
                return
        joined = True


def main(arguments: Sequence[str] | None = None) -> int:
    """Work for one campaign; return the exit status."""
    words = list(sys.argv[1:] if arguments is None else arguments)
    parser = argparse.ArgumentParser(
        prog="mobo_tuner.nodes.twin", description="Have a campaign's points evaluated by a machine."
    )
    parser.add_argument("folder", type=Path, help="folder of the campaign's run")
    parser.add_argument(
        "--patience",
        type=worker.seconds,
        default=300.0,
        help="longest wait for machine and campaign [s]",
    )
    parser.add_argument(
        "--machine-timeout",
        type=worker.seconds,
        default=5.0,
        help="silence that means a lost machine [s]",
    )
    options = parser.parse_args(remove_ros_args(["twin", *words])[1:])
    context = Context()
    rclpy.init(args=words, context=context, signal_handler_options=SignalHandlerOptions.NO)
    node = Node("twin", context=context)
    executor = SingleThreadedExecutor(context=context)
    executor.add_node(node)
    thread = ExecutorThread(executor, spin=True)
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.default_int_handler)
    try:
        twin = Twin(node, thread, options.folder.name, options.machine_timeout)
        try:
            work(twin, options.folder, options.patience)
        finally:
            twin.close()
    except (UserError, EOFError, OSError) as error:
        print(error, file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        return 130
    finally:
        thread.close()
        node.destroy_node()
        context.try_shutdown()
    return 0


if __name__ == "__main__":
    exit_process(main())
