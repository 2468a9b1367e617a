"""Runs from bags that other recorders and converters wrote: every storage, compression and split."""

from __future__ import annotations

import itertools
import shutil
import sqlite3
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import mcap.writer
import pytest
import rosbags.convert
from mcap.reader import make_reader
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer

from mobo_tuner.runs.bag_messages import BagError, read_bag
from mobo_tuner.runs.history import History
from mobo_tuner.runs.journal import JournalError, JsonRecord, read_journal
from mobo_tuner.runs.rebuild import main, records_of_bag
from mobo_tuner.runs.recorded_run import RecordedRun
from mobo_tuner.runs.records import EndRecord
from mobo_tuner.runs.replay import compare
from mobo_tuner.runs.replay import main as replay
from mobo_tuner.runs.report.command import main as report
from robustness.offline_run import OfflineRun, toy, toy_optimizer
from robustness.synthetic_bag import write_bag

# The parser that ROS's type support imports does so.
pytestmark = pytest.mark.filterwarnings("ignore:module 'sre_:DeprecationWarning")

SEED = 7  # with failures, an operator's set-points and two changes
NO_HASH = "RIHS01_" + 64 * "0"
WITHOUT_RECORDS = ("/problem", "/evaluation")


class Recorded(NamedTuple):
    """One recorded message, as any recorder gets it."""

    topic: str
    type_name: str
    definition: str
    time: int
    data: bytes


@pytest.fixture(scope="module")
def journals(tmp_path_factory: pytest.TempPathFactory) -> dict[str, list[JsonRecord]]:
    """The records of two runs, without those of queued set-points, which are not in a bag."""
    folder = tmp_path_factory.mktemp("runs")
    found = {}
    for name, evaluations in (("one", 14), ("two", 5)):
        run = OfflineRun(folder / name, toy_optimizer(SEED), toy, SEED)
        for _ in range(evaluations):
            run.step()
        run.log.append(EndRecord(9.0, "budget"))
        run.log.close()
        found[name] = [r for r in read_journal(folder / name) if r["type"] != "queued"]
    return found


@pytest.fixture(scope="module")
def journal(journals: dict[str, list[JsonRecord]]) -> list[JsonRecord]:
    return journals["one"]


