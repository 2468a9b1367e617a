"""The journal: what is written is there, also after the writer is killed."""

import errno
import json
import math
import os
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from mobo_tuner.runs import journal as journal_module
from mobo_tuner.runs.journal import (
    COUNT_FILE_NAME,
    FILE_NAME,
    Journal,
    JournalError,
    JournalWriteError,
    append_record,
    journal_line,
    read_journal,
)

START = {
    "type": "start",
    "run_id": "run1",
    "stamp": 12.5,
    "problem": {"variables": {}},
    "settings": {"seed": 3},
}


def test_records_come_back_in_order(tmp_path: Path) -> None:
    with Journal.create(tmp_path / "runs" / "run1", [START]) as journal:
        journal.append({"type": "evaluation", "index": 0, "setpoint": {"µ": 1.5}})
        journal.append({"type": "end", "stop_reason": "budget"})
    assert journal.path == tmp_path / "runs" / "run1" / FILE_NAME
    expected = [
        START,
        {"type": "evaluation", "index": 0, "setpoint": {"µ": 1.5}},
        {"type": "end", "stop_reason": "budget"},
    ]
    assert read_journal(journal.path) == expected
    assert read_journal(tmp_path / "runs" / "run1") == expected


def test_a_record_is_in_the_file_when_append_returns(tmp_path: Path) -> None:
    with Journal.create(tmp_path, [START]) as journal:
        for index in range(3):
            journal.append({"type": "evaluation", "index": index})
            assert len(read_journal(tmp_path)) == index + 2


def test_numbers_that_are_not_finite_become_null_and_the_json_is_strict(tmp_path: Path) -> None:
    with Journal.create(tmp_path, [START]) as journal:
        journal.append(
            {
                "type": "evaluation",
                "diagnostics": {"a": [math.nan, math.inf], "b": (-math.inf, 1.0)},
                "hypervolume": np.float64(2.5),
                "array": np.array([1.0, np.nan]),
                "flag": np.bool_(True),
                "index": np.int64(7),
            }
        )

    def refuse(constant: str) -> None:
        raise AssertionError(constant)

    line = journal.path.read_text(encoding="utf-8").splitlines()[1]
    assert json.loads(line, parse_constant=refuse) == {
        "type": "evaluation",
        "diagnostics": {"a": [None, None], "b": [None, 1.0]},
        "hypervolume": 2.5,
        "array": [1.0, None],
        "flag": True,
        "index": 7,
        "line": 2,
        "sum": line[-18:-2],
    }


def test_text_with_a_line_break_stays_one_line(tmp_path: Path) -> None:
    with Journal.create(tmp_path, [START]) as journal:
        journal.append({"type": "end", "error_msg": "one\ntwo\u2028three"})
    assert read_journal(tmp_path)[1]["error_msg"] == "one\ntwo\u2028three"


def test_an_existing_journal_is_never_overwritten(tmp_path: Path) -> None:
    Journal.create(tmp_path, [START]).close()
    before = (tmp_path / FILE_NAME).read_bytes()
    with pytest.raises(FileExistsError, match="exists already"):
        Journal.create(tmp_path, [{"type": "start", "run_id": "other"}])
    assert (tmp_path / FILE_NAME).read_bytes() == before


@pytest.mark.parametrize("hard_links", [True, False])
def test_a_new_journal_gets_its_name_only_once_whole(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, hard_links: bool
) -> None:
    def link(*_: object) -> None:
        raise OSError(errno.EPERM, "Operation not permitted")

    if not hard_links:
        monkeypatch.setattr(os, "link", link)
    with Journal.create(tmp_path, [START]) as journal:
        journal.append({"type": "end"})
    kept = {FILE_NAME, COUNT_FILE_NAME}
    assert {path.name for path in tmp_path.iterdir()} == kept
    assert [r["type"] for r in read_journal(tmp_path)] == ["start", "end"]
    with pytest.raises(FileExistsError, match="exists already"):
        Journal.create(tmp_path, [{"type": "start", "run_id": "other"}])
    assert {path.name for path in tmp_path.iterdir()} == kept
    assert len(read_journal(tmp_path)) == 2


def test_a_header_that_is_no_json_leaves_nothing_behind(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="cannot hold"):
        Journal.create(tmp_path / "run", [{"type": "start", "problem": object()}])
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize(
    "record", [{"index": 1}, {"type": 3}, {"type": "end", "x": {1, 2}}, {}], ids=str
)
def test_a_record_that_is_none_is_refused(tmp_path: Path, record: dict[str, object]) -> None:
    with Journal.create(tmp_path, [START]) as journal, pytest.raises(ValueError, match="journal"):
        journal.append(record)
    assert len(read_journal(tmp_path)) == 1


