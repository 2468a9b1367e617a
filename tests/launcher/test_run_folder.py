"""The entry script and the tuner, which cannot share a module, agree on what a run's folder is."""

from __future__ import annotations

from pathlib import Path

import pytest

from launcher import run_folder
from launcher.errors import RunFolderError
from launcher.run_folder import RunFolder
from mobo_tuner.nodes import check_config
from mobo_tuner.runs import bag_messages, journal, resume_config
from mobo_tuner.runs.run_id import check_run_id


def test_the_names_of_files_are_those_of_the_tuner() -> None:
    assert run_folder.JOURNAL_FILE == journal.FILE_NAME
    assert run_folder.CONFIG_FILE == resume_config.CONFIG_FILE == check_config.CONFIG_FILE


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        *((f"bag{suffix}", True) for suffix in bag_messages.SUFFIXES),
        (bag_messages.METADATA, True),
        ("journal.jsonl", False),
    ],
)
def test_a_bag_is_known_by_its_files(tmp_path: Path, name: str, expected: bool) -> None:
    file = tmp_path / "run" / name
    file.parent.mkdir()
    assert not bag_messages.is_bag(file)
    assert not run_folder.is_bag(file)
    file.touch()
    for path in (file.parent, *([file] if name != bag_messages.METADATA else [])):
        assert bag_messages.is_bag(path) is expected
        assert run_folder.is_bag(path) is expected


@pytest.mark.parametrize(
    "run_id",
    ["a", "0", "run-1", "A_b.c-d", "x" * 100, "", "x" * 101, ".a", "-a", "a/b", "ä", "a\n"],
)
def test_the_rule_for_names_of_runs_is_that_of_the_tuner(run_id: str) -> None:
    if run_folder.RUN_ID.fullmatch(run_id):
        assert check_run_id(run_id) == run_id
        return
    with pytest.raises(ValueError, match="run_id") as error:
        check_run_id(run_id)
    assert run_folder.RUN_ID_RULE.split(",")[0] in str(error.value)


def test_a_folder_that_is_gone_adopts_nothing(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(RunFolderError, match="file"):
        RunFolder(tmp_path / "file").adopt(tmp_path)


@pytest.mark.parametrize(
    ("machine", "shown"),
    [
        ({"section": "awa_sim", "files": []}, "awa_sim"),
        ({"command": "python mine.py", "folder": "/lab"}, "python mine.py"),
        ({"external": True}, "ROS domain 42"),
    ],
)
def test_the_machine_of_a_run_is_shown(
    tmp_path: Path, machine: dict[str, object], shown: str
) -> None:
    folder = RunFolder(tmp_path)
    folder.record({"domain_id": 42, "machine": machine})
    [line] = [line for line in folder.description().splitlines() if line.startswith("  machine")]
    assert shown in line


def test_the_end_of_a_run_is_recorded_where_no_file_can_be_made(tmp_path: Path) -> None:
    folder = RunFolder(tmp_path)
    folder.record({"state": "running", "reason": "x" * 5000})
    (tmp_path / ".run.json.draft").mkdir()  # as on a full disk, or in a read-only folder
    folder.record({"state": "failed", "reason": "the disk is full"})
    assert folder.facts() == {"state": "failed", "reason": "the disk is full"}
    (tmp_path / "run.json").unlink()
    with pytest.raises(RunFolderError, match=r"run\.json"):
        folder.record({"state": "failed"})


START = {"type": "start", "run_id": "a", "stamp": 1_700_000_000.0, "version": 1}
EVALUATION = {"type": "evaluation", "index": 6, "hypervolume": 2.5}


def states(runs_dir: Path) -> list[tuple[str, str, str]]:
    """Name, state and number of evaluations of each run."""
    rows = [folder.row() for folder in RunFolder.all(runs_dir)]
    return [(row[0], row[1], row[2]) for row in rows]


def test_runs_of_nodes_that_stay_are_listed_with_the_others(tmp_path: Path) -> None:
    with journal.Journal.create(tmp_path / "a", [START, EVALUATION]) as open_journal:
        assert states(tmp_path) == [("a", "running", "7")]
    assert states(tmp_path) == [("a", "died", "7")]
    for name, stop_reason, state in (
        ("b", "budget", "finished"),
        ("c", "canceled", "canceled"),
        ("d", "error", "failed"),
    ):
        end = {"type": "end", "stop_reason": stop_reason, "stamp": 1.7e9, "error_msg": "why"}
        journal.Journal.create(tmp_path / name, [START, end]).close()
        assert states(tmp_path)[-1] == (name, state, "-")
        assert "why" in RunFolder(tmp_path / name).description()
    assert RunFolder(tmp_path / "a").row()[4].startswith("2023-11-1")
    assert "mobo.py report a" in RunFolder(tmp_path / "a").description()
    assert open_journal.path.is_file()


def test_a_journal_that_does_not_begin_well_is_told(tmp_path: Path) -> None:
    (tmp_path / "a").mkdir()
    (tmp_path / "a" / "journal.jsonl").write_text("[]\n")
    with pytest.raises(RunFolderError, match="start record"):
        RunFolder(tmp_path / "a").row()
