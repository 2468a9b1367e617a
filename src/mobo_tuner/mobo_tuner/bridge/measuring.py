"""Measurement of the diagnostics of a mapping, by messages or calls, with or without a trigger."""

from __future__ import annotations

import math
import time
from collections.abc import Awaitable, Callable
from functools import partial

from rclpy.executors import Executor
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.task import Future

from mobo_msgs_py import msg
from mobo_msgs_py.action import EvaluateSetpoint
from mobo_tuner.bridge.calls import Call, CallError, check, create, load
from mobo_tuner.bridge.interface_types import fill
from mobo_tuner.bridge.mapping import Diagnostic, Endpoint, MachineMapping
from mobo_tuner.bridge.signals import Signal, Signals, check_fields
from mobo_tuner.machine.averaging import average
from mobo_tuner.machine.backend import MEASURING, Failure, Measurement, Operation
from mobo_tuner.ros.conversions import seconds

Wait = Callable[[Operation, Future | None, float], Awaitable[bool]]
"""Waits for a future with a timeout [s]; an interrupt of the operation ends the wait."""

_Result = EvaluateSetpoint.Result


class Measuring:
    """Measures the diagnostics of one machine, all at the same time.

    Args:
        node: Node that communicates with the machine.
        mapping: Mapping of the machine.
        signals: Signals of the node.
        executor: Executor that runs the coroutines.
        wait: Function by which a coroutine waits.

    Raises:
        MappingError: If the mapping does not fit the installed types.
    """

    def __init__(
        self,
        node: Node,
        mapping: MachineMapping,
        signals: Signals,
        executor: Executor,
        wait: Wait,
    ) -> None:
        self._mapping = mapping
        self._executor = executor
        self._wait = wait
        self._clock = node.get_clock()
        self._signals: dict[str, Signal] = {}
        self._calls: dict[str, Call] = {}
        for name, diagnostic in mapping.diagnostics.items():
            if diagnostic.read.target.kind == "topic":
                self._signals[name] = signals.number(diagnostic.read)
            else:
                self._calls[name] = Call(node, diagnostic.read)
                check_fields(diagnostic.read, self._calls[name].answer_type)
                self._signals[name] = Signal(self._clock, diagnostic.read, diagnostic.read.value)
        self._fire = None if mapping.fire is None else _Fire(node, mapping.fire)

    def problems(self) -> list[str]:
        """Return the services and actions that are missing, in a few words each."""
        targets = [(c.ready, self._mapping.diagnostics[n].read) for n, c in self._calls.items()]
        if self._fire is not None:
            targets.append((self._fire.ready, self._fire.endpoint))
        return [f"the {endpoint.target} is not there" for ready, endpoint in targets if not ready]

    async def measure(self, shots: int, operation: Operation) -> Measurement:
        """Measure; `shots` = 0 uses the mapping's number.

        The operation sees every shot. If it is interrupted, the shots so far are returned.
        """
        operation.progress(MEASURING, 0.0)
        self._forget_the_past()
        collectors = [
            _Collector(diagnostic, self._signals[name], shots, operation)
            for name, diagnostic in self._mapping.diagnostics.items()
        ]
        try:
            if self._fire is None:
                failure = await self._collect(collectors, operation)
            else:
                failure = await self._fire_and_collect(collectors, shots, operation)
        finally:
            for collector in collectors:
                collector.close()
        diagnostics = []
        for collector in collectors:
            diagnostic = collector.diagnostic
            if not collector.shots:
                continue
            value, stddev = average(collector.shots, diagnostic.outliers, diagnostic.statistic)
            diagnostics.append(
                msg.NamedValue(
                    name=diagnostic.name, value=value, stddev=stddev, unit=diagnostic.unit
                )
            )
            if failure is None and math.isnan(value):
                failure = Failure(
                    _Result.INVALID_MEASUREMENT,
                    f"{diagnostic.name} could not be measured: the {diagnostic.read.target} gave "
                    f"no number{collector.signal.because}",
                )
        count = min(len(collector.shots) for collector in collectors)
        return Measurement(diagnostics=diagnostics, shots=count, failure=failure)

    def _forget_the_past(self) -> None:
        """Ignore messages with stamps before now."""
        for signal in self._signals.values():
            signal.not_before = seconds(self._clock.now().to_msg())

    async def _fire_and_collect(
        self, collectors: list[_Collector], shots: int, operation: Operation
    ) -> Failure | None:
        """Fire the shots one by one, and wait for all diagnostics of each."""
        assert self._fire is not None
        rounds = shots or self._mapping.shots
        for number in range(1, rounds + 1):
            # Listen first: a shot may arrive before the response of the trigger.
            for collector in collectors:
                collector.want(number)
            self._forget_the_past()
            try:
                await self._fire(partial(self._wait, operation))
            except CallError as error:
                return _call_failure(error, "no shot was fired")
            failure = await self._collect(collectors, operation)
            if failure is not None or operation.interrupt.done():
                return failure
            operation.progress(MEASURING, number / rounds)
        return None

    async def _collect(self, collectors: list[_Collector], operation: Operation) -> Failure | None:
        """Wait until all collectors are complete; return the failure of one that is not."""
        tasks = [
            self._executor.create_task(self._call, collector, operation)
            if collector.diagnostic.name in self._calls
            else self._executor.create_task(self._listen, collector, operation)
            for collector in collectors
        ]
        failures = []
        for task in tasks:
            # Each ends by its time limit, or when the operation is interrupted.
            failures.append(await task)
            if self._fire is None:
                part = min(collector.fraction for collector in collectors)
                operation.progress(MEASURING, part)
        return next((failure for failure in failures if failure is not None), None)

    async def _listen(self, collector: _Collector, operation: Operation) -> Failure | None:
        """Wait for the messages of a collector."""
        read = collector.diagnostic.read
        collector.start()
        while not collector.complete and not operation.interrupt.done():
            silence = time.monotonic() - collector.heard
            if silence >= read.timeout:
                return Failure(
                    _Result.TIMEOUT,
                    f"{collector.diagnostic.name}: the {read.target} gave no value within "
                    f"{read.timeout:g} s{collector.signal.because}",
                )
            await self._wait(
                operation, collector.advanced, min(read.timeout - silence, collector.remaining)
            )
        return None

    async def _call(self, collector: _Collector, operation: Operation) -> Failure | None:
        """Call until a collector is complete."""
        call = self._calls[collector.diagnostic.name]
        collector.start()
        while not collector.complete and not operation.interrupt.done():
            try:
                answer = await call(partial(self._wait, operation))
            except CallError as error:
                return _call_failure(error, collector.diagnostic.name)
            collector.take(collector.signal.value_of(answer))
        return None


