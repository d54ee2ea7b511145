"""One message type per topic name: the same rule, and the same words, in every transport."""

from __future__ import annotations

from wbc_controller.errors import TransportError


class TopicTypes:
    """Remembers the type of each topic that was opened. Not thread-safe: its owner holds a lock."""

    def __init__(self) -> None:
        self._type_of: dict[str, str] = {}

    def check(self, topic: str, type_name: str) -> None:
        """Note that a topic is opened with a type.

        Raises:
            TransportError: where the topic is already open with another type.
        """
        known = self._type_of.setdefault(topic, type_name)
        if known != type_name:
            raise TransportError(f"topic {topic} is already open as {known}: it cannot also be {type_name}")
