"""MCAP files that are whole after every write, and are read up to where they break off.

The format is that of https://mcap.dev/spec. A chunk is written in one call together with the end of the file, which the
next chunk replaces: whatever kills the process, readers find a file that ends properly, or a few bytes too many behind
the last whole chunk. The writers of `rosbags` and `mcap` write the end of a file only when it is closed, which a
process that is killed never does. The index of all chunks is written at the end of a recording alone; without it
readers scan.

The writer's process imports this file; it is meant to start fast, and imports nothing beside compression.
"""

from __future__ import annotations

import contextlib
import os
import struct
import sys
import zlib
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import BinaryIO

if sys.version_info >= (3, 14):
    from compression import zstd
else:
    from backports import zstd

MAGIC = b"\x89MCAP0\r\n"
_HEADER, _FOOTER, _SCHEMA, _CHANNEL, _MESSAGE, _CHUNK, _MESSAGE_INDEX, _CHUNK_INDEX = range(1, 9)
_STATISTICS, _DATA_END, _OFFSET = 0x0B, 0x0F, 0x0E
_LEVEL = 1
_MESSAGE_HEAD = struct.Struct("<BQHIQQ")
_CHUNK_HEAD = struct.Struct("<QQQI")


@dataclass(frozen=True, slots=True)
class Channel:
    """One topic of a file.

    Attributes:
        id: its number.
        topic: its name.
        type: of its messages, such as ``std_msgs/msg/String``.
        definition: of the type, as ``ros2msg`` has it.
        qos: the quality of service it is offered with, as YAML of rosbag2.
    """

    id: int
    topic: str
    type: str
    definition: str
    qos: str = ""


@dataclass(frozen=True, slots=True)
class Chunk:
    """Messages, compressed, as they stand in a file.

    Attributes:
        start: time of the first message, ns.
        end: time of the last message, ns.
        record: the chunk's record and its message indexes.
        length: of the chunk's record alone, bytes.
        offsets: of each channel's message index, from the beginning of `record`.
        counts: number of messages of each channel.
        compressed: size of the compressed messages, bytes.
        size: of the messages, bytes.
    """

    start: int
    end: int
    record: bytes
    length: int
    offsets: dict[int, int]
    counts: dict[int, int]
    compressed: int
    size: int


class ChunkBuilder:
    """Collects messages to a chunk. Times never go back: readers that scan a file take them as they come."""

    def __init__(self) -> None:
        self.size = 0
        self._newest = 0
        self._clear()

    def _clear(self) -> None:
        self.size, self._start = 0, 0
        self._parts: list[bytes] = []
        self._index: dict[int, list[tuple[int, int]]] = {}

    def add(self, channel: int, time: int, payload: bytes) -> None:
        """Add a message of a time in ns; where that is before the last one's, it counts as that."""
        logged = self._newest = max(time, self._newest)
        if not self._parts:
            self._start = logged
        self._index.setdefault(channel, []).append((logged, self.size))
        self._parts.append(_MESSAGE_HEAD.pack(_MESSAGE, 22 + len(payload), channel, 0, logged, max(time, 0)))
        self._parts.append(payload)
        self.size += _MESSAGE_HEAD.size + len(payload)

    def take(self) -> Chunk | None:
        """The chunk of all messages since the last call; None where there were none."""
        if not self._parts:
            return None
        raw = b"".join(self._parts)
        packed = zstd.compress(raw, _LEVEL)
        head = _CHUNK_HEAD.pack(self._start, self._newest, len(raw), zlib.crc32(raw))
        chunk = _record(_CHUNK, head + _text("zstd") + struct.pack("<Q", len(packed)) + packed)
        parts, offsets, at = [chunk], {}, len(chunk)
        for channel, entries in self._index.items():
            pairs = b"".join(struct.pack("<QQ", *entry) for entry in entries)
            index = _record(_MESSAGE_INDEX, struct.pack("<HI", channel, len(pairs)) + pairs)
            offsets[channel] = at
            parts.append(index)
            at += len(index)
        counts = {channel: len(entries) for channel, entries in self._index.items()}
        made = Chunk(
            self._start, self._newest, b"".join(parts), len(chunk), offsets, counts, len(packed), len(raw)
        )  # fmt: skip
        self._clear()
        return made


