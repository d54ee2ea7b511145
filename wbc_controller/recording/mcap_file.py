"""MCAP files, readable up to their first damage.

The package `mcap` (https://mcap.dev/spec) writes the end of a file only on closing. `McapFile` writes an end after each
chunk, so that a killed process leaves a complete file; closing adds the index of chunks.
"""

import contextlib
import errno
import os
import struct
import zlib
from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import BinaryIO

import zstandard
from mcap import records as rec
from mcap.data_stream import RecordBuilder
from mcap.exceptions import EndOfFile, McapError, RecordLengthLimitExceeded
from mcap.stream_reader import StreamReader, breakup_chunk

MAGIC = b"\x89MCAP0\r\n"
_COMPRESSION_LEVEL = 1
CHUNK_BYTES = 1 << 20  # size of a full chunk
#: Largest expanded chunk, bytes (`CHUNK_BYTES` plus a message), and ratio of all expanded chunks to the file.
_LARGEST_CHUNK, _LARGEST_RATIO = 64 << 20, 1000
#: Errors of parser and decompressors on damaged data.
_DAMAGE = (McapError, struct.error, zstandard.ZstdError, ValueError, KeyError, OverflowError, MemoryError, RuntimeError)


@dataclass(frozen=True, slots=True)
class Topic:
    """One topic of a file."""

    number: int  # channel
    name: str
    type: str  # such as ``std_msgs/msg/String``
    definition: str  # of the type, in the format ``ros2msg``


@dataclass(frozen=True, slots=True)
class PackedChunk:
    """Serialized, compressed messages."""

    data: bytes  # chunk record, and one message index per channel
    index: rec.ChunkIndex  # entry of the file's index, with offsets from the start of `data`
    counts: dict[int, int]  # messages per channel


def exists(path: Path) -> bool:
    """Return True if a file exists; a symbolic link to a missing file raises `OSError`."""
    if path.is_symlink() and not path.exists():
        raise OSError(errno.ENOENT, f"symbolic link to the missing file {str(path.readlink())!r}")
    return path.exists()


class ChunkBuilder:
    """Builder of a chunk with non-decreasing log times, for readers without an index."""

    def __init__(self) -> None:
        self._newest = 0
        self._messages = RecordBuilder()
        self._indexes: dict[int, rec.MessageIndex] = {}

    @property
    def size(self) -> int:
        """Bytes."""
        return int(self._messages.count)

    def add(self, channel: int, time: int, payload: bytes) -> None:
        """Add a message; time in ns."""
        self._newest = max(time, self._newest)
        index = self._indexes.setdefault(channel, rec.MessageIndex(channel, []))
        index.records.append((self._newest, self._messages.count))
        rec.Message(
            channel_id=channel, sequence=0, log_time=self._newest, publish_time=max(time, 0), data=payload
        ).write(self._messages)  # fmt: skip

    def take(self) -> PackedChunk | None:
        """Return a chunk of the new messages, or None."""
        if not self._indexes:
            return None
        indexes, self._indexes = self._indexes, {}
        raw = self._messages.end()
        chunk = rec.Chunk(
            compression="zstd",
            data=zstandard.compress(raw, _COMPRESSION_LEVEL),
            message_start_time=min(index.records[0][0] for index in indexes.values()),
            message_end_time=self._newest,
            uncompressed_crc=zlib.crc32(raw),
            uncompressed_size=len(raw),
        )
        builder, offsets = RecordBuilder(), {}
        chunk.write(builder)
        length = builder.count
        for channel, index in indexes.items():
            offsets[channel] = builder.count
            index.write(builder)
        entry = rec.ChunkIndex(
            chunk_start_offset=0,
            chunk_length=length,
            message_index_offsets=offsets,
            message_index_length=builder.count - length,
            message_start_time=chunk.message_start_time,
            message_end_time=chunk.message_end_time,
            compression=chunk.compression,
            compressed_size=len(chunk.data),
            uncompressed_size=len(raw),
        )
        return PackedChunk(builder.end(), entry, {channel: len(index.records) for channel, index in indexes.items()})


