"""Whether what is kept of a run is whole: its journal, and its bag by two independent readers."""

from __future__ import annotations

from collections.abc import Collection, Iterable
from pathlib import Path
from typing import Any

from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from rosbags.highlevel import AnyReader

from mobo_tuner.runs.history import History
from mobo_tuner.runs.journal import JournalError, Record, read_journal
from mobo_tuner.runs.rebuild import BagError, records_of_bag, runs_of_bag
from mobo_tuner.runs.replay import compare


def evaluations(records: Iterable[Record]) -> list[Record]:
    """The evaluations among the records of a journal."""
    return [record for record in records if record["type"] == "evaluation"]


def has_journal(folder: Path) -> bool:
    """Whether a run was kept at all."""
    return (folder / "journal.jsonl").exists()


def differing_suggestions(records: list[Record]) -> list[int]:
    """Evaluations whose set-points are not what an uninterrupted run would have asked for."""
    return [c.index for c in compare(History.from_records(records)) if c.differs]


def bag_faults(
    bag: Path, runs_dir: Path, recorded: Collection[str], whole: Collection[str] = ()
) -> list[str]:
    """What is wrong with a bag, one sentence each; nothing where all is well.

    Args:
        bag: its folder.
        runs_dir: of the runs that it recorded, with their journals.
        recorded: ids of the runs that began since the bag did. Of those before, which the tuner
            tells late subscribers of, it may hold evaluations without their problem.
        whole: ids of the runs of which nothing may be missing.
    """
    faults = []
    try:
        mcap, rosbags = _count_by_mcap(bag), _count_by_rosbags(bag)
    except Exception as error:  # whatever a reader stumbles over
        return [f"the bag {bag.name} cannot be read: {error!r}"]
    if mcap != rosbags:
        faults.append(f"of {bag.name} mcap reads {mcap} messages and rosbags {rosbags}")
    for run_id, run in runs_of_bag(bag).items():
        if not run.outline and not (run.evaluations and run_id in recorded):
            continue  # it was heard of, no more
        folder = runs_dir / run_id
        try:
            journal = evaluations(read_journal(folder))
            rebuilt = evaluations(records_of_bag(bag, run_id))
        except (BagError, JournalError) as error:
            faults.append(f"run {run_id} of {bag.name}: {error}")
            continue
        if rebuilt != journal[: len(rebuilt)]:
            faults.append(f"run {run_id} of {bag.name} is not what its journal says")
        # A tuner that was killed may have had no time to publish the last one.
        if run_id in whole and len(rebuilt) < len(journal) - 1:
            faults.append(f"{bag.name} has {len(rebuilt)} of run {run_id}'s {len(journal)}")
    return faults


def _count_by_mcap(bag: Path) -> int:
    [file] = bag.glob("*.mcap")
    with file.open("rb") as stream:
        reader: Any = make_reader(stream, decoder_factories=[DecoderFactory()])
        return sum(1 for _ in reader.iter_decoded_messages())


def _count_by_rosbags(bag: Path) -> int:
    with AnyReader([bag]) as reader:
        return sum(1 for _, _, data in reader.messages() if len(data))
