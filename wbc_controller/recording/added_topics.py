"""Topics added after the run."""

from __future__ import annotations

import heapq
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from wbc_controller.middleware.codec import TYPES
from wbc_controller.recording.mcap_file import McapMessages, Topic, write_messages
from wbc_controller.recording.recording_file import Recording

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
        messages.append([(number, round(float(np.interp(stamp, stamps, times))), data) for stamp, data in content])
    recorded = ((topic.number, time, data) for topic, time, data in McapMessages(path))
    draft = path.with_suffix(".part")
    draft.unlink(missing_ok=True)  # do not follow a link
    write_messages(draft, topics, heapq.merge(recorded, *messages, key=lambda message: message[1]))
    draft.replace(path)
