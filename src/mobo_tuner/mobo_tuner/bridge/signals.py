"""Values from topics, or from services that are polled."""

from __future__ import annotations

import math
import time
from collections import deque
from collections.abc import Callable
from statistics import median
from typing import Any

from rclpy.clock import Clock
from rclpy.node import Node
from rclpy.qos import QoSProfile, qos_profile_sensor_data
from rclpy.task import Future

from mobo_tuner.bridge.calls import Call, CallError, check, create, load
from mobo_tuner.bridge.interface_types import FieldError, check_readable, check_time, read
from mobo_tuner.bridge.mapping import Condition, Endpoint, Target
from mobo_tuner.ros.conversions import seconds
from mobo_tuner.ros.qos import LATCHED
from mobo_tuner.ros.waiting import STEADY_CLOCK, first_of

_QOS = {
    "reliable": QoSProfile(depth=100),
    "best_effort": qos_profile_sensor_data,
    "latched": LATCHED,
}
WINDOW = 3  # values of which the median is taken: one that is wrong does not count
LEAD = 5.0  # [s] by which a stamp may be ahead, as clocks of hosts are not quite equal
RESTARTED = 3  # messages in a row whose stamps advance, after which an earlier time is a new clock


class Signal:
    """The latest value of one endpoint, and its listeners.

    A message whose stamp is older than `stale_after` or `not_before`, ahead of now by more than `LEAD`,
    or not newer than that of the previous message, is ignored; stamps that go back but advance again are
    those of a clock that was set. A missing or non-finite value counts as NaN: listeners receive it, but
    it does not replace the latest value.

    Args:
        clock: Clock of the stamps.
        endpoint: Endpoint of the value.
        convert: Function that converts the content of the field to a value.
    """

    def __init__(
        self, clock: Clock, endpoint: Endpoint, convert: Callable[[object], float]
    ) -> None:
        self.endpoint = endpoint
        self.latest = math.nan
        self.not_before = -math.inf  # earlier stamps are ignored [s]
        self.listeners: list[Callable[[float], None]] = []
        self.count_publishers: Callable[[], int] = lambda: 1  # of the topic
        self._clock = clock
        self._convert = convert
        self._heard = -math.inf  # arrival of the latest value, time.monotonic()
        self._window: deque[tuple[float, float]] = deque(maxlen=WINDOW)  # arrival and value
        self._stamp = -math.inf  # of the last message [s]
        self._earlier: list[float] = []  # stamps since then that went back
        self._fault = ""

    def accept(self, message: Any) -> None:
        """Take a message."""
        if self.endpoint.stamp is not None and not self._is_new(message):
            return
        value = self.value_of(message)
        if math.isfinite(value):
            self.latest, self._heard, self._fault = value, time.monotonic(), ""
            self._window.append((self._heard, value))
        for listener in tuple(self.listeners):
            listener(value)

    def value_of(self, message: Any) -> float:
        """Return the value in a message; NaN if it has none."""
        assert self.endpoint.field is not None
        try:
            value = self._convert(read(message, self.endpoint.field))
        except FieldError as error:
            self._fault = str(error)
            return math.nan
        if not math.isfinite(value):
            self._fault = f"it is {value}"
        return value if math.isfinite(value) else math.nan

    @property
    def steady(self) -> float:
        """Median of the last values, so that a single wrong one does not count.

        It is the latest value until there are enough of them, and where values come only when they
        change: there nothing follows a value that is wrong.
        """
        if math.isinf(self.endpoint.stale_after):
            return self.latest
        oldest = time.monotonic() - self.endpoint.stale_after
        values = [value for heard, value in self._window if heard >= oldest]
        return median(values) if len(values) == WINDOW else self.latest

    def fail(self, reason: str) -> None:
        """Note the reason why no message arrived."""
        self._fault = reason

    @property
    def problem(self) -> str:
        """Reason why the latest value is invalid, in a few words; empty if it is valid."""
        if not math.isfinite(self._heard):
            return f"the {self.endpoint.target} gave no value yet" + self.because
        # A value that is only published on change never gets old, but its publisher may be gone.
        if math.isinf(self.endpoint.stale_after) and self.count_publishers() == 0:
            return f"the {self.endpoint.target} has no publisher"
        age = time.monotonic() - self._heard
        if age > self.endpoint.stale_after:
            return f"the {self.endpoint.target} gave no value for {age:.1f} s" + self.because
        return ""

    @property
    def because(self) -> str:
        """Fault of the last message, in brackets; empty if there was none."""
        return f" ({self._fault})" if self._fault else ""

    def _is_new(self, message: Any) -> bool:
        assert self.endpoint.stamp is not None
        try:
            stamp = seconds(read(message, self.endpoint.stamp))
        except FieldError as error:
            self._fault = str(error)
            return False
        now = seconds(self._clock.now().to_msg())
        if stamp == self._stamp:
            self._fault = "its stamp does not advance"
            return False
        if stamp < self.not_before:
            self._fault = "its stamp is from before the measurement"
            return False
        if now - stamp > self.endpoint.stale_after:
            self._fault = f"its stamp is {now - stamp:.1f} s old"
            return False
        if stamp - now > LEAD:
            self._fault = f"its stamp is {stamp - now:.1f} s ahead"
            return False
        if stamp < self._stamp and not self._is_new_clock(stamp):
            self._fault = "its stamp goes back"
            return False
        self._stamp = stamp
        self._earlier.clear()
        return True

    def _is_new_clock(self, stamp: float) -> bool:
        """Return whether a stamp that goes back is one of several in a row that advance."""
        if self._earlier and stamp <= self._earlier[-1]:
            self._earlier.clear()
        self._earlier.append(stamp)
        return len(self._earlier) >= RESTARTED