class McapFile:
    """A file that is being written; it is whole after every call."""

    def __init__(self, path: Path, channels: list[Channel]) -> None:
        """Create the file.

        Args:
            path: of the file; one that is there is replaced.
            channels: all topics.

        Raises:
            OSError: where it cannot be written.
        """
        self.path = path
        self._schemas: dict[str, int] = {}
        self._defined = b"".join(self._definitions(channels))
        self._types, self._count = len(self._schemas), len(channels)
        self._index: list[bytes] = []
        self._times = [(1 << 63) - 1, 0]
        self._counts: dict[int, int] = {}
        self._file: BinaryIO = path.open("wb", buffering=0)
        head = MAGIC + _record(_HEADER, _text("ros2") + _text("wbc_controller")) + self._defined
        self.end = 0
        self._put(head)

    def _definitions(self, channels: list[Channel]) -> Iterator[bytes]:
        for channel in channels:
            if channel.type not in self._schemas:
                number = self._schemas[channel.type] = len(self._schemas) + 1
                yield _record(
                    _SCHEMA,
                    struct.pack("<H", number) + _text(channel.type) + _text("ros2msg") + _text(channel.definition),
                )
            metadata = _text("offered_qos_profiles") + _text(channel.qos)
            yield _record(
                _CHANNEL,
                struct.pack("<HH", channel.id, self._schemas[channel.type]) + _text(channel.topic) + _text("cdr")
                + struct.pack("<I", len(metadata)) + metadata,
            )  # fmt: skip

    def write(self, chunk: Chunk) -> None:
        """Append a chunk.

        Raises:
            OSError: where it cannot be written; the chunks before it stay.
        """
        start = self.end
        self._put(chunk.record)
        offsets = b"".join(struct.pack("<HQ", channel, start + at) for channel, at in chunk.offsets.items())
        self._index.append(
            _record(
                _CHUNK_INDEX,
                struct.pack("<QQQQI", chunk.start, chunk.end, start, chunk.length, len(offsets)) + offsets
                + struct.pack("<Q", len(chunk.record) - chunk.length) + _text("zstd")
                + struct.pack("<QQ", chunk.compressed, chunk.size),
            )
        )  # fmt: skip
        self._times = [min(self._times[0], chunk.start), max(self._times[1], chunk.end)]
        for channel, count in chunk.counts.items():
            self._counts[channel] = self._counts.get(channel, 0) + count

    def close(self) -> None:
        """Write the index of all chunks, and close the file.

        Raises:
            OSError: where it cannot be written; the file stays readable without an index.
        """
        try:
            data_end = _record(_DATA_END, struct.pack("<I", 0))
            index = b"".join(self._index)
            counts = b"".join(struct.pack("<HQ", channel, count) for channel, count in sorted(self._counts.items()))
            statistics = _record(
                _STATISTICS,
                struct.pack("<QHIIIIQQI", sum(self._counts.values()), self._types, self._count, 0, 0, len(self._index),
                            *self._times, len(counts)) + counts,
            )  # fmt: skip
            summary = self.end + len(data_end)
            body = self._defined + index + statistics
            footer = _record(_FOOTER, struct.pack("<QQI", summary if self._index else 0, 0, 0))
            self._whole(data_end + (body if self._index else b"") + footer + MAGIC)
        finally:
            self._file.close()

    def _put(self, data: bytes) -> None:
        """Append data, with the end of a file that has no index behind it."""
        self._whole(data + _END)
        self.end += len(data)

    def _whole(self, data: bytes) -> None:
        """Write at the end of the data, all or nothing."""
        self._file.seek(self.end)
        view = memoryview(data)
        try:
            while view:
                view = view[self._file.write(view) :]
        except OSError:
            with contextlib.suppress(OSError):  # what was written before is worth more than a whole end
                self._file.truncate(self.end)
                self._file.seek(self.end)
                self._file.write(_END)
            raise


