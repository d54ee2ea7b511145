"""The process that writes recordings: frames come from the loop's process by a pipe, files are its business alone.

As a process of its own it takes neither the interpreter's lock nor a place in the loop's memory, and it outlives the
loop's process: where that is killed, it writes the last seconds and closes its files. It imports little, so that it
starts fast. What it has to say goes to its standard output, a line each.
"""

from __future__ import annotations

import contextlib
import json
import os
import queue
import re
import signal
import struct
import sys
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from wbc_controller.recording.mcap_file import ChunkBuilder, McapFile, PackedChunk, Topic

#: Before each frame: length of what follows, code or channel, and time in ns.
FRAME = struct.Struct("<IHq")
#: Codes of frames that are no message: the topics, a cycle's numbers, a message that every file begins with, a reason
#: to write the last seconds, and the end.
TOPICS, CYCLE, PINNED, TRIGGER, END = range(0xFF00, 0xFF05)
#: The time of a message whose time is that of the cycle that follows.
WITH_THE_CYCLE = 0
#: Time in which messages are collected to a chunk, s, and size at which it is full.
CHUNK_SECONDS, CHUNK_BYTES = 0.4, 1 << 20
#: Time between two looks at the pipe, s: it holds many cycles.
_LOOK = 0.02
#: Most that the last seconds may take, and most that may wait for the disk, bytes.
_RING_BYTES, _WAITING_BYTES = 64 << 20, 64 << 20
#: Time for which a file goes on after what caused it, and its longest duration, s.
_AFTER, _LONGEST = 2.0, 60.0
#: Time for which a warning is not repeated, s.
_SILENCE = 30.0


class Sink:
    """One file, of which every failure is a warning, and which is tried again with every chunk."""

    def __init__(self, path: Path, say: Callable[[str], None]) -> None:
        self.path = path
        self._say = say
        self._file: McapFile | None = None
        self._begun = False  # whether it holds what every file begins with
        self._lost, self._warned = 0, -_SILENCE

    def write(self, chunk: PackedChunk, topics: list[Topic], begin: Callable[[int], PackedChunk | None]) -> None:
        """Write a chunk; into a new file behind what every file begins with, which `begin` gives for a time."""
        try:
            if self._file is None:
                self._file = McapFile(self.path, topics)
            if not self._begun:
                pinned = begin(chunk.index.message_start_time)
                if pinned is not None:
                    self._file.write(pinned)
                self._begun = True
            self._file.write(chunk)
        except OSError as error:
            self._lost += 1
            self._warn(error)
        else:
            if self._lost:
                missing = "1 chunk is" if self._lost == 1 else f"{self._lost} chunks are"
                self._say(f"the recording {str(self.path)!r} resumed; {missing} missing")
                self._lost, self._warned = 0, -_SILENCE

    def probe(self) -> None:
        """Say at the start whether the file can be written, and leave none that is empty."""
        try:
            new = not self.path.exists()
            self.path.open("ab").close()
            if new:
                self.path.unlink()
        except OSError as error:
            self._warn(error)

    def close(self) -> None:
        """End the file."""
        if self._file is not None:
            try:
                self._file.close()
            except OSError as error:
                self._warn(error)

    def _warn(self, error: OSError) -> None:
        now = time.monotonic()
        if now - self._warned >= _SILENCE:
            self._warned = now
            self._say(f"the recording {str(self.path)!r} cannot be written: {error.strerror or error}")