class McapFile:
    """File in writing, complete after every call."""

    def __init__(self, path: Path, topics: Iterable[Topic]) -> None:
        """Create or replace the file; raises `OSError`, also for a symbolic link to a missing file."""
        self.path = path
        self.end = 0  # size without the end records, bytes
        schemas: dict[str, rec.Schema] = {}
        channels = []
        metadata = {"offered_qos_profiles": ""}  # for rosbag2
        for topic in topics:
            new = rec.Schema(id=len(schemas) + 1, name=topic.type, encoding="ros2msg", data=topic.definition.encode())
            schema = schemas.setdefault(topic.type, new)
            channels.append(rec.Channel(topic.number, topic.name, "cdr", metadata, schema.id))
        self._definitions: tuple[rec.McapRecord, ...] = (*schemas.values(), *channels)
        self._indexes: list[rec.ChunkIndex] = []
        self._counts: Counter[int] = Counter()  # messages by topic
        self._file: BinaryIO = path.open("wb" if exists(path) else "xb", buffering=0)
        self._append(MAGIC + _serialized(rec.Header("ros2", "wbc_controller"), *self._definitions))

    def write(self, chunk: PackedChunk | None) -> None:
        """Append a chunk, if any; after an `OSError` the earlier chunks remain."""
        if chunk is None:
            return
        start = self.end
        self._append(chunk.data)
        offsets = {channel: start + offset for channel, offset in chunk.index.message_index_offsets.items()}
        self._indexes.append(replace(chunk.index, chunk_start_offset=start, message_index_offsets=offsets))
        self._counts.update(chunk.counts)

    def close(self) -> None:
        """Write the index and close; after an `OSError` the file stays readable without index."""
        try:
            if self._indexes:
                statistics = rec.Statistics(
                    attachment_count=0,
                    metadata_count=0,
                    schema_count=sum(isinstance(record, rec.Schema) for record in self._definitions),
                    channel_count=sum(isinstance(record, rec.Channel) for record in self._definitions),
                    chunk_count=len(self._indexes),
                    message_count=self._counts.total(),
                    channel_message_counts=dict(self._counts),
                    message_start_time=min(index.message_start_time for index in self._indexes),
                    message_end_time=max(index.message_end_time for index in self._indexes),
                )
                self._write_at_end(_end_of_file(self.end, *self._definitions, *self._indexes, statistics))
        finally:
            self._file.close()

    def _append(self, data: bytes) -> None:
        self._write_at_end(data + _end_of_file(0))
        self.end += len(data)

    def _write_at_end(self, data: bytes) -> None:
        self._file.seek(self.end)
        view = memoryview(data)
        try:
            while view:
                view = view[self._file.write(view) :]
        except OSError:
            with contextlib.suppress(OSError):
                self._file.truncate(self.end)
                self._file.seek(self.end)
                self._file.write(_end_of_file(0))
            raise


def write_messages(path: Path, topics: Iterable[Topic], messages: Iterable[tuple[int, int, bytes]]) -> None:
    """Write a complete file; messages are channel, time in ns, and payload."""
    file, builder = McapFile(path, topics), ChunkBuilder()
    for channel, time, payload in messages:
        builder.add(channel, time, payload)
        if builder.size >= CHUNK_BYTES:
            file.write(builder.take())
    file.write(builder.take())
    file.close()


def _serialized(*records: rec.McapRecord) -> bytes:
    builder = RecordBuilder()
    for record in records:
        record.write(builder)
    return bytes(builder.end())


def _end_of_file(data_size: int, *summary: rec.McapRecord) -> bytes:
    """Return the end records after `data_size` bytes."""
    data_end = _serialized(rec.DataEnd(0))
    footer = rec.Footer(
        summary_start=data_size + len(data_end) if summary else 0, summary_offset_start=0, summary_crc=0
    )
    return data_end + _serialized(*summary, footer) + MAGIC


def _records(file: BinaryIO, size: int) -> Iterator[rec.McapRecord]:
    expanded = 0
    reader = StreamReader(file, skip_magic=True, emit_chunks=True, validate_crcs=True, record_size_limit=size)
    for record in reader.records:
        if not isinstance(record, rec.Chunk):
            yield record
            continue
        if record.compression not in ("", "zstd"):
            raise ValueError(f"chunk compression {record.compression!r}; valid: 'zstd', ''")
        declared, contained = record.uncompressed_size, len(record.data)
        if record.compression == "zstd":
            contained = zstandard.frame_content_size(record.data)  # -1 if unknown; then `declared` limits it
        if contained not in (-1, declared):
            raise ValueError(f"chunk declares {declared} bytes, but contains {contained}")
        expanded += declared
        if declared > _LARGEST_CHUNK or expanded > max(_LARGEST_RATIO * size, _LARGEST_CHUNK):
            raise ValueError(
                f"chunk expands to {declared} bytes (limit {_LARGEST_CHUNK}, in total {_LARGEST_RATIO} × file)"
            )
        yield from breakup_chunk(record, validate_crc=True)


class McapMessages:
    """Messages of a file up to its first damage."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.topics: dict[int, Topic] = {}  # by channel; filled during the reading
        self.damage = ""  # reason of an early end, or empty

    def __iter__(self) -> Iterator[tuple[Topic, int, bytes]]:
        """Yield topic, time of arrival in ns, and serialized message; another file type raises `ValueError`."""
        schemas: dict[int, rec.Schema] = {}
        with self.path.open("rb") as file:
            if file.read(len(MAGIC)) != MAGIC:
                raise ValueError("not an MCAP file")
            try:
                for record in _records(file, os.fstat(file.fileno()).st_size):
                    if isinstance(record, rec.DataEnd):
                        return
                    if isinstance(record, rec.Schema):
                        schemas[record.id] = record
                    elif isinstance(record, rec.Channel):
                        schema = schemas[record.schema_id]
                        self.topics[record.id] = Topic(record.id, record.topic, schema.name, schema.data.decode())
                    elif isinstance(record, rec.Message):
                        yield self.topics[record.channel_id], record.publish_time, record.data
            except _DAMAGE as error:
                incomplete = isinstance(error, EndOfFile | RecordLengthLimitExceeded) or file.read(1) == b""
                self.damage = "the last record is incomplete" if incomplete else f"a record is damaged ({error})"
