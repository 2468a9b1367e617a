"""Values of a topic over time: one that is wrong, and stamps that are ahead or go back."""

from __future__ import annotations

import math
import time
from typing import Any

import pytest
from builtin_interfaces.msg import Time
from rclpy.clock import Clock
from std_msgs.msg import Header

from mobo_msgs_py import msg
from mobo_tuner.bridge.field_path import parse_field_path
from mobo_tuner.bridge.mapping import Endpoint, Target
from mobo_tuner.bridge.signals import LEAD, RESTARTED, WINDOW, Signal
from mobo_tuner.machine.ramped import without_strays


def make_signal(**changes: Any) -> Signal:
    endpoint = Endpoint(
        where="variables.q.readback",
        target=Target("topic", "q", "mobo_msgs_py/msg/NamedValues"),
        field=parse_field_path("values[0].value"),
        stamp=parse_field_path("header.stamp"),
        **{"stale_after": 60.0, **changes},
    )
    return Signal(Clock(), endpoint, endpoint.value)


def message(value: float, stamp: float) -> msg.NamedValues:
    whole = math.floor(stamp)
    at = Time(sec=whole, nanosec=round((stamp - whole) * 1e9))
    return msg.NamedValues(header=Header(stamp=at), values=[msg.NamedValue(value=value)])


def feed(signal: Signal, values: list[float], start: float, step: float = 0.01) -> None:
    for number, value in enumerate(values):
        signal.accept(message(value, start + number * step))


def test_a_single_wrong_value_does_not_count() -> None:
    signal = make_signal()
    start = time.time() - 10.0
    feed(signal, [1.0, 1.01, 99.0], start)
    assert signal.latest == 99.0
    assert signal.steady == 1.01
    feed(signal, [1.02], start + 1.0)
    assert signal.steady == 1.02
    feed(signal, [5.0] * (WINDOW - 1), start + 2.0)  # it has really moved
    assert signal.steady == 5.0


def test_a_value_that_comes_only_when_it_changes_counts_at_once() -> None:
    signal = make_signal(stale_after=math.inf)
    feed(signal, [1.0, 1.0, 1.0, 4.0], time.time() - 10.0)
    assert signal.steady == 4.0


def test_a_stamp_from_the_future_is_dropped_and_blocks_nothing() -> None:
    signal = make_signal()
    now = time.time()
    feed(signal, [1.0], now - 2.0)
    feed(signal, [9.0], now + 3600.0)
    assert signal.latest == 1.0
    assert "ahead" in signal.because
    feed(signal, [2.0], now - 1.0)
    assert (signal.latest, signal.because) == (2.0, "")


def test_a_clock_that_was_set_back_is_followed() -> None:
    signal = make_signal(stale_after=math.inf)
    now = time.time()
    feed(signal, [1.0], now + LEAD / 2.0)
    feed(signal, [7.0], now - 30.0)  # an old message: late, or of a clock that was set
    assert signal.latest == 1.0
    feed(signal, [7.0], now - 31.0)  # a late one again: they do not advance
    assert signal.latest == 1.0
    feed(signal, [2.0] * RESTARTED, now - 20.0)
    assert signal.latest == 2.0


@pytest.mark.parametrize(
    ("samples", "kept"),
    [
        ([1.0] * 9 + [50.0], [1.0] * 9),
        ([1.0, math.nan, 1.05], [1.0, 1.05]),
        ([math.nan], []),
        ([0.0, 1.0, 2.0, 3.0], [0.0, 1.0, 2.0, 3.0]),  # all scatter
    ],
)
def test_strays_among_readbacks_do_not_spoil_their_mean(
    samples: list[float], kept: list[float]
) -> None:
    assert without_strays(samples, 0.1) == kept