@pytest.fixture(scope="module")
def own_bag(journal: list[JsonRecord], tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("bags") / "bag"
    write_bag(path, journal)
    return path


@pytest.fixture(scope="module")
def sent(own_bag: Path) -> list[Recorded]:
    return messages_of(own_bag)


def messages_of(bag: Path) -> list[Recorded]:
    """The messages of our own bag, by the library of the format's authors."""
    [file] = bag.glob("*.mcap")
    with file.open("rb") as stream:
        return [
            Recorded(
                channel.topic, schema.name, schema.data.decode(), message.log_time, message.data
            )
            for schema, channel, message in make_reader(stream).iter_messages()
            if schema is not None
        ]


def record(
    bag: Path,
    messages: Sequence[Recorded],
    storage: StoragePlugin = StoragePlugin.MCAP,
    mode: CompressionMode = CompressionMode.NONE,
) -> Path:
    """Record messages as a plain recorder would."""
    writer = Writer(bag, version=9, storage_plugin=storage)
    writer.set_compression(mode, CompressionFormat.ZSTD)
    with writer:
        connections = {
            m.topic: writer.add_connection(
                m.topic, m.type_name, msgdef=m.definition, rihs01=NO_HASH
            )
            for m in {m.topic: m for m in messages}.values()
        }
        for m in messages:
            writer.write(connections[m.topic], m.time, m.data)
    return bag


def record_mcap(file: Path, messages: Sequence[Recorded], compression: str) -> Path:
    """Record messages with MCAP's own library."""
    with file.open("wb") as stream:
        kind = mcap.writer.CompressionType[compression]
        writer = mcap.writer.Writer(stream, compression=kind, chunk_size=2000)
        writer.start(profile="ros2", library="test")
        channels: dict[str, int] = {}
        for number, m in enumerate(messages):
            if m.topic not in channels:
                schema = writer.register_schema(m.type_name, "ros2msg", m.definition.encode())
                channels[m.topic] = writer.register_channel(m.topic, "cdr", schema)
            writer.add_message(channels[m.topic], m.time, m.data, m.time, number)
        writer.finish()
    return file


def converted(source: Path, target: Path, storage: str) -> Path:
    """Convert a bag as `rosbags-convert` does."""
    rosbags.convert.convert(
        [source],
        target,
        dst_storage=storage,
        dst_version=9,
        compress=None,
        compress_mode="none",
        default_typestore=None,
        typestore=None,
        exclude_topics=(),
        include_topics=(),
        exclude_msgtypes=(),
        include_msgtypes=(),
    )
    return target


def without_end(records: Sequence[JsonRecord]) -> list[JsonRecord]:
    return [r for r in records if r["type"] != "end"]


def of_type(records: Sequence[JsonRecord], kind: str) -> list[JsonRecord]:
    return [r for r in records if r["type"] == kind]


def assert_same(bag: Path, journal: list[JsonRecord], run_id: str | None = None) -> None:
    """Check that a bag gives the journal's records; its end has a stamp of whole seconds."""
    records = records_of_bag(bag, run_id)
    assert without_end(records) == without_end(journal)
    assert records[-1]["stop_reason"] == "budget"


@pytest.mark.parametrize(
    ("storage", "mode"),
    [
        *itertools.product(
            StoragePlugin, (CompressionMode.NONE, CompressionMode.MESSAGE, CompressionMode.FILE)
        ),
        (StoragePlugin.MCAP, CompressionMode.STORAGE),
    ],
)
def test_every_storage_and_compression_of_rosbag2_is_rebuilt(
    sent: list[Recorded],
    journal: list[JsonRecord],
    tmp_path: Path,
    storage: StoragePlugin,
    mode: CompressionMode,
) -> None:
    bag = record(tmp_path / "bag", sent, storage, mode)
    assert_same(bag, journal)
    (bag / "metadata.yaml").unlink()  # as a killed recorder leaves it
    assert_same(bag, journal)
    [file] = bag.iterdir()
    assert_same(file, journal)


@pytest.mark.parametrize("compression", ["NONE", "LZ4", "ZSTD"])
def test_every_compression_of_mcap_is_rebuilt(
    sent: list[Recorded], journal: list[JsonRecord], tmp_path: Path, compression: str
) -> None:
    assert_same(record_mcap(tmp_path / "bag.mcap", sent, compression), journal)


@pytest.mark.parametrize("storage", StoragePlugin)
def test_a_split_bag_is_rebuilt(
    sent: list[Recorded], journal: list[JsonRecord], tmp_path: Path, storage: StoragePlugin
) -> None:
    bag = tmp_path / "bag"
    bag.mkdir()
    for number, message in enumerate(sent):
        [file] = (
            f
            for f in record(tmp_path / f"part{number}", [message], storage).iterdir()
            if f.name != "metadata.yaml"
        )
        shutil.move(file, bag / f"bag_{number}{file.suffix}")
    assert len(list(bag.iterdir())) > 10
    assert_same(bag, journal)
    assert [m.data for m in read_bag(bag)] == [m.data for m in sent]


@pytest.mark.parametrize("storage", ["mcap", "sqlite3"])
def test_a_converted_bag_is_rebuilt(
    own_bag: Path, journal: list[JsonRecord], tmp_path: Path, storage: str
) -> None:
    assert_same(converted(own_bag, tmp_path / "bag", storage), journal)


@pytest.mark.parametrize("storage", StoragePlugin)
def test_topics_may_have_any_name(
    sent: list[Recorded], journal: list[JsonRecord], tmp_path: Path, storage: StoragePlugin
) -> None:
    names = {"/evaluation": "/line_2/tuner/results"}
    moved = [m._replace(topic=names.get(m.topic, f"/line_2{m.topic}")) for m in sent]
    assert_same(record(tmp_path / "bag", moved, storage), journal)


def test_one_of_several_runs_is_rebuilt(
    journals: dict[str, list[JsonRecord]], tmp_path: Path
) -> None:
    write_bag(tmp_path / "own", *journals.values())
    bag = record(tmp_path / "bag", messages_of(tmp_path / "own"), StoragePlugin.SQLITE3)
    for run_id, journal in journals.items():
        assert_same(bag, journal, run_id)
    with pytest.raises(BagError, match="several runs: one, two"):
        records_of_bag(bag)


@pytest.mark.parametrize("storage", StoragePlugin)
def test_without_run_records_the_problem_is_that_of_its_message(
    sent: list[Recorded],
    journal: list[JsonRecord],
    tmp_path: Path,
    storage: StoragePlugin,
    capsys: pytest.CaptureFixture[str],
) -> None:
    bag = record(tmp_path / "bag", [m for m in sent if m.topic in WITHOUT_RECORDS], storage)
    records = records_of_bag(bag)
    assert of_type(records, "evaluation") == of_type(journal, "evaluation")
    assert records[0]["settings"] == {}
    for kind in ("start", "change"):
        assert [r["problem"] for r in of_type(records, kind)] == [
            r["problem"] for r in of_type(journal, kind)
        ]
    assert [r["index"] for r in of_type(records, "change")] == [
        r["index"] for r in of_type(journal, "change")
    ]
    recorded, run = (RecordedRun.from_records(r) for r in (records, journal))
    assert recorded.hypervolume == run.hypervolume
    assert list(recorded.front) == list(run.front)

    folder = tmp_path / "rebuilt"
    assert main([str(bag), str(folder)]) == 0
    assert "settings of the tuner are unknown" in capsys.readouterr().out
    assert report([str(folder)]) == 0
    assert "settings of the tuner are unknown" in capsys.readouterr().out
    assert "unknown: the run was rebuilt" in (folder / "report.html").read_text()
    for path in (folder, bag):
        assert replay([str(path)]) == 1
        [line] = capsys.readouterr().err.splitlines()
        assert "settings of run 'one' are unknown" in line
    with pytest.raises(JournalError, match="settings of run 'one' are unknown"):
        compare(History.from_records(records))


def test_references_that_are_told_later_are_those_of_the_problem(
    sent: list[Recorded], journal: list[JsonRecord], tmp_path: Path
) -> None:
    without = [dict(r) for r in journal]
    objectives = {n: {"direction": "minimize", "unit": ""} for n in ("f1", "f2")}
    without[0]["problem"] = {**journal[0]["problem"], "objectives": objectives}
    write_bag(tmp_path / "early", without[:1])
    early = [m for m in messages_of(tmp_path / "early") if m.topic == "/problem"]
    later = [m for m in sent if m.topic in WITHOUT_RECORDS]
    bag = record(tmp_path / "bag", [early[0]._replace(time=later[0].time - 1), *later])
    records = records_of_bag(bag)
    assert records[0]["problem"] == journal[0]["problem"]
    assert len(of_type(records, "change")) == len(of_type(journal, "change"))


@pytest.mark.parametrize("storage", StoragePlugin)
@pytest.mark.parametrize(
    ("old", "new"),
    [("float64 hypervolume", "float32 hypervolume"), ("bool feasible", "bool allowed")],
)
def test_a_type_with_other_fields_is_refused(
    sent: list[Recorded], tmp_path: Path, storage: StoragePlugin, old: str, new: str
) -> None:
    other = [m._replace(definition=m.definition.replace(old, new)) for m in sent]
    bag = record(tmp_path / "bag", other, storage)
    with pytest.raises(BagError, match="another version of mobo_msgs_py/msg/"):
        records_of_bag(bag)


def test_an_sqlite_bag_that_was_cut_anywhere_holds_the_beginning(
    sent: list[Recorded], journal: list[JsonRecord], tmp_path: Path
) -> None:
    bag = record(tmp_path / "bag", sent, StoragePlugin.SQLITE3)
    [file] = bag.glob("*.db3")
    content = file.read_bytes()
    cut = tmp_path / "cut.db3"
    counts = []
    for length in range(0, len(content), 1000):
        cut.write_bytes(content[:length])
        try:
            records = without_end(records_of_bag(cut))
        except BagError:
            records = []
        assert records == without_end(journal)[: len(records)]
        counts.append(len(records))
    assert len(set(counts)) > 2


def test_the_log_of_a_killed_recorder_is_read_and_nothing_is_changed(
    sent: list[Recorded], journal: list[JsonRecord], tmp_path: Path
) -> None:
    bag = record(tmp_path / "bag", sent, StoragePlugin.SQLITE3)
    [file] = bag.glob("*.db3")
    killed = tmp_path / "killed"
    database = sqlite3.connect(file)
    database.execute("PRAGMA journal_mode = WAL")
    database.execute("CREATE TABLE kept AS SELECT * FROM messages")
    database.execute("DELETE FROM messages")
    database.commit()
    database.execute("PRAGMA wal_checkpoint(TRUNCATE)")
    database.execute("INSERT INTO messages SELECT * FROM kept")
    database.commit()
    shutil.copytree(bag, killed)
    database.close()
    (killed / f"{file.name}-shm").unlink()
    before = {f.name: f.read_bytes() for f in killed.iterdir()}
    assert f"{file.name}-wal" in before
    assert_same(killed, journal)
    assert {f.name: f.read_bytes() for f in killed.iterdir()} == before


@pytest.mark.parametrize(
    "script",
    [
        "CREATE TABLE other (id)",
        "CREATE TABLE topics (id); CREATE TABLE messages (id)",
        "CREATE VIEW topics AS WITH RECURSIVE n(id) AS (SELECT 1 UNION ALL SELECT id + 1 FROM n) "
        "SELECT id, 'x' AS name, 'x' AS type, 'cdr' AS serialization_format FROM n; "
        "CREATE TABLE messages (id, topic_id, timestamp, data)",
    ],
)
def test_another_database_is_refused_in_one_sentence(tmp_path: Path, script: str) -> None:
    file = tmp_path / "bag.db3"
    database = sqlite3.connect(file)
    database.executescript(script)
    database.close()
    with pytest.raises(BagError, match=r"bag\.db3'"):
        records_of_bag(file)


@pytest.mark.parametrize("name", ["bag.db3", "bag.mcap", "bag.db3.zstd", "bag.mcap.zstd"])
@pytest.mark.parametrize("content", [b"", b"x" * 5000, b"\x28\xb5\x2f\xfd" * 9])
def test_a_file_that_is_not_a_bag_is_refused_in_one_sentence(
    tmp_path: Path, name: str, content: bytes
) -> None:
    (tmp_path / name).write_bytes(content)
    for path in (tmp_path, tmp_path / name):
        with pytest.raises(BagError, match=r"is not an? |is no "):
            records_of_bag(path)


def test_a_folder_without_files_of_a_bag_is_refused(tmp_path: Path) -> None:
    (tmp_path / "metadata.yaml").write_text("")
    with pytest.raises(BagError, match="holds no MCAP file and no SQLite file"):
        records_of_bag(tmp_path)
