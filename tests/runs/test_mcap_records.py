"""MCAP files as the reference writer makes them, read from their beginning; whole, cut and spoilt."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.writer import CompressionType, Writer

from mobo_tuner.runs.mcap_records import McapError, Message, Schema, read_messages

SCHEMAS = {
    "/a": Schema("std_msgs/msg/String", "ros2msg", "string data"),
    "/b": Schema("pkg/msg/Größe", "ros2idl", "@verbatim\n"),
}
COMPRESSIONS = list(CompressionType)
Sent = list[tuple[str, int, bytes]]

sent = st.lists(
    st.tuples(st.sampled_from(list(SCHEMAS)), st.integers(0, 2**63 - 1), st.binary(max_size=400)),
    max_size=20,
)


def written(messages: Sent, compression: CompressionType, chunk_size: int, chunked: bool) -> bytes:
    """The bytes of a file, by the library of the format's authors."""
    file = io.BytesIO()
    writer = Writer(file, chunk_size=chunk_size, compression=compression, use_chunking=chunked)
    writer.start(profile="ros2", library="test")
    channels = {
        topic: writer.register_channel(
            topic, "cdr", writer.register_schema(kind.name, kind.encoding, kind.text.encode())
        )
        for topic, kind in SCHEMAS.items()
    }
    for sequence, (topic, time, data) in enumerate(messages):
        writer.add_message(
            channels[topic], log_time=time, data=data, publish_time=0, sequence=sequence
        )
    writer.add_attachment(create_time=0, log_time=0, name="x", media_type="", data=b"\x05" * 50)
    writer.finish()
    return file.getvalue()


def read(folder: Path, content: bytes) -> list[Message]:
    path = folder / "file.mcap"
    path.write_bytes(content)
    return list(read_messages(path))


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("mcap")


@settings(max_examples=60, deadline=None)
@given(
    messages=sent,
    compression=st.sampled_from(COMPRESSIONS),
    chunk_size=st.integers(1, 2000),
    chunked=st.booleans(),
)
def test_every_message_is_read_as_it_was_written(
    folder: Path, messages: Sent, compression: CompressionType, chunk_size: int, chunked: bool
) -> None:
    found = read(folder, written(messages, compression, chunk_size, chunked))
    assert found == [Message(topic, SCHEMAS[topic], time, data) for topic, time, data in messages]


@pytest.mark.parametrize("chunked", [True, False])
@pytest.mark.parametrize("compression", COMPRESSIONS)
def test_a_file_that_was_cut_anywhere_gives_a_beginning(
    tmp_path: Path, compression: CompressionType, chunked: bool
) -> None:
    messages = [("/a", time, bytes([time]) * 40) for time in range(30)]
    content = written(messages, compression, 300, chunked)
    whole = read(tmp_path, content)
    counts = []
    for length in range(8, len(content), 7):
        found = read(tmp_path, content[:length])
        assert found == whole[: len(found)]
        counts.append(len(found))
    assert counts == sorted(counts)
    assert (counts[0], counts[-1]) == (0, 30)
    assert len(set(counts)) >= (5 if chunked and compression is not CompressionType.NONE else 30)


@pytest.mark.parametrize("chunked", [True, False])
@pytest.mark.parametrize("compression", COMPRESSIONS)
def test_spoilt_bytes_never_raise_and_keep_to_the_types_there_are(
    tmp_path: Path, compression: CompressionType, chunked: bool
) -> None:
    content = written([("/a", 7, b"\x00" * 60)] * 12, compression, 300, chunked)
    rng = np.random.default_rng(5)
    start = content.index(b"/a")
    for _ in range(300):
        spoilt = bytearray(content)
        for position in rng.integers(start + 2, len(content), rng.integers(1, 6)):
            spoilt[position] = rng.integers(256)
        found = read(tmp_path, bytes(spoilt))
        assert len(found) <= len(content)
        assert {message.schema.text for message in found} <= {s.text for s in SCHEMAS.values()}


def test_what_is_no_mcap_file_is_refused_in_a_sentence(tmp_path: Path) -> None:
    for content in (b"", b"\x89MCAP", b"SQLite format 3\x00" * 10):
        with pytest.raises(McapError, match=r"file\.mcap' is not an MCAP file"):
            read(tmp_path, content)
    with pytest.raises(McapError, match="cannot be read: No such file"):
        list(read_messages(tmp_path / "missing.mcap"))
    with pytest.raises(McapError, match="cannot be read: Is a directory"):
        list(read_messages(tmp_path))
