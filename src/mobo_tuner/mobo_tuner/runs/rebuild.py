"""Rebuilding of a run's journal from its bag, which may be incomplete.

`python -m mobo_tuner.runs.rebuild BAG RUN_FOLDER` writes `journal.jsonl` into a folder without one.

`RunRecords` messages carry how the run was set up and changed, `Evaluation` what was measured, and `TunerStatus` how
the run ended. Without the first, the problem is that of the `Problem` messages, and the settings of the tuner are
unknown. Messages are known by their types, whatever their topics are called, and are decoded by the definitions that
are installed here, never by code made from what the bag says of itself.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any

from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from mobo_tuner.core.problem import Problem
from mobo_tuner.runs.bag_messages import BagError, read_bag
from mobo_tuner.runs.definitions import DefinitionError, find_definition, same_fields
from mobo_tuner.runs.history import History
from mobo_tuner.runs.journal import Journal, JournalError, JsonRecord, journal_line, parse_journal
from mobo_tuner.runs.mcap_records import Message, Schema
from mobo_tuner.runs.records import (
    MOVE,
    STATE,
    ChangeRecord,
    EndRecord,
    StartRecord,
    from_message,
    problem_from_message,
    seconds,
    to_json,
)
from mobo_tuner.wording import counted

OUTLINE, PROBLEM, EVALUATION, STATUS = TYPES = (
    "mobo_msgs_py/msg/RunRecords",
    "mobo_msgs_py/msg/Problem",
    "mobo_msgs_py/msg/Evaluation",
    "mobo_msgs_py/msg/TunerStatus",
)


@dataclass
class BaggedRun:
    """Everything that a bag holds of one run.

    Attributes:
        outline: Its start record, its changes and its moves; empty if the bag lacks them.
        problems: The same, made of its `Problem` messages, with unknown settings and budgets.
        evaluations: Its evaluations by index.
        end: Its end record; None if the run did not end.
        counted: Number of its evaluations by the last status of the tuner.
    """

    outline: list[JsonRecord] = field(default_factory=list)
    problems: list[JsonRecord] = field(default_factory=list)
    evaluations: dict[int, JsonRecord] = field(default_factory=dict)
    end: JsonRecord | None = None
    counted: int = 0

    @property
    def gap(self) -> str:
        """Which evaluations cannot be rebuilt, in one sentence; empty if all can."""
        first = self._first_missing()
        total = max(self.counted, *(index + 1 for index in self.evaluations), 0)
        if first == total:
            return ""
        last = f" to {total - 1}" if total - 1 > first else ""
        found = sum(index > first for index in self.evaluations)
        lost = f", although {found} of them are there" if found else ""
        what = f"evaluation{'s' if last else ''} {first}{last}"
        return f"{what} cannot be rebuilt, because {first} is missing in the bag{lost}"

    @property
    def has_problem(self) -> bool:
        """Whether its problem is known, without which it cannot be rebuilt."""
        return bool(self.outline or self.problems)

    def journal(self) -> list[JsonRecord]:
        """Return the records of its journal up to the first one that is missing."""
        start, *changes = self.outline or self.problems
        records = [start]
        count = 0
        while True:
            records += [
                change
                for change in changes
                if change.get("index") == count and not self._is_late(change)
            ]
            if count not in self.evaluations:
                break
            records.append(self.evaluations[count])
            count += 1
        if self.end is not None and not self.gap:
            records.append(self.end)
            records += [change for change in changes if self._is_late(change)]
        return records

    def _is_late(self, change: JsonRecord) -> bool:
        """Return whether a record of the outline came after the end of the run."""
        if self.end is None or change["type"] not in (MOVE, STATE):
            return False
        stamp = change.get("stamp")
        return isinstance(stamp, int | float) and stamp > self.end["stamp"]

    def add_problem(self, problem: Problem, run_id: str, stamp: float) -> None:
        """Add a problem that was published; one that only tells its references replaces the last one."""
        if not self.problems:
            start = StartRecord(run_id, stamp, problem, settings={})
            self.problems.append(_strict(to_json(start)))
            return
        content = problem.to_dict()
        last = self.problems[-1]
        if _with_references_of(content, last["problem"]) == content:
            last["problem"] = content
            return
        change = to_json(ChangeRecord(stamp, self._first_missing(), problem, budget=0))
        self.problems.append(_strict(change))

    def _first_missing(self) -> int:
        """Return the index of the first evaluation that is not there."""
        index = 0
        while index in self.evaluations:
            index += 1
        return index


def runs_of_bag(path: Path) -> dict[str, BaggedRun]:
    """Return the runs in a bag, by their ids.

    Args:
        path: Folder of a bag, or one of its files.

    Raises:
        BagError: If there is no such bag, or it cannot be read.
    """
    runs: dict[str, BaggedRun] = {}
    for message in read_bag(path):
        if message.schema.name in TYPES:
            _check_version(message.schema)
            _take(message, runs)
    return runs


def records_of_bag(path: Path, run_id: str | None = None) -> list[JsonRecord]:
    """Return the records of a run's journal, from its bag; see `run_of_bag`."""
    return run_of_bag(path, run_id).journal()


