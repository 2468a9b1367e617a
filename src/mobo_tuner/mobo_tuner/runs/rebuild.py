"""A run's journal rebuilt from its bag alone, also where the bag was cut off.

`python -m mobo_tuner.runs.rebuild BAG RUN_FOLDER` writes `journal.jsonl` into a folder that has none.

The topic `run_records` carries how the run was set up and changed, `evaluation` what was measured, and
`status` how it ended. Messages are decoded by the definitions that are installed here, never by
code made from what the bag says of itself.
"""

from __future__ import annotations

import argparse
import re
import sys
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any

from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from mobo_tuner.errors import UserError
from mobo_tuner.runs.definitions import DefinitionError, find_definition
from mobo_tuner.runs.history import History
from mobo_tuner.runs.journal import Journal, JournalError, JsonRecord, journal_line, parse_journal
from mobo_tuner.runs.mcap_records import McapError, Message, read_messages
from mobo_tuner.runs.records import EndRecord, from_message, seconds, to_json

OUTLINE, EVALUATION, STATUS = TYPES = (
    "mobo_msgs_py/msg/RunRecords",
    "mobo_msgs_py/msg/Evaluation",
    "mobo_msgs_py/msg/TunerStatus",
)


class BagError(UserError):
    """A bag from which no run can be rebuilt; the message is one sentence for the user."""


@dataclass
class BaggedRun:
    """What a bag holds of one run.

    Attributes:
        outline: its start record and its changes; empty where the bag lacks its beginning.
        evaluations: their records by index.
        end: its end record, if it ended.
    """

    outline: list[JsonRecord] = field(default_factory=list)
    evaluations: dict[int, JsonRecord] = field(default_factory=dict)
    end: JsonRecord | None = None

    def journal(self) -> list[JsonRecord]:
        """The records of its journal, as far as all before them are there, too."""
        start, *changes = self.outline
        records = [start]
        count = 0
        while True:
            records += [change for change in changes if change.get("index") == count]
            if count not in self.evaluations:
                break
            records.append(self.evaluations[count])
            count += 1
        if self.end is not None and count == len(self.evaluations):
            records.append(self.end)
        return records


def runs_of_bag(path: Path) -> dict[str, BaggedRun]:
    """The runs in a bag, by their ids.

    Args:
        path: of a bag's folder, or of an MCAP file.

    Raises:
        BagError: there is no such bag.
    """
    files = sorted(path.glob("*.mcap")) if path.is_dir() else [path]
    if not files:
        raise BagError(f"'{path}' holds no MCAP file")
    runs: dict[str, BaggedRun] = {}
    try:
        for file in files:
            for message in read_messages(file):
                if message.schema.name in TYPES:
                    _take(message, runs)
    except (DefinitionError, McapError) as error:
        raise BagError(str(error)) from None
    return runs


def records_of_bag(path: Path, run_id: str | None = None) -> list[JsonRecord]:
    """The records of a run's journal, from its bag.

    Args:
        path: of the bag.
        run_id: of the run; may be None where the bag holds only one.

    Raises:
        BagError: the run is not there, or not so that it can be rebuilt.
    """
    runs = {name: run for name, run in runs_of_bag(path).items() if run.outline}
    if run_id is None and len(runs) > 1:
        raise BagError(f"the bag '{path}' holds several runs: {', '.join(list(runs)[:20])}")
    names = [run_id] if run_id is not None else list(runs)
    if not names or names[0] not in runs:
        which = "no run" if run_id is None else f"no run '{run_id[:120]}'"
        raise BagError(f"the bag '{path}' holds {which} with its records")
    records = runs[names[0]].journal()
    try:
        History.from_records(records)
    except JournalError as error:
        raise BagError(f"the bag '{path}' holds no run that can be rebuilt: {error}") from None
    return records


def _take(message: Message, runs: dict[str, BaggedRun]) -> None:
    """Take up one message; one that is damaged is passed over, for a later one may be whole."""
    name = message.schema.name
    if _fields(message.schema.text) != _fields(find_definition(name).text):
        raise BagError(f"the bag holds another version of {name} than is installed here")
    try:
        content: Any = _typestore().deserialize_cdr(message.data, name)
        run_id = content.run_id
    except Exception:  # the decoder raises whatever it stumbles over
        return
    if not run_id:
        return
    run = runs.setdefault(run_id, BaggedRun())
    try:
        if name == OUTLINE:
            outline = parse_journal(content.records.encode(), "the topic 'run_records'")
            if len(outline) >= len(run.outline):
                run.outline = outline
        elif name == EVALUATION:
            record = _strict(to_json(from_message(content)))
            run.evaluations.setdefault(record["index"], record)
        elif content.stop_reason and run.end is None:
            run.end = to_json(
                EndRecord(
                    seconds(content.header.stamp), content.stop_reason, error_msg=content.message
                )
            )
    except (JournalError, ValueError):
        return


def _strict(record: JsonRecord) -> JsonRecord:
    """A record as it is read from a journal.

    Raises:
        ValueError: it cannot stand in one.
    """
    [_, same] = parse_journal(b'{"type":"start"}\n' + journal_line(record), "the bag")
    return same


@cache
def _typestore() -> Typestore:
    store = get_typestore(Stores.ROS2_JAZZY)
    for name in TYPES:
        store.register(get_types_from_msg(find_definition(name).text, name))
    return store


@cache
def _fields(definition: str) -> tuple[str, ...]:
    """What a definition says, without its comments."""
    lines = (re.sub(r"\s+", " ", line.split("#")[0]).strip() for line in definition.splitlines())
    return tuple(line for line in lines if line and not line.startswith("===="))


def write_run(records: Sequence[JsonRecord], run_dir: Path) -> None:
    """Write the journal of a rebuilt run.

    Raises:
        FileExistsError: there is one already.
        OSError: it cannot be written.
    """
    Journal.create(run_dir, records).close()


def _kinds(records: Iterable[JsonRecord]) -> str:
    counts = {"evaluation": 0, "change": 0}
    for record in records:
        if record["type"] in counts:
            counts[record["type"]] += 1
    return f"{counts['evaluation']} evaluations and {counts['change']} changes"


def main(arguments: Sequence[str] | None = None) -> int:
    """Rebuild one run; return the exit status."""
    parser = argparse.ArgumentParser(prog="mobo_tuner.runs.rebuild", description="Run from a bag.")
    parser.add_argument("bag", type=Path, help="the bag's folder, or an .mcap file of it")
    parser.add_argument("run_folder", type=Path, help="where the journal is written")
    parser.add_argument("--of", help="which run, where the bag holds several")
    options = parser.parse_args(arguments)
    try:
        records = records_of_bag(options.bag, options.of)
        write_run(records, options.run_folder)
    except (BagError, OSError, ValueError) as error:
        print(error, file=sys.stderr)
        return 1
    print(f"{_kinds(records)} of run '{records[0]['run_id']}' are in {options.run_folder}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
