"""The writer process of recordings.

It outlives a killed loop, to write the last seconds and close the files. It has few imports for a fast start, and
prints its messages to standard output.
"""

import contextlib
import json
import os
import queue
import re
import select
import signal
import struct
import sys
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from wbc_controller.recording.mcap_file import CHUNK_BYTES, ChunkBuilder, McapFile, PackedChunk, Topic, exists

FRAME = struct.Struct("<IHq")  # length of the content, code or number of the topic, time in ns
#: Codes of other frames: topics, a message at the start of every file, a reason to write the last seconds, and the end.
TOPICS, PINNED, TRIGGER, END = range(0xFF00, 0xFF04)
CHUNK_SECONDS = 0.4  # largest duration of a chunk, s
_POLL = 0.02  # of the pipe, s
_RING_BYTES, _WAITING_BYTES = 64 << 20, 64 << 20  # limits of the last seconds, and of the queue of the disk
_FILE_AFTER_FAULT, _LONGEST = 2.0, 60.0  # duration of a file after the last fault, and in total, s
_WARNING_PERIOD = 30.0  # s


def frame(code: int, at: int, content: bytes) -> bytes:
    """Return a frame with its code or number of the topic, time in ns, and content."""
    return FRAME.pack(len(content), code, at) + content


class FileSink:
    """File that warns of each error and retries with every chunk."""

    def __init__(self, path: Path, report: Callable[[str], None]) -> None:
        self.path = path
        self._report = report
        self._file: McapFile | None = None
        self._begun = False  # after the messages at the start of every file
        self._missing, self._warned_at = 0, -_WARNING_PERIOD

    def write(self, chunk: PackedChunk, topics: list[Topic], begin: Callable[[int], PackedChunk | None]) -> None:
        """Write a chunk, after the messages of `begin` (for a time in ns) at the start of a file."""
        try:
            if self._file is None:
                self._file = McapFile(self.path, topics)
            if not self._begun:
                self._file.write(begin(chunk.index.message_start_time))
                self._begun = True
            self._file.write(chunk)
        except OSError as error:
            self._missing += 1
            self._warn(error)
        else:
            if self._missing:
                missing = "1 chunk is" if self._missing == 1 else f"{self._missing} chunks are"
                self._report(f"the recording {str(self.path)!r} resumed; {missing} missing")
                self._missing, self._warned_at = 0, -_WARNING_PERIOD

    def probe(self) -> None:
        """Warn if the file cannot be written."""
        try:
            new = not exists(self.path)
            self.path.open("xb" if new else "ab").close()
            if new:
                self.path.unlink()
        except OSError as error:
            self._warn(error)

    def close(self) -> None:
        """Close the file."""
        if self._file is not None:
            try:
                self._file.close()
            except OSError as error:
                self._warn(error)

    def _warn(self, error: OSError) -> None:
        now = time.monotonic()
        if now - self._warned_at >= _WARNING_PERIOD:
            self._warned_at = now
            self._report(f"the recording {str(self.path)!r} cannot be written: {error.strerror or error}")


