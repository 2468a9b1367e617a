"""Journal records from messages, so that a journal and a bag say the same in the same words.

The messages are looked at by their fields alone: those of rclpy and those of a bag reader serve.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from mobo_tuner.runs.journal import Record

SOURCE_NAMES = ("initial", "model", "operator")  # by the constants of mobo_msgs_py/msg/Evaluation


def evaluation_record(message: Any) -> Record:
    """The record of an `Evaluation` message.

    Raises:
        IndexError, AttributeError: the message is none.
    """
    return {
        "type": "evaluation",
        "index": int(message.index),
        "source": SOURCE_NAMES[message.source],
        "attempts": int(message.attempts),
        "stamp": seconds(message.stamp),
        "setpoint": _values(message.setpoint),
        "readbacks": _values(message.readbacks),
        "diagnostics": {item.name: [item.value, item.stddev] for item in message.diagnostics},
        "valid": bool(message.valid),
        "feasible": bool(message.feasible),
        "error_code": int(message.error_code),
        "error_msg": message.error_msg,
        "hypervolume": message.hypervolume,
        "suggest_seconds": message.suggest_seconds,
        "machine_seconds": message.machine_seconds,
        "total_seconds": message.total_seconds,
    }


def seconds(stamp: Any) -> float:
    """A stamp as seconds since the epoch."""
    return float(stamp.sec + 1e-9 * stamp.nanosec)


def _values(named: Iterable[Any]) -> dict[str, float]:
    return {item.name: item.value for item in named}
