"""Files that a public reader opens, wherever they break off."""

from __future__ import annotations

import errno
import resource
import signal
import struct
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from rosbags.rosbag2.storage_mcap import McapReader

from wbc_controller.recording.mcap import Channel, ChunkBuilder, Contents, McapFile, read
from wbc_controller.recording.writer import Sink

STRING = "string data\n"
CHANNELS = [Channel(1, "/a", "std_msgs/msg/String", STRING), Channel(7, "/b", "std_msgs/msg/String", STRING)]


def chunk(start: int, count: int = 5) -> object:
    builder = ChunkBuilder()
    rng = np.random.default_rng(start)
    for i in range(count):
        builder.add(1 if i % 2 else 7, 1000 * start + i, rng.bytes(100))
    return builder.take()


def messages(path: Path) -> tuple[list[tuple[int, int, bytes]], Contents]:
    contents = Contents()
    return list(read(path, contents)), contents


def by_rosbags(path: Path) -> list[tuple[str, int, bytes]]:
    reader = McapReader(path)
    reader.open()
    found = [(connection.topic, time, bytes(data)) for connection, time, data in reader.messages(reader.connections)]
    reader.close()
    return found


def named(found: list[tuple[int, int, bytes]]) -> list[tuple[str, int, bytes]]:
    return [("/a" if channel == 1 else "/b", time, data) for channel, time, data in found]


@pytest.mark.parametrize("closed", [False, True])
def test_every_reader_finds_every_message(tmp_path, closed):
    path = tmp_path / "a.mcap"
    file = McapFile(path, CHANNELS)
    for i in range(4):
        file.write(chunk(i))
        assert len(by_rosbags(path)) == 5 * (i + 1)
    if closed:
        file.close()
    found, contents = messages(path)
    assert len(found) == 20
    assert contents.torn == ""
    assert contents.channels == {channel.id: channel for channel in CHANNELS}
    assert by_rosbags(path) == named(found)


def records(data: bytes, at: int, end: int) -> Iterator[tuple[int, int, bytes]]:
    """The records of a part of a file: place, code and content."""
    while at < end:
        code, length = struct.unpack_from("<BQ", data, at)
        yield at, code, data[at + 9 : at + 9 + length]
        at += 9 + length


def test_the_index_says_where_each_chunk_and_its_messages_are(tmp_path):
    """By https://mcap.dev/spec; no reader here needs all of it."""
    path = tmp_path / "a.mcap"
    file = McapFile(path, CHANNELS)
    for i in range(3):
        file.write(chunk(i))
    file.close()
    data = path.read_bytes()
    (summary,) = struct.unpack_from("<Q", data, len(data) - 8 - 20)
    codes = {at: code for at, code, _ in records(data, 8, len(data) - 8)}
    assert codes[summary] == 0x03  # a schema
    indices = [content for _, code, content in records(data, summary, len(data) - 8) if code == 0x08]
    assert len(indices) == 3
    for i, index in enumerate(indices):
        start, end, at, length, size = struct.unpack_from("<QQQQI", index)
        assert (start, end, codes[at]) == (1000 * i, 1000 * i + 4, 0x06)
        assert codes[at + length] == 0x07  # the message indexes stand behind the chunk
        offsets = dict(struct.iter_unpack("<HQ", index[36 : 36 + size]))
        for channel, place in offsets.items():
            assert codes[place] == 0x07
            assert struct.unpack_from("<H", data, place + 9) == (channel,)
        assert set(offsets) == {1, 7}


def test_a_file_that_could_not_begin_begins_when_there_is_room(tmp_path, monkeypatch):
    path, said = tmp_path / "a.mcap", []
    sink = Sink(path, said.append)

    def no_room(*_: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(McapFile, "write", no_room)
    sink.write(chunk(1), CHANNELS, lambda at: chunk(0, 1))
    monkeypatch.undo()
    sink.write(chunk(2), CHANNELS, lambda at: chunk(0, 1))
    sink.close()
    assert [time for _, time, _ in messages(path)[0]] == [0, *range(2000, 2005)]
    assert len(said) == 2


def test_wherever_a_file_breaks_off_what_is_before_is_read(tmp_path):
    whole, part = tmp_path / "a.mcap", tmp_path / "part.mcap"
    file = McapFile(whole, CHANNELS)
    ends = [file.end]
    for i in range(3):
        file.write(chunk(i))
        ends.append(file.end)
    file.close()
    data = whole.read_bytes()
    for length in range(8, len(data), 7):
        part.write_bytes(data[:length])
        found, contents = messages(part)
        assert len(found) >= 5 * sum(length >= end for end in ends[1:])
        assert len(found) % 5 == 0
        assert contents.torn or length >= ends[-1]


def test_damaged_bytes_end_the_reading_with_a_reason(tmp_path):
    path = tmp_path / "a.mcap"
    file = McapFile(path, CHANNELS)
    file.write(chunk(0))
    middle = file.end
    file.write(chunk(1))
    data = bytearray(path.read_bytes())
    data[middle + 100] ^= 0xFF
    path.write_bytes(data)
    found, contents = messages(path)
    assert len(found) == 5
    assert "damaged" in contents.torn
    data[middle + 1 : middle + 9] = b"\xff" * 7 + b"\x7f"  # the length of the record: more than any memory
    path.write_bytes(data)
    found, contents = messages(path)
    assert len(found) == 5
    assert "not whole" in contents.torn
    path.write_bytes(b"something else")
    with pytest.raises(ValueError, match="does not begin as an MCAP file"):
        messages(path)


def test_times_never_go_back_in_a_file_and_those_of_arrival_are_kept(tmp_path):
    builder, path = ChunkBuilder(), tmp_path / "a.mcap"
    for time in (50, 40, 60):
        builder.add(1, time, b"xxxx")
    file = McapFile(path, CHANNELS)
    file.write(builder.take())
    assert [time for _, time, _ in by_rosbags(path)] == [50, 50, 60]
    assert [time for _, time, _ in messages(path)[0]] == [50, 40, 60]


def test_a_full_disk_leaves_the_file_as_it_was_and_it_goes_on_when_there_is_room(tmp_path):
    path = tmp_path / "a.mcap"
    file = McapFile(path, CHANNELS)
    file.write(chunk(0))
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
    assert len(by_rosbags(path)) == 10
