"""The rule that a topic has one message type, with the same error in every transport."""

from __future__ import annotations

from wbc_controller.errors import TransportError


class TopicTypes:
    """Records the type of each open topic. It is not thread-safe: its owner holds a lock."""

    def __init__(self) -> None:
        self._type_of: dict[str, str] = {}

    def check(self, topic: str, type_name: str) -> None:
        """Record the type with which a topic is opened.

        Raises:
            TransportError: if the topic is already open with another type.
        """
        known = self._type_of.setdefault(topic, type_name)
        if known != type_name:
            raise TransportError(f"topic {topic} is already open as {known}: it cannot also be {type_name}")
