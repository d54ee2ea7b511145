"""Topics added after the run."""

from __future__ import annotations

import heapq
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from wbc_controller.middleware.codec import TYPES
from wbc_controller.recording.mcap_file import ChunkBuilder, McapFile, McapMessages, Topic
from wbc_controller.recording.recording_file import Recording
from wbc_controller.recording.writer import CHUNK_BYTES

#: Messages by name and type of the topic: stamp, ns, and serialized message, in order of the stamps.
AddedTopics = Mapping[tuple[str, str], Sequence[tuple[int, bytes]]]


def add_topics(path: Path, added: AddedTopics) -> None:
    """Add topics in place, each message at the cycle with its stamp.

    Raises `ConfigurationError` if the file is not a recording, and `OSError` if it cannot be written.
    """
    recording = Recording(path)
    stamps, times = np.array([(cycle.stamp, cycle.time) for cycle in recording.cycles()], dtype=np.float64).T
    number = max(recording.topics)
    topics, messages = list(recording.topics.values()), []
    for (name, kind), content in added.items():
        number += 1
        topics.append(Topic(number, name, kind, TYPES.generate_msgdef(kind, ros_version=2)[0]))
        messages.append([(round(float(np.interp(stamp, stamps, times))), number, data) for stamp, data in content])
    recorded = ((time, topic.number, data) for topic, time, data in McapMessages(path))
    draft = path.with_suffix(".part")
    draft.unlink(missing_ok=True)  # do not follow a link
    file, builder = McapFile(draft, topics), ChunkBuilder()
    for time, channel, data in heapq.merge(recorded, *messages, key=lambda message: message[0]):
        builder.add(channel, time, data)
        if builder.size >= CHUNK_BYTES:
            _write(file, builder)
    _write(file, builder)
    file.close()
    draft.replace(path)


def _write(file: McapFile, builder: ChunkBuilder) -> None:
    chunk = builder.take()
    if chunk is not None:
        file.write(chunk)
