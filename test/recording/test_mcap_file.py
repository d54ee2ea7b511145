"""MCAP files: complete after every write, readable up to their first damage."""

import errno
import resource
import signal
import tracemalloc
from dataclasses import replace
from pathlib import Path
from unittest.mock import Mock

import numpy as np
import pytest
import zstandard
from mcap.data_stream import RecordBuilder
from mcap.reader import make_reader
from mcap.records import Chunk, Footer
from recorded_run import by_rosbags

from wbc_controller.recording.mcap_file import MAGIC, ChunkBuilder, McapFile, McapMessages, PackedChunk, Topic
from wbc_controller.recording.writer import FileSink

STRING = "string data\n"
TOPICS = [Topic(1, "/a", "std_msgs/msg/String", STRING), Topic(7, "/b", "std_msgs/msg/String", STRING)]
Found = list[tuple[str, int, bytes]]


def chunk(start: int, count: int = 5) -> PackedChunk:
    builder = ChunkBuilder()
    rng = np.random.default_rng(start)
    for i in range(count):
        builder.add(1 if i % 2 else 7, 1000 * start + i, rng.bytes(100))
    return builder.take()


def begun(path: Path, chunks: int = 1) -> McapFile:
    file = McapFile(path, TOPICS)
    for i in range(chunks):
        file.write(chunk(i))
    return file


def read(path: Path) -> tuple[Found, McapMessages]:
    messages = McapMessages(path)
    return [(topic.name, time, data) for topic, time, data in messages], messages


def by_index(path: Path) -> Found:
    """Return the messages by the indexed reader of `mcap`, which follows the chunk and message indexes."""
    with path.open("rb") as file:
        messages = make_reader(file, validate_crcs=True).iter_messages()
        return [(channel.topic, message.log_time, message.data) for _, channel, message in messages]


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "a.mcap"


@pytest.mark.parametrize("closed", [False, True])
def test_every_reader_finds_every_message(path, closed):
    file = McapFile(path, TOPICS)
    for i in range(4):
        file.write(chunk(i))
        assert len(by_rosbags(path)) == 5 * (i + 1)
    if closed:
        file.close()
    found, messages = read(path)
    assert len(found) == 20
    assert messages.damage == ""
    assert messages.topics == {topic.number: topic for topic in TOPICS}
    assert by_rosbags(path) == by_index(path) == found


def test_a_file_without_the_end_of_its_data_is_read(path):
    builder = RecordBuilder()
    Footer(0, 0, 0).write(builder)
    path.write_bytes(MAGIC + builder.end() + MAGIC)
    assert read(path)[0] == []


def test_the_summary_counts_messages_and_locates_chunks(path):
    begun(path, 3).close()
    with path.open("rb") as stream:
        summary = make_reader(stream).get_summary()
    assert summary.statistics.channel_message_counts == {1: 6, 7: 9}
    assert (summary.statistics.message_count, summary.statistics.chunk_count) == (15, 3)
    assert [index.message_start_time for index in summary.chunk_indexes] == [0, 1000, 2000]
    data = path.read_bytes()
    for index in summary.chunk_indexes:
        assert data[index.chunk_start_offset] == 0x06
        assert {data[offset] for offset in index.message_index_offsets.values()} == {0x07}


def test_a_file_that_could_not_begin_begins_when_there_is_room(path, monkeypatch):
    said = []
    sink = FileSink(path, said.append)
    monkeypatch.setattr(McapFile, "write", Mock(side_effect=OSError(errno.ENOSPC, "No space left on device")))
    sink.write(chunk(1), TOPICS, lambda at: chunk(0, 1))
    monkeypatch.undo()
    sink.write(chunk(2), TOPICS, lambda at: chunk(0, 1))
    sink.close()
    assert [time for _, time, _ in read(path)[0]] == [0, *range(2000, 2005)]
    failed, resumed = said
    assert failed.endswith("' cannot be written: No space left on device")
    assert resumed.endswith("' resumed; 1 chunk is missing")


def test_a_truncated_file_is_read_up_to_its_end(tmp_path):
    whole, part = tmp_path / "a.mcap", tmp_path / "part.mcap"
    file = McapFile(whole, TOPICS)
    ends = [file.end]
    for i in range(3):
        file.write(chunk(i))
        ends.append(file.end)
    file.close()
    data = whole.read_bytes()
    for length in range(8, len(data), 7):
        part.write_bytes(data[:length])
        found, messages = read(part)
        assert len(found) >= 5 * sum(length >= end for end in ends[1:])
        assert len(found) % 5 == 0
        assert messages.damage == "the last record is incomplete" or length >= ends[-1]