def _record(code: int, content: bytes) -> bytes:
    return struct.pack("<BQ", code, len(content)) + content


def _text(text: str) -> bytes:
    data = text.encode()
    return struct.pack("<I", len(data)) + data


#: The end of a file without an index.
_END = _record(_DATA_END, struct.pack("<I", 0)) + _record(_FOOTER, struct.pack("<QQI", 0, 0, 0)) + MAGIC


@dataclass(slots=True)
class Contents:
    """A file that was read.

    Attributes:
        channels: by number.
        torn: why it was read up to some point alone; empty where it is whole.
    """

    channels: dict[int, Channel] = field(default_factory=dict)
    torn: str = ""


def read(path: Path, contents: Contents) -> Iterator[tuple[int, int, bytes]]:
    """Read the messages of a file, up to where it breaks off: channel, time in ns, and bytes.

    Args:
        path: of the file.
        contents: is filled on the way.

    Raises:
        OSError: where it cannot be read.
        ValueError: where it is no MCAP file.
    """
    with path.open("rb") as file:
        size = os.fstat(file.fileno()).st_size
        if file.read(len(MAGIC)) != MAGIC:
            raise ValueError("it does not begin as an MCAP file")
        schemas: dict[int, tuple[str, str]] = {}
        while True:
            head = file.read(9)
            if len(head) < 9:
                contents.torn = "it ends without a footer"
                return
            code, length = struct.unpack("<BQ", head)
            if code in (_FOOTER, _DATA_END):
                return
            if code not in (_HEADER, _SCHEMA, _CHANNEL, _CHUNK, _MESSAGE_INDEX):
                contents.torn = f"it has a record of the kind {code}"
                return
            if length > size - file.tell():  # nor is so much memory asked for
                contents.torn = "its last record is not whole"
                return
            body = file.read(length)
            try:
                if code == _CHUNK:
                    yield from _messages(body)
                elif code == _SCHEMA:
                    name, at = _read_text(body, 2)
                    _, at = _read_text(body, at)
                    schemas[struct.unpack_from("<H", body)[0]] = name, _read_text(body, at)[0]
                elif code == _CHANNEL:
                    number, schema = struct.unpack_from("<HH", body)
                    topic, _ = _read_text(body, 4)
                    contents.channels[number] = Channel(number, topic, *schemas[schema])
            except (struct.error, KeyError, UnicodeDecodeError, zstd.ZstdError) as error:
                contents.torn = f"a record of the kind {code} is damaged ({error})"
                return


def _messages(chunk: bytes) -> Iterator[tuple[int, int, bytes]]:
    _, _, size, crc = _CHUNK_HEAD.unpack_from(chunk)
    compression, at = _read_text(chunk, _CHUNK_HEAD.size)
    raw = chunk[at + 8 :]
    if compression == "zstd":
        raw = zstd.decompress(raw)
    elif compression:
        raise struct.error(f"its compression is {compression!r}")
    if len(raw) != size or (crc and zlib.crc32(raw) != crc):
        raise struct.error("its checksum is another one")
    at = 0
    while at < len(raw):
        code, length = struct.unpack_from("<BQ", raw, at)
        if code == _MESSAGE:
            _, _, channel, _, _, time = _MESSAGE_HEAD.unpack_from(raw, at)
            yield channel, time, raw[at + _MESSAGE_HEAD.size : at + 9 + length]
        at += 9 + length


def _read_text(data: bytes, at: int) -> tuple[str, int]:
    (length,) = struct.unpack_from("<I", data, at)
    return data[at + 4 : at + 4 + length].decode(), at + 4 + length
