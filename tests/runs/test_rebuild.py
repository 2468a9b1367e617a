"""Runs from their bags alone: whole ones, and ones that were cut off anywhere."""

from __future__ import annotations

import contextlib
from pathlib import Path

import numpy as np
import pytest

from mobo_tuner.runs.bag_messages import BagError
from mobo_tuner.runs.journal import JsonRecord, read_journal
from mobo_tuner.runs.old_data import read_old_data
from mobo_tuner.runs.rebuild import BaggedRun, main, records_of_bag, runs_of_bag
from mobo_tuner.runs.records import EndRecord, MoveRecord, StateRecord, to_json
from mobo_tuner.runs.replay import main as replay
from robustness.offline_run import OfflineRun, toy, toy_optimizer
from robustness.synthetic_bag import write_bag

# The parser that ROS's type support imports does so.
pytestmark = pytest.mark.filterwarnings("ignore:module 'sre_:DeprecationWarning")

SEED = 7  # with failures, an operator's set-points and two changes
CUTS = 60


def lived(folder: Path, evaluations: int) -> list[JsonRecord]:
    """The records of a run, without those of set-points that wait: they are not in a bag."""
    run = OfflineRun(folder, toy_optimizer(SEED), toy, SEED)
    for _ in range(evaluations):
        run.step()
    run.log.append(EndRecord(9.0, "budget"))
    run.log.close()
    return [record for record in read_journal(folder) if record["type"] != "queued"]


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> dict[str, list[JsonRecord]]:
    folder = tmp_path_factory.mktemp("runs")
    return {name: lived(folder / name, length) for name, length in (("one", 14), ("two", 5))}


@pytest.fixture(scope="module")
def bag(runs: dict[str, list[JsonRecord]], tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("bags") / "bag"
    write_bag(path, runs["one"])
    return path


def steps(records: list[JsonRecord]) -> list[JsonRecord]:
    """The records from which a run can be replayed."""
    return [record for record in records if record["type"] != "end"]


def test_a_whole_bag_holds_the_whole_journal(bag: Path, runs: dict[str, list[JsonRecord]]) -> None:
    assert {record["type"] for record in runs["one"]} == {"start", "change", "evaluation", "end"}
    assert steps(records_of_bag(bag)) == steps(runs["one"])
    end = records_of_bag(bag)[-1]
    assert (end["type"], end["stop_reason"]) == ("end", "budget")


def test_a_bag_that_was_cut_anywhere_holds_the_beginning(
    bag: Path, runs: dict[str, list[JsonRecord]], tmp_path: Path
) -> None:
    (whole,) = bag.glob("*.mcap")
    content = whole.read_bytes()
    file = tmp_path / "cut.mcap"
    found = []
    for length in np.random.default_rng(3).integers(0, len(content), CUTS):
        file.write_bytes(content[:length])
        records = []
        with contextlib.suppress(BagError):  # too little is left of it
            records = steps(records_of_bag(file))
        assert records == steps(runs["one"])[: len(records)]
        found.append((int(length), len(records)))
    counts = [count for _, count in sorted(found)]
    assert counts == sorted(counts)  # more of a bag never tells less
    assert counts[-1] >= len(steps(runs["one"])) - 2
    assert len(set(counts)) > 5


def test_moves_come_where_they_were_made(runs: dict[str, list[JsonRecord]]) -> None:
    start, *others, end = runs["two"]
    count = sum(record["type"] == "evaluation" for record in others)
    before = to_json(StateRecord(1.0, 0, {"x1": 0.5}))
    last = to_json(MoveRecord(8.0, count, {"x1": 0.5}, "restore", "on_end"))
    late = [
        to_json(MoveRecord(11.0, count, {"x1": 0.25}, evaluation=2)),
        to_json(StateRecord(12.0, count, {"x1": 0.25})),
    ]
    bagged = BaggedRun(
        outline=[start, before, last, *late],
        evaluations={r["index"]: r for r in others if r["type"] == "evaluation"},
        end=end,
    )
    told = [record for record in others if record["type"] == "evaluation"]
    assert bagged.journal() == [start, before, *told, last, end, *late]
    assert bagged.gap == ""
    bagged.evaluations.pop(count - 2)  # a part of the bag is damaged
    assert bagged.journal() == [start, before, *told[:-2]]
    assert bagged.gap.startswith(f"evaluations {count - 2} to {count - 1} cannot be rebuilt")
    assert bagged.gap.endswith("although 1 of them are there")


def test_what_a_bag_lacks_is_told(
    runs: dict[str, list[JsonRecord]], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    whole = runs["one"]
    lost = next(r for r in whole if r["type"] == "evaluation" and r["index"] == 2)
    last = max(r["index"] for r in whole if r["type"] == "evaluation")
    write_bag(tmp_path / "bag", [record for record in whole if record is not lost])
    told = f"evaluations 2 to {last} cannot be rebuilt, because 2 is missing in the bag"
    assert main([str(tmp_path / "bag"), str(tmp_path / "rebuilt")]) == 0
    assert told in capsys.readouterr().out
    assert replay([str(tmp_path / "bag")]) == 0
    assert told in capsys.readouterr().out
    assert told in read_old_data(tmp_path / "bag").gap
    # What was never in the bag is known from the tuner's status.
    assert BaggedRun(counted=3).gap.startswith("evaluations 0 to 2 cannot be rebuilt")
    assert BaggedRun().gap == ""


def test_of_several_runs_one_is_named(runs: dict[str, list[JsonRecord]], tmp_path: Path) -> None:
    write_bag(tmp_path / "bag", runs["one"], runs["two"])
    assert set(runs_of_bag(tmp_path / "bag")) == {"one", "two"}
    assert steps(records_of_bag(tmp_path / "bag", "two")) == steps(runs["two"])
    with pytest.raises(BagError, match="holds several runs: one, two"):
        records_of_bag(tmp_path / "bag")
    with pytest.raises(BagError, match="holds no run 'three'"):
        records_of_bag(tmp_path / "bag", "three")


def test_the_command_never_overwrites_a_journal(
    bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "rebuilt"
    assert main([str(bag), str(folder)]) == 0
    kept = (folder / "journal.jsonl").read_bytes()
    capsys.readouterr()
    assert main([str(bag), str(folder)]) != 0
    assert len(capsys.readouterr().err.splitlines()) == 1
    assert (folder / "journal.jsonl").read_bytes() == kept


@pytest.mark.parametrize("content", [b"", b"no bag", b"\x89MCAP0\r\n" + bytes(200)])
def test_what_is_no_bag_is_one_sentence(
    content: bytes, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "bag.mcap"
    file.write_bytes(content)
    assert main([str(file), str(tmp_path / "rebuilt")]) != 0
    assert len(capsys.readouterr().err.splitlines()) == 1
    assert not (tmp_path / "rebuilt").exists()