@pytest.mark.parametrize("seed", range(3))
def test_any_damaged_byte_ends_the_reading_with_a_reason_or_is_skipped(path, seed):
    rng = np.random.default_rng(seed)
    file = begun(path)
    middle = file.end
    file.write(chunk(1))
    file.close()
    whole = path.read_bytes()
    expected = read(path)[0]
    for place in rng.integers(middle, file.end, 200):
        data = bytearray(whole)
        data[place] ^= int(rng.integers(1, 256))
        path.write_bytes(data)
        found, messages = read(path)
        assert found == expected[: len(found)]
        assert len(found) in (5, 10)
        assert len(found) == 10 or messages.damage or data[middle] != whole[middle]


def test_damage_is_named(path):
    file = begun(path)
    middle = file.end
    file.write(chunk(1))
    data = bytearray(path.read_bytes())
    data[middle + 100] ^= 0xFF
    path.write_bytes(data)
    found, messages = read(path)
    assert len(found) == 5
    assert "damaged" in messages.damage
    data[middle + 1 : middle + 9] = b"\xff" * 7 + b"\x7f"  # the length of the record: more than any memory
    path.write_bytes(data)
    found, messages = read(path)
    assert len(found) == 5
    assert messages.damage == "the last record is incomplete"
    for text in (b"something else", b""):
        path.write_bytes(text)
        with pytest.raises(ValueError, match="not an MCAP file"):
            read(path)


def bomb(compression: str, data: bytes, declared: int) -> PackedChunk:
    """Return a chunk record with different data and declared size, and a checksum of 0 (unchecked)."""
    record, builder = Chunk(compression, data, 1, 0, 0, declared), RecordBuilder()
    record.write(builder)
    return replace(chunk(0), data=builder.end())


@pytest.mark.parametrize(
    ("compression", "declared", "damage"),
    [
        ("zstd", 10, "chunk declares 10 bytes, but contains 1073741824"),
        ("zstd", 1 << 30, f"chunk expands to {1 << 30} bytes"),
        ("lz4", 1 << 30, "chunk compression 'lz4'; valid: 'zstd', ''"),
    ],
)
def test_a_chunk_expands_only_to_its_declared_size_and_a_limit(path, compression, declared, damage):
    file = begun(path)
    zeros = zstandard.ZstdCompressor().compressobj(size=1 << 30)
    data = b"".join(zeros.compress(bytes(1 << 24)) for _ in range(64)) + zeros.flush()
    file.write(bomb(compression, data, declared))
    file.close()
    tracemalloc.start()
    found, messages = read(path)
    _, largest = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert len(found) == 5
    assert damage in messages.damage
    assert largest < 16 << 20


def test_a_chunk_of_unknown_content_size_expands_up_to_its_declared_size(path):
    file = begun(path)
    unknown = zstandard.ZstdCompressor(write_content_size=False).compress(bytes(100))
    file.write(bomb("zstd", unknown, 10))
    file.close()
    assert "a record is damaged" in read(path)[1].damage


def test_small_chunks_expand_in_all_to_a_multiple_of_the_file(path, monkeypatch):
    monkeypatch.setattr("wbc_controller.recording.mcap_file._LARGEST_CHUNK", 1000)
    monkeypatch.setattr("wbc_controller.recording.mcap_file._LARGEST_RATIO", 1)
    file = McapFile(path, TOPICS)
    for i in range(100):
        builder = ChunkBuilder()
        builder.add(1, i, bytes(900))
        file.write(builder.take())
    file.close()
    found, messages = read(path)
    assert 0 < len(found) < 100
    assert "in total 1 × file" in messages.damage


def test_a_dangling_symbolic_link_is_not_followed(tmp_path):
    link, target, said = tmp_path / "a.mcap", tmp_path / "elsewhere", []
    link.symlink_to(target)
    with pytest.raises(OSError, match=f"symbolic link to the missing file '{target}'"):
        McapFile(link, TOPICS)
    sink = FileSink(link, said.append)
    sink.probe()
    sink.write(chunk(1), TOPICS, lambda at: None)
    assert len(said) == 1
    assert "cannot be written: symbolic link to" in said[0]
    assert link.is_symlink()
    assert not target.exists()
    target.touch()
    begun(link).close()
    assert len(read(target)[0]) == 5


def test_log_times_never_decrease_and_times_of_arrival_are_kept(path):
    builder = ChunkBuilder()
    for time in (50, 40, 60):
        builder.add(1, time, b"xxxx")
    file = McapFile(path, TOPICS)
    file.write(builder.take())
    assert [time for _, time, _ in by_rosbags(path)] == [50, 50, 60]
    assert [time for _, time, _ in read(path)[0]] == [50, 40, 60]


def test_after_an_error_of_the_disk_the_file_is_as_before_and_can_be_continued(path):
    file = begun(path)
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    before = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (path.stat().st_size + 200, limits[1]))
    try:
        with pytest.raises(OSError, match="File too large") as caught:
            file.write(chunk(1))
        assert caught.value.errno == errno.EFBIG
        assert len(by_rosbags(path)) == 5
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
        signal.signal(signal.SIGXFSZ, before)
    file.write(chunk(2))
    file.close()
    assert len(by_rosbags(path)) == len(by_index(path)) == 10
