"""A bag with the messages that the tuner publishes during a run, made from its journal without any node."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from builtin_interfaces.msg import Time
from rclpy.serialization import serialize_message

from mobo_msgs_py import msg
from mobo_tuner.runs.bag import BagWriter
from mobo_tuner.runs.definitions import find_definition
from mobo_tuner.runs.history import History
from mobo_tuner.runs.journal import Record, journal_line
from mobo_tuner.tuner.run.republish import earlier_evaluations

TICK = 10_000_000  # [ns] between two messages
START = 1_700_000_000_000_000_000  # [ns]


def write_bag(bag: Path, *runs: Sequence[Record]) -> None:
    """Write the bag of one or more consecutive runs.

    Args:
        bag: Folder of the bag, which must not exist.
        runs: Journal records of each run.
    """
    writer = BagWriter(bag)
    writer.open()
    connections = {}
    for topic, kind in (
        ("/problem", "Problem"),
        ("/evaluation", "Evaluation"),
        ("/status", "TunerStatus"),
    ):
        definition = find_definition(f"mobo_msgs_py/msg/{kind}")
        connections[topic] = writer.add_connection(
            topic, f"mobo_msgs_py/msg/{kind}", msgdef=definition.text, rihs01=definition.type_hash
        )
    time = START
    for records in runs:
        for topic, message in _messages(records):
            time += TICK
            writer.write(connections[topic], time, serialize_message(message))
            writer.flush()
    writer.close()


def _messages(records: Sequence[Record]) -> list[tuple[str, Any]]:
    """Return the messages of a run in order, each with its topic."""
    history = History.from_records(records)
    evaluations = iter(earlier_evaluations(history, history.run_id))
    outline = ""
    messages: list[tuple[str, Any]] = []
    for record in records:
        if record["type"] in ("start", "change"):
            outline += journal_line(record).decode()
            messages.append(("/problem", msg.Problem(run_id=history.run_id, records=outline)))
        elif record["type"] == "evaluation":
            messages.append(("/evaluation", next(evaluations)))
        elif record["type"] == "end":
            status = msg.TunerStatus(run_id=history.run_id, stop_reason=record["stop_reason"])
            status.stamp = Time(sec=int(record["stamp"]))
            status.message = record["error_msg"]
            messages.append(("/status", status))
    return messages
