"""How the diagnostics of a mapping are measured: fired or not, from messages or by calls."""

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
"""Waits for a future, at most so many seconds; an interrupt of the operation ends it early."""

_Result = EvaluateSetpoint.Result


class Measuring:
    """Measures the diagnostics of one machine, all at the same time.

    Args:
        node: that talks to the machine.
        mapping: of the machine.
        signals: of the node.
        executor: on which the coroutines run.
        wait: how a coroutine waits.

    Raises:
        MappingError: the mapping does not fit the installed types.
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
        """What is not there that must be called, in a few words each."""
        targets = [(c.ready, self._mapping.diagnostics[n].read) for n, c in self._calls.items()]
        if self._fire is not None:
            targets.append((self._fire.ready, self._fire.endpoint))
        return [f"the {endpoint.target} is not there" for ready, endpoint in targets if not ready]

    async def measure(self, shots: int, operation: Operation) -> Measurement:
        """Measure; `shots` = 0 means as many as the mapping says.

        Every shot is shown to the operation. When it is interrupted, what was measured is returned.
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
            value, stddev = average(collector.shots, diagnostic.outliers)
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
        """What bears a stamp from before now does not count."""
        for signal in self._signals.values():
            signal.not_before = seconds(self._clock.now().to_msg())

    async def _fire_and_collect(
        self, collectors: list[_Collector], shots: int, operation: Operation
    ) -> Failure | None:
        """Fire shot after shot, and wait for all diagnostics of each."""
        assert self._fire is not None
        rounds = shots or self._mapping.shots
        for number in range(1, rounds + 1):
            # Listening first: a shot may be there before the answer that it was fired.
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
        """Wait until all collectors have what they want; why one of them has not."""
        tasks = [
            self._executor.create_task(self._call, collector, operation)
            if collector.diagnostic.name in self._calls
            else self._executor.create_task(self._listen, collector, operation)
            for collector in collectors
        ]
        failures = []
        for task in tasks:
            # Each of them ends by itself: by its time limit, or when the operation is interrupted.
            failures.append(await task)
            if self._fire is None:
                part = min(collector.fraction for collector in collectors)
                operation.progress(MEASURING, part)
        return next((failure for failure in failures if failure is not None), None)

    async def _listen(self, collector: _Collector, operation: Operation) -> Failure | None:
        """Wait for the messages that a collector wants."""
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
        """Call until a collector has what it wants."""
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
    """The shots of one diagnostic: so many, or those of some seconds."""

    def __init__(
        self, diagnostic: Diagnostic, signal: Signal, shots: int, operation: Operation
    ) -> None:
        self.diagnostic = diagnostic
        self.signal = signal
        self.shots: list[float] = []
        self.heard = time.monotonic()  # when the last one came
        self.advanced: Future = Future(executor=operation.executor)  # done when the next one comes
        self._operation = operation
        self._count = shots or diagnostic.count
        self._started = self.heard
        self._wanted = self._count
        signal.listeners.append(self.take)

    @property
    def complete(self) -> bool:
        """Whether there is what is wanted."""
        if self._count == 0:
            return self.remaining <= 0.0 and len(self.shots) > 0
        return len(self.shots) >= self._wanted

    @property
    def remaining(self) -> float:
        """Time that is still to be averaged over [s]; infinite where shots count."""
        if self._count > 0:
            return math.inf
        left = self._started + self.diagnostic.seconds - time.monotonic()
        # Time is up without a shot: the next one will do.
        return left if left > 0.0 or self.shots else math.inf

    @property
    def fraction(self) -> float:
        """How much there is of what is wanted."""
        if self._count == 0:
            return 1.0 - max(0.0, self.remaining) / self.diagnostic.seconds
        return len(self.shots) / self._count

    def want(self, count: int) -> None:
        """Want so many shots in all, and none before that is said."""
        self._wanted = count

    def start(self) -> None:
        """Time counts from now on."""
        self._started = self.heard = time.monotonic()

    def take(self, value: float) -> None:
        """A shot came; NaN where it has no value."""
        if self.complete or self._operation.interrupt.done():
            return
        self.shots.append(value)
        self.heard = time.monotonic()
        self._operation.shot({self.diagnostic.name: value})
        advanced, self.advanced = self.advanced, Future(executor=self._operation.executor)
        advanced.set_result(None)

    def close(self) -> None:
        """Listen no more."""
        self.signal.listeners.remove(self.take)


class _Fire:
    """What fires a shot: a message, or a call."""

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
        """Whether somebody would fire."""
        if self._call is not None:
            return self._call.ready
        return bool(self._publisher.get_subscription_count() > 0)

    async def __call__(self, wait: Callable[[Future, float], Awaitable[bool]]) -> None:
        """Fire one shot.

        Raises:
            CallError: it was not fired.
        """
        if self._call is not None:
            await self._call(wait)
        else:
            self._publisher.publish(self._message)


def _call_failure(error: CallError, what: str) -> Failure:
    code = _Result.INVALID_MEASUREMENT if error.answered else _Result.TIMEOUT
    return Failure(code, f"{what}: {error}")