def run_of_bag(path: Path, run_id: str | None = None) -> BaggedRun:
    """Return what a bag holds of one run that can be rebuilt.

    Args:
        path: Folder of the bag, or one of its files.
        run_id: Name of the run; may be None if the bag holds only one.

    Raises:
        BagError: If the run is not there, or cannot be rebuilt.
    """
    runs = {name: run for name, run in runs_of_bag(path).items() if run.has_problem}
    if run_id is None and len(runs) > 1:
        raise BagError(
            f"the bag '{path}' holds several runs: {', '.join(list(runs)[:20])}; --of names one"
        )
    names = [run_id] if run_id is not None else list(runs)
    if not names or names[0] not in runs:
        which = "no run" if run_id is None else f"no run '{run_id[:120]}'"
        raise BagError(f"the bag '{path}' holds {which} with its problem")
    run = runs[names[0]]
    try:
        History.from_records(run.journal())
    except JournalError as error:
        raise BagError(f"the bag '{path}' holds no run that can be rebuilt: {error}") from None
    return run


@cache
def _check_version(schema: Schema) -> None:
    """Check that a type in a bag has the fields of the one installed here; a bag may lack its definition.

    Raises:
        BagError: If it has other fields.
    """
    try:
        installed = find_definition(schema.name).text
    except DefinitionError as error:
        raise BagError(str(error)) from None
    if schema.text and not same_fields(schema.name, schema.text, installed):
        raise BagError(f"the bag holds another version of {schema.name} than is installed here")


def _take(message: Message, runs: dict[str, BaggedRun]) -> None:
    """Add one message to its run; a damaged one is skipped, because a later one may be whole."""
    name = message.schema.name
    try:
        content: Any = _typestore().deserialize_cdr(message.data, name)
        run_id = content.run_id
    except Exception:  # the decoder raises any exception
        return
    if not run_id:
        return
    run = runs.setdefault(run_id, BaggedRun())
    try:
        if name == OUTLINE:
            outline = parse_journal(content.records.encode(), "the topic 'run_records'")
            if len(outline) >= len(run.outline):
                run.outline = outline
        elif name == PROBLEM:
            stamp = seconds(content.header.stamp)
            run.add_problem(problem_from_message(content), run_id, stamp)
        elif name == EVALUATION:
            record = _strict(to_json(from_message(content)))
            run.evaluations.setdefault(record["index"], record)
        else:
            _take_status(content, run)
    except (JournalError, ValueError):
        return


def _take_status(content: Any, run: BaggedRun) -> None:
    run.counted = int(content.evaluations)
    if content.stop_reason and run.end is None:
        stamp = seconds(content.header.stamp)
        run.end = to_json(EndRecord(stamp, content.stop_reason, error_msg=content.message))


def _with_references_of(problem: Mapping[str, Any], last: Mapping[str, Any]) -> Mapping[str, Any]:
    """Return the last problem with those references that it lacks and the other problem has."""
    known = {
        name: {"reference": entry["reference"]}
        for name, entry in problem["objectives"].items()
        if "reference" in entry
    }
    objectives = {name: known.get(name, {}) | entry for name, entry in last["objectives"].items()}
    return {**last, "objectives": objectives}


def _strict(record: JsonRecord) -> JsonRecord:
    """Return a record as it is read from a journal.

    Raises:
        ValueError: If it cannot stand in one.
    """
    [_, same] = parse_journal(b'{"type":"start"}\n' + journal_line(record), "the bag")
    return same


@cache
def _typestore() -> Typestore:
    store = get_typestore(Stores.ROS2_JAZZY)
    for name in TYPES:
        store.register(get_types_from_msg(find_definition(name).text, name))
    return store


def write_run(records: Sequence[JsonRecord], run_dir: Path) -> None:
    """Write the journal of a rebuilt run.

    Raises:
        FileExistsError: If there is one already.
        OSError: If it cannot be written.
    """
    Journal.create(run_dir, records).close()


def _summary(records: Sequence[JsonRecord]) -> str:
    counts = {"evaluation": 0, "change": 0}
    for record in records:
        if record["type"] in counts:
            counts[record["type"]] += 1
    text = (
        f"{counted(counts['evaluation'], 'evaluation')} and {counted(counts['change'], 'change')}"
    )
    text += f" of run '{records[0]['run_id']}'"
    unknown = "the settings of the tuner are unknown, because the bag has no run_records"
    return text if records[0].get("settings") else f"{text}; {unknown}"


def main(arguments: Sequence[str] | None = None) -> int:
    """Rebuild one run; return the exit status."""
    parser = argparse.ArgumentParser(prog="mobo_tuner.runs.rebuild", description="Run from a bag.")
    parser.add_argument("bag", type=Path, help="folder of the bag, or one of its files")
    parser.add_argument("run_folder", type=Path, help="folder for the journal")
    parser.add_argument("--of", help="id of the run, if the bag has several")
    options = parser.parse_args(arguments)
    try:
        run = run_of_bag(options.bag, options.of)
        records = run.journal()
        write_run(records, options.run_folder)
    except (BagError, OSError, ValueError) as error:
        print(error, file=sys.stderr)
        return 1
    print(_summary(records))
    if run.gap:
        print(run.gap)
    return 0


if __name__ == "__main__":
    sys.exit(main())