def test_a_closed_journal_refuses_records(tmp_path: Path) -> None:
    journal = Journal.create(tmp_path, [START])
    journal.close()
    journal.close()
    with pytest.raises(ValueError, match="closed"):
        journal.append({"type": "end"})


@pytest.mark.parametrize(
    "tail",
    [b'{"type": "evaluation", "ind', b'{"type"', b"\x00\x00\x00\xff", b'"text"\n', b"{}\n"],
)
def test_a_damaged_last_line_is_left_out(tmp_path: Path, tail: bytes) -> None:
    with Journal.create(tmp_path, [START]) as journal:
        journal.append({"type": "evaluation", "index": 0})
    with journal.path.open("ab") as file:
        file.write(tail)
    assert [r["type"] for r in read_journal(tmp_path)] == ["start", "evaluation"]


def test_a_last_line_that_lacks_only_its_end_is_kept(tmp_path: Path) -> None:
    with Journal.create(tmp_path, [START]) as journal:
        journal.append({"type": "end", "stop_reason": "budget"})
    journal.path.write_bytes(journal.path.read_bytes().rstrip())
    assert [r["type"] for r in read_journal(tmp_path)] == ["start", "end"]


def test_a_damaged_earlier_line_is_an_error_that_names_it(tmp_path: Path) -> None:
    with Journal.create(tmp_path, [START]) as journal:
        journal.append({"type": "evaluation", "index": 0})
        journal.append({"type": "end"})
    lines = journal.path.read_bytes().splitlines()
    lines[1] = lines[1][:10]
    journal.path.write_bytes(b"\n".join(lines))
    with pytest.raises(JournalError, match="line 2 of the journal") as caught:
        read_journal(tmp_path)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("order", "line"), [("acd", 2), ("abbcd", 3), ("acbd", 2), ("abd", 3), ("abc", 4), ("a", 2)]
)
def test_a_line_that_is_missing_or_was_moved_is_an_error(
    tmp_path: Path, order: str, line: int
) -> None:
    with Journal.create(tmp_path, [START, {"type": "change", "index": 0}]) as journal:
        journal.append({"type": "queued"})
    append_record(tmp_path, {"type": "end"})
    assert [r["type"] for r in read_journal(tmp_path)] == ["start", "change", "queued", "end"]
    lines = dict(zip("abcd", journal.path.read_bytes().splitlines(), strict=True))
    journal.path.write_bytes(b"\n".join(lines[name] for name in order))
    with pytest.raises(JournalError, match=rf"^line {line} of .*{FILE_NAME}.* missing"):
        read_journal(tmp_path)


def test_whatever_is_changed_in_a_line_is_an_error_that_names_it(tmp_path: Path) -> None:
    with Journal.create(tmp_path, [START, {"type": "change", "index": 0}]) as journal:
        journal.append({"type": "evaluation", "index": 0, "setpoint": {"x": 1.25}})
    append_record(tmp_path, {"type": "end"})
    whole = journal.path.read_bytes()
    lines = whole.splitlines(keepends=True)
    rng = np.random.default_rng(5)
    for number, line in enumerate(lines, start=1):
        for place in rng.choice(len(line) - 2, 20, replace=False):
            other = b"7" if line[place : place + 1] != b"7" else b"8"
            changed = line[:place] + other + line[place + 1 :]
            journal.path.write_bytes(b"".join((*lines[: number - 1], changed, *lines[number:])))
            with pytest.raises(JournalError, match=rf"^line {number} of|begin with a start"):
                read_journal(tmp_path)
    for stripped in (lines[2].rpartition(b',"sum"')[0] + b"}\n", lines[2].replace(b",", b", ")):
        journal.path.write_bytes(b"".join((*lines[:2], stripped, lines[3])))
        with pytest.raises(JournalError, match=r"^line 3 of .* was changed"):
            read_journal(tmp_path)
    journal.path.write_bytes(whole)
    assert len(read_journal(tmp_path)) == 4
    assert journal_module.main([str(tmp_path)]) == 0


