"""Integrity checks of a run: its journal, and its bag with two independent readers."""

from __future__ import annotations

from collections.abc import Collection, Iterable
from pathlib import Path
from typing import Any

from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from rosbags.highlevel import AnyReader

from mobo_tuner.runs.bag_messages import BagError
from mobo_tuner.runs.history import History
from mobo_tuner.runs.journal import JournalError, JsonRecord, read_journal
from mobo_tuner.runs.rebuild import records_of_bag, runs_of_bag
from mobo_tuner.runs.replay import compare


def evaluations(records: Iterable[JsonRecord]) -> list[JsonRecord]:
    """Return the evaluations among the records of a journal."""
    return [record for record in records if record["type"] == "evaluation"]


def has_journal(folder: Path) -> bool:
    """Return whether a run has a journal."""
    return (folder / "journal.jsonl").exists()


def differing_suggestions(records: list[JsonRecord]) -> list[int]:
    """Return the evaluations whose set-points differ from those of an uninterrupted run."""
    return [c.index for c in compare(History.from_records(records)) if c.differs]


def bag_faults(
    bag: Path, runs_dir: Path, recorded: Collection[str], whole: Collection[str] = ()
) -> list[str]:
    """Return the faults of a bag, one sentence each.

    Args:
        bag: Folder of the bag.
        runs_dir: Folder of the recorded runs, with their journals.
        recorded: IDs of the runs that began after the recorder. The bag may also contain
            evaluations of earlier runs, without their problem, because the tuner sends them to late
            subscribers.
        whole: IDs of the runs that must be complete.
    """
    faults = []
    try:
        mcap, rosbags = _count_by_mcap(bag), _count_by_rosbags(bag)
    except Exception as error:  # a reader may raise any exception
        return [f"the bag {bag.name} cannot be read: {error!r}"]
    if mcap != rosbags:
        faults.append(f"mcap reads {mcap} messages of {bag.name}, rosbags {rosbags}")
    for run_id, run in runs_of_bag(bag).items():
        if not run.outline and not (run.evaluations and run_id in recorded):
            continue  # an earlier run, without its problem
        folder = runs_dir / run_id
        try:
            journal = evaluations(read_journal(folder))
            rebuilt = evaluations(records_of_bag(bag, run_id))
        except (BagError, JournalError) as error:
            faults.append(f"run {run_id} of {bag.name}: {error}")
            continue
        if rebuilt != journal[: len(rebuilt)]:
            faults.append(f"run {run_id} of {bag.name} differs from its journal")
        # A killed tuner may not have published the last evaluation.
        if run_id in whole and len(rebuilt) < len(journal) - 1:
            faults.append(
                f"{bag.name} has {len(rebuilt)} of {len(journal)} evaluations of run {run_id}"
            )
    return faults


def _count_by_mcap(bag: Path) -> int:
    [file] = bag.glob("*.mcap")
    with file.open("rb") as stream:
        reader: Any = make_reader(stream, decoder_factories=[DecoderFactory()])
        return sum(1 for _ in reader.iter_decoded_messages())


def _count_by_rosbags(bag: Path) -> int:
    with AnyReader([bag]) as reader:
        return sum(1 for _, _, data in reader.messages() if len(data))
