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
from mobo_tuner.runs.journal import JsonRecord, journal_line
from mobo_tuner.runs.records import (
    ChangeRecord,
    EndRecord,
    EvaluationRecord,
    StartRecord,
    from_json,
)
from mobo_tuner.tuner.messages import (
    evaluation_message,
    problem_message,
    run_records_message,
)

TICK = 10_000_000  # [ns] between two messages
START = 1_700_000_000_000_000_000  # [ns]


def write_bag(bag: Path, *runs: Sequence[JsonRecord]) -> None:
    """Write the bag of one or more consecutive runs.

    Args:
        bag: Folder of the bag, which must not exist.
        runs: Journal records of each run.
    """
    writer = BagWriter(bag)
    writer.open()
    connections = {}
    for topic, kind in (
        ("/run_records", "RunRecords"),
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


def _messages(records: Sequence[JsonRecord]) -> list[tuple[str, Any]]:
    """Return the messages of a run in order, each with its topic."""
    run_id, outline = "", ""
    messages: list[tuple[str, Any]] = []
    for content in records:
        record = from_json(content)
        if isinstance(record, StartRecord):
            run_id = record.run_id
        if isinstance(record, StartRecord | ChangeRecord):
            problem = record.problem
            outline += journal_line(content).decode()
            messages.append(("/run_records", run_records_message(outline, run_id, Time())))
            messages.append(("/problem", problem_message(problem, run_id, Time())))
        elif isinstance(record, EvaluationRecord):
            messages.append(("/evaluation", evaluation_message(problem, record, run_id)))
        elif isinstance(record, EndRecord):
            status = msg.TunerStatus(run_id=run_id, stop_reason=record.stop_reason)
            status.header.stamp = Time(sec=int(record.stamp))
            status.message = record.error_msg
            messages.append(("/status", status))
    return messages