class Writer:
    """Makes chunks of what comes, keeps the last of them, and hands them to a thread that writes files."""

    def __init__(self, plan: dict[str, Any], say: Callable[[str], None]) -> None:
        """Make a writer.

        Args:
            plan: ``file`` for all of it or None, ``folder`` for the last ``seconds`` or None, ``name`` of the robot,
                and the most ``files`` in the folder.
            say: takes a sentence for the user.
        """
        self._plan, self._say = plan, say
        self._topics: list[Topic] = []
        self._groups: list[tuple[int, bytes, int, int]] = []
        self._pinned: dict[int, tuple[int, bytes]] = {}
        self._with_the_cycle: list[tuple[int, bytes]] = []
        self._last = 0  # latest time of a frame, ns; the recorder's thread sends some behind later cycles
        self._builder = ChunkBuilder()
        self._begun = 0.0  # when the chunk was, s
        self._ring: deque[PackedChunk] = deque()
        self._ring_bytes = 0
        self._whole = Sink(Path(plan["file"]), say) if plan["file"] else None
        self._burst: Sink | None = None  # the file of a fault that is being written
        self._until = self._latest = 0.0  # when it is to end, and has to, s
        self._jobs: queue.SimpleQueue[Callable[[], None] | None] = queue.SimpleQueue()
        self._handed = self._written = 0  # to and by the thread, bytes
        self._dropped = 0
        self._disk = threading.Thread(target=self._write, name="disk")
        self._disk.start()
        if self._whole is not None:
            self._jobs.put(self._whole.probe)

    def take(self, code: int, at: int, payload: bytes) -> None:
        """Take one frame."""
        self._last = max(at, self._last)
        if code == CYCLE:
            self._date(at)
            for channel, prefix, start, end in self._groups:
                self._add(channel, at, prefix + payload[start:end])
        elif code == TOPICS:
            given = json.loads(payload)
            self._topics = [Topic(*each) for each in given["topics"]]
            self._groups = [(c, bytes.fromhex(prefix), start, end) for c, prefix, start, end in given["groups"]]
        elif code == PINNED:
            (channel,) = struct.unpack_from("<H", payload)
            self._pinned[channel] = at, payload[2:]
        elif code == TRIGGER:
            self._trigger(payload.decode())
        elif at == WITH_THE_CYCLE:
            self._with_the_cycle.append((code, payload))
        else:
            self._add(code, at, payload)

    def _date(self, at: int) -> None:
        """Add the messages whose time is now known."""
        for channel, payload in self._with_the_cycle:
            self._add(channel, at, payload)
        self._with_the_cycle.clear()

    def _add(self, channel: int, at: int, payload: bytes) -> None:
        if not self._builder.size:
            self._begun = time.monotonic()
        self._builder.add(channel, at, payload)
        if self._builder.size >= CHUNK_BYTES:
            self.flush()

    def look(self) -> None:
        """Do what is due by time."""
        now = time.monotonic()
        if self._builder.size and (not self._ring or now - self._begun >= CHUNK_SECONDS):  # the first one at once
            self.flush()
        if self._burst is not None and now >= self._until:
            self.flush()
            self._end_burst()

    def flush(self) -> None:
        """Close the chunk, and hand it on."""
        chunk = self._builder.take()
        if chunk is None:
            return
        if self._whole is not None:
            self._hand(self._whole, chunk)
        if self._burst is not None:
            self._hand(self._burst, chunk)
        self._ring.append(chunk)
        self._ring_bytes += len(chunk.data)
        oldest = chunk.index.message_end_time - int(1e9 * self._plan["seconds"])
        while self._ring and (self._ring_bytes > _RING_BYTES or self._ring[0].index.message_end_time < oldest):
            self._ring_bytes -= len(self._ring.popleft().data)

    def end(self, reason: str = "") -> None:
        """Write all that is left, and close every file; for a reason, write the last seconds too."""
        self._date(self._last)
        if reason:
            self._trigger(reason)
        self.flush()
        self._end_burst()
        if self._whole is not None:
            self._jobs.put(self._whole.close)
        self._jobs.put(None)
        self._disk.join()

    def _trigger(self, reason: str) -> None:
        """Write the last seconds, and what comes in the next ones."""
        if self._plan["folder"] is None:
            return
        now = time.monotonic()
        if self._burst is not None:
            self._until = min(now + _AFTER, self._latest)
            self._say(f"the last seconds are in {str(self._burst.path)!r} already, which goes on ({reason})")
            return
        self.flush()
        folder = Path(self._plan["folder"])
        word = re.sub(r"[^A-Za-z0-9_-]+", "-", reason)[:40]
        stem = f"{self._plan['name']}-{time.strftime('%Y%m%d-%H%M%S', time.gmtime())}-{word}"
        path, number = folder / f"{stem}.mcap", 1
        while path.exists():
            number += 1
            path = folder / f"{stem}-{number}.mcap"
        self._jobs.put(lambda: self._make_room(folder))
        self._burst = Sink(path, self._say)
        self._until, self._latest = now + _AFTER, now + _LONGEST
        for chunk in self._ring:
            self._hand(self._burst, chunk)
        self._say(f"the last seconds are written to {str(path)!r} ({reason})")

    def _end_burst(self) -> None:
        if self._burst is not None:
            self._jobs.put(self._burst.close)
            self._burst = None

    def _make_room(self, folder: Path) -> None:
        """Make the folder, and remove the oldest recordings of this robot from it."""
        pattern = f"{self._plan['name']}-[0-9]*-[0-9]*-*.mcap"
        with contextlib.suppress(OSError):  # what cannot be done here is said where the file is made
            folder.mkdir(parents=True, exist_ok=True)
            old = sorted(folder.glob(pattern), key=lambda path: path.stat().st_mtime)
            for path in old[: max(0, len(old) - self._plan["files"] + 1)]:
                path.unlink()

    def _hand(self, sink: Sink, chunk: PackedChunk) -> None:
        if self._handed - self._written > _WAITING_BYTES:
            self._dropped += 1
            if self._dropped == 1:
                self._say(f"the disk of {str(sink.path)!r} is too slow: parts of the recording lack")
            return
        self._handed += len(chunk.data)

        def job() -> None:
            sink.write(chunk, self._topics, self._begin)
            self._written += len(chunk.data)

        self._jobs.put(job)

    def _begin(self, at: int) -> PackedChunk | None:
        """What every file begins with, at the time of what follows."""
        builder = ChunkBuilder()
        for channel, (_, payload) in self._pinned.items():
            builder.add(channel, at, payload)
        return builder.take()

    def _write(self) -> None:
        while (job := self._jobs.get()) is not None:
            job()


def frames(read: Callable[[], bytes | None], idle: Callable[[], None]) -> Iterator[tuple[int, int, bytes]]:
    """The frames of a pipe, up to its end: code, time, and bytes.

    Args:
        read: gives what has come, None where nothing has, and no bytes at the end.
        idle: called after each look at the pipe.
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
        if data is None:
            time.sleep(_LOOK)


def main() -> None:
    """Run the process until its pipe ends."""
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):  # the end of the pipe is the end
        signal.signal(number, signal.SIG_IGN)
    if hasattr(os, "sched_setscheduler") and os.sched_getscheduler(0) != os.SCHED_OTHER:
        os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
        os.sched_setaffinity(0, range(1024))
    os.nice(5)
    os.set_blocking(0, False)

    def say(sentence: str) -> None:
        with contextlib.suppress(OSError):  # nobody listens any more
            os.write(1, sentence.encode() + b"\n")

    def read() -> bytes | None:
        try:
            return os.read(0, 1 << 20)
        except BlockingIOError:
            return None

    writer = Writer(json.loads(sys.argv[1]), say)
    for code, at, payload in frames(read, writer.look):
        if code == END:
            writer.end()
            return
        writer.take(code, at, payload)
    writer.end("CONTROLLER_DIED")


if __name__ == "__main__":
    main()