class Signals:
    """All signals of a node, each topic subscribed to once, each service polled at its period."""

    def __init__(self, node: Node) -> None:
        self._node = node
        self._subscriptions: dict[tuple[Target, str], tuple[Any, list[Signal]]] = {}

    def number(self, endpoint: Endpoint) -> Signal:
        """Return the signal of a number.

        Raises:
            MappingError: If the endpoint does not fit the installed types.
        """
        return self._add(endpoint, endpoint.value)

    def condition(self, condition: Condition) -> Signal:
        """Return the signal of a condition: 1 if it holds, else 0.

        Raises:
            MappingError: If the endpoint does not fit the installed types.
        """
        return self._add(condition.endpoint, lambda raw: float(condition.holds(raw)))

    def _add(self, endpoint: Endpoint, convert: Callable[[object], float]) -> Signal:
        signal = Signal(self._node.get_clock(), endpoint, convert)
        if endpoint.target.kind == "topic":
            self._subscribe(signal)
        else:
            self._poll(signal)
        return signal

    def _subscribe(self, signal: Signal) -> None:
        endpoint = signal.endpoint
        message_type = load(endpoint)
        check_fields(endpoint, message_type)
        key = (endpoint.target, endpoint.qos)
        if key not in self._subscriptions:
            signals: list[Signal] = []

            def accept(message: Any) -> None:
                for each in signals:
                    each.accept(message)

            subscription = create(
                endpoint,
                lambda: self._node.create_subscription(
                    message_type, endpoint.target.name, accept, _QOS[endpoint.qos]
                ),
            )
            self._subscriptions[key] = (subscription, signals)
        subscription, signals = self._subscriptions[key]
        signals.append(signal)
        signal.count_publishers = subscription.get_publisher_count

    def _poll(self, signal: Signal) -> None:
        call = Call(self._node, signal.endpoint)
        check_fields(signal.endpoint, call.answer_type)
        asking = False

        async def wait(future: Future, timeout: float) -> bool:
            return await first_of(self._node, future, timeout=timeout) is not None

        def tick() -> None:
            # As a task, because a timer's callback that waits would block the node's other callbacks.
            nonlocal asking
            if not asking and self._node.executor is not None:
                asking = True
                self._node.executor.create_task(ask)

        async def ask() -> None:
            nonlocal asking
            try:
                signal.accept(await call(wait))
            except CallError as error:
                signal.fail(str(error))
            finally:
                asking = False

        self._node.create_timer(signal.endpoint.period, tick, clock=STEADY_CLOCK)


def check_fields(endpoint: Endpoint, message_type: Any) -> None:
    """Check that an endpoint's messages have its value and stamp.

    Raises:
        MappingError: If they do not.
    """
    field, stamp = endpoint.field, endpoint.stamp
    if field is not None:
        check(endpoint, "field", lambda: check_readable(message_type, field))
    if stamp is not None:
        check(endpoint, "stamp", lambda: check_time(message_type, stamp))