class _Collector:
    """The shots of one diagnostic: a number of shots, or those within a time."""

    def __init__(
        self, diagnostic: Diagnostic, signal: Signal, shots: int, operation: Operation
    ) -> None:
        self.diagnostic = diagnostic
        self.signal = signal
        self.shots: list[float] = []
        self.heard = time.monotonic()  # arrival of the last shot
        self.advanced: Future = Future(
            executor=operation.executor
        )  # done when the next shot arrives
        self._operation = operation
        self._count = shots or diagnostic.count
        self._started = self.heard
        self._wanted = self._count
        signal.listeners.append(self.take)

    @property
    def complete(self) -> bool:
        """Whether all shots have arrived."""
        if self._count == 0:
            return self.remaining <= 0.0 and len(self.shots) > 0
        return len(self.shots) >= self._wanted

    @property
    def remaining(self) -> float:
        """Remaining time of the average [s]; infinite if a number of shots is averaged."""
        if self._count > 0:
            return math.inf
        left = self._started + self.diagnostic.seconds - time.monotonic()
        # Time is up without a shot: the next one will do.
        return left if left > 0.0 or self.shots else math.inf

    @property
    def fraction(self) -> float:
        """Completed fraction of the shots or of the time."""
        if self._count == 0:
            return 1.0 - max(0.0, self.remaining) / self.diagnostic.seconds
        return len(self.shots) / self._count

    def want(self, count: int) -> None:
        """Set the total number of shots to wait for."""
        self._wanted = count

    def start(self) -> None:
        """Start the time of the average."""
        self._started = self.heard = time.monotonic()

    def take(self, value: float) -> None:
        """Take a shot; NaN if it has no value."""
        if self.complete or self._operation.interrupt.done():
            return
        self.shots.append(value)
        self.heard = time.monotonic()
        self._operation.shot({self.diagnostic.name: value})
        advanced, self.advanced = self.advanced, Future(executor=self._operation.executor)
        advanced.set_result(None)

    def close(self) -> None:
        """Stop listening."""
        self.signal.listeners.remove(self.take)


class _Fire:
    """The trigger of a shot: a message or a call."""

    def __init__(self, node: Node, endpoint: Endpoint) -> None:
        self.endpoint = endpoint
        self._call: Call | None = None
        if endpoint.target.kind != "topic":
            self._call = Call(node, endpoint)
            return
        message_type = load(endpoint)
        self._message = message_type()
        check(endpoint, "message", lambda: fill(self._message, endpoint.message))
        self._publisher = create(
            endpoint,
            lambda: node.create_publisher(message_type, endpoint.target.name, QoSProfile(depth=10)),
        )

    @property
    def ready(self) -> bool:
        """Whether the trigger has a receiver."""
        if self._call is not None:
            return self._call.ready
        return bool(self._publisher.get_subscription_count() > 0)

    async def __call__(self, wait: Callable[[Future, float], Awaitable[bool]]) -> None:
        """Fire one shot.

        Raises:
            CallError: If it was not fired.
        """
        if self._call is not None:
            await self._call(wait)
        else:
            self._publisher.publish(self._message)


def _call_failure(error: CallError, what: str) -> Failure:
    code = _Result.INVALID_MEASUREMENT if error.answered else _Result.TIMEOUT
    return Failure(code, f"{what}: {error}")
