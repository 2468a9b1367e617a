"""Double of a machine for tests of clients, with answers and faults that the test defines."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

from rclpy.duration import Duration
from rclpy.node import Node

from mobo_msgs_py import msg
from mobo_msgs_py.action import ApplySetpoint, EvaluateSetpoint
from mobo_msgs_py.srv import DescribeMachine
from mobo_tuner.machine.backend import MEASURING
from mobo_tuner.ros import interfaces
from mobo_tuner.ros.action_server import Goal
from mobo_tuner.ros.conversions import named_values, values_of
from mobo_tuner.ros.waiting import first_of

PERIOD = 0.1  # [s] between two feedback messages of an evaluation that is held
_Result = EvaluateSetpoint.Result


class Answer(NamedTuple):
    """Answer of the double to one goal of `evaluate_setpoint`.

    Attributes:
        diagnostics: Diagnostics by name; a value, or a pair of mean and standard deviation.
        error_code: Error code of `EvaluateSetpoint.Result`.
        error_msg: Reason for the error code.
    """

    diagnostics: Mapping[str, float | tuple[float, float]]
    error_code: int = _Result.NONE
    error_msg: str = ""


class MachineDouble:
    """Serves the interfaces of a machine in a test, on a node that the test spins.

    It reaches every set-point at once and checks nothing. Its attributes define its behaviour and may be
    set at any time; `docs/own_machine.md` shows an example.

    Args:
        node: Node of the test.
        variables: Limits of the variables by name.
        diagnostics: Names of the diagnostics.
        answer: Function that gives the answer to each goal.
        name: Name of the machine.

    Attributes:
        answer: As above.
        goals: Goals of `evaluate_setpoint` so far.
        moves: Goals of `apply_setpoint` so far that have a set-point.
        times: Times of their arrival, by `time.monotonic` [s].
        position: Current set-point; empty before the first goal.
        held: Whether evaluations wait, sending feedback, until this is false or they are canceled.
        silent: Whether evaluations wait without feedback, ignoring cancels.
        ahead: Time by which its clock is ahead [s].
        finishes: Whether a cancel comes too late: an evaluation that is canceled ends with its answer.
        identity: Function that gives the run id, index and attempt that a result carries; by default
            those of the goal.
    """

    def __init__(
        self,
        node: Node,
        variables: Mapping[str, tuple[float, float]],
        diagnostics: Sequence[str],
        answer: Callable[[EvaluateSetpoint.Goal], Answer],
        name: str = "double",
    ) -> None:
        self.answer = answer
        self.goals: list[EvaluateSetpoint.Goal] = []
        self.moves: list[ApplySetpoint.Goal] = []
        self.times: list[float] = []
        self.position: dict[str, float] = {}
        self.held = False
        self.silent = False
        self.finishes = False
        self.ahead = 0.0
        self.identity: Callable[[EvaluateSetpoint.Goal], tuple[str, int, int]] = lambda goal: (
            goal.run_id,
            goal.index,
            goal.attempt,
        )
        self._node = node
        self._description = DescribeMachine.Response(
            name=name,
            variables=[
                msg.Variable(name=n, min=float(low), max=float(high))
                for n, (low, high) in variables.items()
            ],
            diagnostics=[msg.Observable(name=n) for n in diagnostics],
        )
        self._service = interfaces.DESCRIBE_MACHINE.server(node, lambda *_: self._description)
        self._servers = [
            interfaces.EVALUATE_SETPOINT.server(node, self._evaluate),
            interfaces.APPLY_SETPOINT.server(node, self._apply),
        ]

    def close(self) -> None:
        """Disappear like a machine whose node died; a running evaluation never ends."""
        self.silent = True
        for server in self._servers:
            server.close()
        self._node.destroy_service(self._service)

    async def _evaluate(self, goal: Goal) -> EvaluateSetpoint.Result:
        request = goal.request
        self.goals.append(request)
        self.times.append(time.monotonic())
        while self.silent or (self.held and not goal.canceled):
            if not self.silent:
                goal.publish_feedback(phase=MEASURING)
            await first_of(self._node, timeout=PERIOD)
        self.position = values_of(request.setpoint)
        values, code, text = self.answer(request)
        if goal.canceled and not self.finishes:
            values, code, text = {}, _Result.CANCELED, "a client stopped the machine"
        run_id, index, attempt = self.identity(request)
        pairs = {n: v if isinstance(v, tuple) else (v, math.nan) for n, v in values.items()}
        return EvaluateSetpoint.Result(
            run_id=run_id,
            index=index,
            attempt=attempt,
            shots=1,
            readbacks=list(request.setpoint),
            diagnostics=named_values(
                {n: mean for n, (mean, _) in pairs.items()},
                {},
                {n: stddev for n, (_, stddev) in pairs.items()},
            ),
            stamp=(self._node.get_clock().now() + Duration(seconds=self.ahead)).to_msg(),
            error_code=code,
            error_msg=text,
        )

    async def _apply(self, goal: Goal) -> ApplySetpoint.Result:
        if goal.request.setpoint:
            self.moves.append(goal.request)
            self.position = values_of(goal.request.setpoint)
        return ApplySetpoint.Result(
            readbacks=named_values(self.position, {}), stamp=self._node.get_clock().now().to_msg()
        )