class Writer:
    """Collector of chunks, with a buffer and a thread that writes files.

    `plan` contains the ``file`` of the whole run or None, the ``folder`` of the last ``seconds`` or None, the ``name``
    of the robot, and the largest number of ``files``.
    """

    def __init__(self, plan: dict[str, Any], report: Callable[[str], None]) -> None:
        self._plan, self._report = plan, report
        self._topics: list[Topic] = []
        self._first_messages: dict[int, bytes] = {}
        self._builder = ChunkBuilder()
        self._begun = 0.0  # start of the chunk, s
        self._ring: deque[PackedChunk] = deque()
        self._ring_bytes = 0
        self._run = FileSink(Path(plan["file"]), report) if plan["file"] else None
        self._fault: FileSink | None = None  # open file of a fault
        self._until = self._latest = 0.0  # its planned and latest end, s
        self._jobs: queue.SimpleQueue[Callable[[], None] | None] = queue.SimpleQueue()
        self._queued = self._written = 0  # bytes
        self._dropped = 0
        self._disk = threading.Thread(target=self._write, name="disk")
        self._disk.start()
        if self._run is not None:
            self._jobs.put(self._run.probe)

    def process(self, code: int, at: int, payload: bytes) -> None:
        """Process one frame."""
        if code == TOPICS:
            self._topics = [Topic(*each) for each in json.loads(payload)]
        elif code == PINNED:
            self._first_messages[int.from_bytes(payload[:2], "little")] = payload[2:]
        elif code == TRIGGER:
            self._write_last_seconds(payload.decode())
        else:
            if not self._builder.size:
                self._begun = time.monotonic()
            self._builder.add(code, at, payload)
            if self._builder.size >= CHUNK_BYTES:
                self.flush()

    def poll(self) -> None:
        """Close the chunk and the file of a fault if due."""
        now = time.monotonic()
        if self._builder.size and (not self._ring or now - self._begun >= CHUNK_SECONDS):  # the first chunk at once
            self.flush()
        if self._fault is not None and now >= self._until:
            self.flush()
            self._close_fault()

    def flush(self) -> None:
        """Close, write and buffer the chunk."""
        chunk = self._builder.take()
        if chunk is None:
            return
        for sink in filter(None, (self._run, self._fault)):
            self._queue(sink, chunk)
        self._ring.append(chunk)
        self._ring_bytes += len(chunk.data)
        oldest = chunk.index.message_end_time - int(1e9 * self._plan["seconds"])
        while self._ring and (self._ring_bytes > _RING_BYTES or self._ring[0].index.message_end_time < oldest):
            self._ring_bytes -= len(self._ring.popleft().data)

    def end(self, reason: str = "") -> None:
        """Write everything and close all files; with a reason, write the last seconds too."""
        if reason:
            self._write_last_seconds(reason)
        self.flush()
        self._close_fault()
        if self._run is not None:
            self._jobs.put(self._run.close)
        self._jobs.put(None)
        self._disk.join()

    def _write_last_seconds(self, reason: str) -> None:
        if self._plan["folder"] is None:
            return
        now = time.monotonic()
        if self._fault is not None:
            self._until = min(now + _FILE_AFTER_FAULT, self._latest)
            self._report(f"the last seconds are already in {str(self._fault.path)!r}, now continued ({reason})")
            return
        self.flush()
        folder = Path(self._plan["folder"])
        word = re.sub(r"[^A-Za-z0-9_-]+", "-", reason)[:40]
        stem = f"{self._plan['name']}-{time.strftime('%Y%m%d-%H%M%S', time.gmtime())}-{word}"
        path, number = folder / f"{stem}.mcap", 1
        while os.path.lexists(path):
            number += 1
            path = folder / f"{stem}-{number}.mcap"
        self._jobs.put(lambda: self._make_room(folder))
        self._fault = FileSink(path, self._report)
        self._until, self._latest = now + _FILE_AFTER_FAULT, now + _LONGEST
        for chunk in self._ring:
            self._queue(self._fault, chunk)
        self._report(f"the last seconds are written to {str(path)!r} ({reason})")

    def _close_fault(self) -> None:
        if self._fault is not None:
            self._jobs.put(self._fault.close)
            self._fault = None

    def _make_room(self, folder: Path) -> None:
        pattern = f"{self._plan['name']}-[0-9]*-[0-9]*-*.mcap"
        with contextlib.suppress(OSError):  # reported when the file is created
            folder.mkdir(parents=True, exist_ok=True)
            old = sorted(folder.glob(pattern), key=lambda path: path.stat().st_mtime)
            for path in old[: max(0, len(old) - self._plan["files"] + 1)]:
                path.unlink()

    def _queue(self, sink: FileSink, chunk: PackedChunk) -> None:
        if self._queued - self._written > _WAITING_BYTES:
            self._dropped += 1
            if self._dropped == 1:
                self._report(f"the disk of {str(sink.path)!r} is too slow: chunks of the recording are dropped")
            return
        self._queued += len(chunk.data)

        def job() -> None:
            sink.write(chunk, self._topics, self._start_of_file)
            self._written += len(chunk.data)

        self._jobs.put(job)

    def _start_of_file(self, at: int) -> PackedChunk | None:
        builder = ChunkBuilder()
        for topic, payload in self._first_messages.items():
            builder.add(topic, at, payload)
        return builder.take()

    def _write(self) -> None:
        while (job := self._jobs.get()) is not None:
            job()


def frames(read: Callable[[], bytes | None], idle: Callable[[], None]) -> Iterator[tuple[int, int, bytes]]:
    """Yield code, time in ns, and content of the frames of a pipe.

    `read` returns new data, None after a pause, or no bytes at the end; `idle` is called after each read.
    """
    rest = b""
    while (data := read()) != b"":
        if data is not None:
            rest += data
            at = 0
            while at + FRAME.size <= len(rest):
                length, code, stamp = FRAME.unpack_from(rest, at)
                if at + FRAME.size + length > len(rest):
                    break
                yield code, stamp, rest[at + FRAME.size : at + FRAME.size + length]
                at += FRAME.size + length
            rest = rest[at:]
        idle()


def main() -> None:
    """Run the process until its pipe ends."""
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):  # ends with the pipe only
        signal.signal(number, signal.SIG_IGN)
    if hasattr(os, "sched_setscheduler") and os.sched_getscheduler(0) != os.SCHED_OTHER:
        os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
        os.sched_setaffinity(0, range(1024))
    os.nice(5)

    def report(sentence: str) -> None:
        with contextlib.suppress(OSError):  # the loop's process has ended
            os.write(1, sentence.encode() + b"\n")

    def read() -> bytes | None:
        return os.read(0, 1 << 20) if select.select([0], [], [], _POLL)[0] else None

    writer = Writer(json.loads(sys.argv[1]), report)
    for code, at, payload in frames(read, writer.poll):
        if code == END:
            writer.end()
            return
        writer.process(code, at, payload)
    writer.end("CONTROLLER_DIED")


if __name__ == "__main__":
    main()