def test_a_last_line_that_was_whole_is_not_left_out(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with Journal.create(tmp_path, [START]) as journal:
        journal.append({"type": "evaluation", "index": 0})
    journal.path.write_bytes(journal.path.read_bytes()[:-9])
    assert journal_module.main([str(tmp_path)]) == 1
    [sentence] = capsys.readouterr().err.splitlines()
    assert sentence.startswith("line 2 of the journal")
    (tmp_path / COUNT_FILE_NAME).write_text("1\n")  # as if it was killed while it wrote the line
    assert len(read_journal(tmp_path)) == 1
    append_record(tmp_path, {"type": "end"})
    assert [r["type"] for r in read_journal(tmp_path)] == ["start", "end"]


def test_journals_of_before_have_neither_checksums_nor_a_count(tmp_path: Path) -> None:
    lines = [journal_line(START | {"line": 1}), journal_line({"type": "queued", "line": 2})]
    (tmp_path / FILE_NAME).write_bytes(b"".join(lines))
    assert read_journal(tmp_path) == [START, {"type": "queued"}]
    append_record(tmp_path, {"type": "move"})  # from here on there are
    append_record(tmp_path, {"type": "state"})
    assert [r["type"] for r in read_journal(tmp_path)] == ["start", "queued", "move", "state"]
    kept = (tmp_path / FILE_NAME).read_bytes()
    (tmp_path / FILE_NAME).write_bytes(kept.replace(b'"move"', b'"mode"'))
    with pytest.raises(JournalError, match=r"^line 3 of .* was changed"):
        read_journal(tmp_path)
    (tmp_path / FILE_NAME).write_bytes(b"".join(kept.splitlines(keepends=True)[:3]))
    with pytest.raises(JournalError, match=r"^line 4 of .* missing"):
        read_journal(tmp_path)


@pytest.mark.parametrize("content", [b"", b"\n\n", b'{"type": "end"}\n', b"broken"])
def test_a_journal_without_a_start_is_an_error(tmp_path: Path, content: bytes) -> None:
    (tmp_path / FILE_NAME).write_bytes(content)
    with pytest.raises(JournalError, match="does not begin with a start record"):
        read_journal(tmp_path)


def test_a_missing_journal_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(JournalError, match="cannot be read: No such file"):
        read_journal(tmp_path)


def test_a_journal_that_was_deleted_is_told_of(tmp_path: Path) -> None:
    with Journal.create(tmp_path, [START]) as journal:
        journal.append({"type": "queued"})
        journal.path.unlink()
        with pytest.raises(JournalWriteError, match="cannot be written: it was deleted"):
            journal.append({"type": "end"})


def test_a_full_disk_leaves_whole_lines_and_the_journal_usable(tmp_path: Path) -> None:
    script = """
import json, resource, sys
from mobo_tuner.runs.journal import Journal
journal = Journal.create(sys.argv[1], [{"type": "start", "run_id": "r"}])
soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
resource.setrlimit(resource.RLIMIT_FSIZE, (1000, hard))
try:
    journal.append({"type": "evaluation", "text": "x" * 2000})
except OSError as error:
    print(type(error).__name__)
resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
journal.append({"type": "end"})
"""
    done = subprocess.run(
        [sys.executable, "-c", script, str(tmp_path)],
        capture_output=True,
        text=True,
        timeout=30,
        check=True,
    )
    assert done.stdout.strip() == "JournalWriteError"
    assert [r["type"] for r in read_journal(tmp_path)] == ["start", "end"]


def test_a_journal_begins_with_its_start_whenever_its_writer_was_killed(tmp_path: Path) -> None:
    script = """
import itertools, pathlib, sys
from mobo_tuner.runs.journal import Journal
for index in itertools.count():
    Journal.create(pathlib.Path(sys.argv[1]) / str(index), [{"type": "start", "run_id": "r", "text": "x" * 100_000}])
    print(index, flush=True)
"""
    for kill in range(5):
        folder = tmp_path / str(kill)
        with subprocess.Popen(
            [sys.executable, "-c", script, str(folder)], stdout=subprocess.PIPE, text=True
        ) as process:
            assert process.stdout is not None
            while int(process.stdout.readline()) < 10 + kill:
                pass
            os.kill(process.pid, signal.SIGKILL)
        journals = list(folder.glob(f"*/{FILE_NAME}"))
        assert len(journals) > 10
        assert all(len(read_journal(path)) == 1 for path in journals)


def test_every_announced_record_survives_kill_9(tmp_path: Path) -> None:
    script = """
import itertools, sys
from mobo_tuner.runs.journal import Journal
journal = Journal.create(sys.argv[1], [{"type": "start", "run_id": "r"}])
for index in itertools.count():
    journal.append({"type": "evaluation", "index": index, "text": "x" * 5000})
    print(index, flush=True)
"""
    with subprocess.Popen(
        [sys.executable, "-c", script, str(tmp_path)], stdout=subprocess.PIPE, text=True
    ) as process:
        assert process.stdout is not None
        announced = -1
        while announced < 20:
            announced = int(process.stdout.readline())
        os.kill(process.pid, signal.SIGKILL)
        rest = [line for line in process.stdout.read().splitlines() if line]
    announced = max([announced, *map(int, rest)])
    indices = [r["index"] for r in read_journal(tmp_path) if r["type"] == "evaluation"]
    assert indices[: announced + 1] == list(range(announced + 1))
    assert len(indices) <= announced + 2
