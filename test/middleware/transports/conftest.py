"""Isolated buses with connected transports."""

import dataclasses
from collections.abc import Callable, Iterable, Iterator
from contextlib import ExitStack, closing
from typing import Any

import numpy as np
import pytest
from network import network
from participants import DdsParticipants, MemoryParticipants, Ros2Participants
from rosbags.interfaces import Nodetype
from waiting import until

from wbc_controller.middleware.codec import TYPES, decode, encode, message
from wbc_controller.middleware.topics import Endpoint
from wbc_controller.middleware.transports.transport import Transport

__all__ = ["network"]

_DTYPES = {"char": "uint8", "byte": "uint8", "octet": "uint8"}


_PARTICIPANTS = {"memory": MemoryParticipants, "dds": DdsParticipants, "ros2": Ros2Participants}


@pytest.fixture(params=_PARTICIPANTS)
def join(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[..., Transport]]:
    """Make another transport on this test's bus: ``join("node", "/namespace")``."""
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    with ExitStack() as opened:
        participants = opened.enter_context(closing(_PARTICIPANTS[request.param]()))
        yield lambda *place: opened.enter_context(closing(participants.transport(*place)))


@pytest.fixture(scope="session")
def eventually() -> Callable[..., None]:
    """Wait for a condition: ``eventually(condition, again)`` calls `again` before each check."""
    return lambda condition, again=lambda: None, seconds=60.0: until(condition, "", seconds, again, period=0.01)


@pytest.fixture(scope="session")
def exchange(eventually: Callable[..., None], example: Callable[[str], Any]) -> Callable[..., None]:
    """Send an example on each topic, from a writer to a reader, until all have arrived, and compare."""

    def exchange(ways: Iterable[tuple[Endpoint, Transport, Transport]], seconds: float = 60.0) -> None:
        opened = []  # all topics are discovered at the same time
        for topic, writer, reader in ways:
            received: list[bytes] = []
            reader.subscribe(topic, received.append)
            offered = dataclasses.replace(topic, qos=dataclasses.replace(topic.qos, reliable=True))
            opened.append((topic, received, encode(example(topic.type)), writer.advertise(offered)))

        def send() -> None:
            for _, received, payload, publish in opened:
                if not received:
                    publish(payload)

        eventually(lambda: all(received for _, received, *_ in opened), send, seconds)
        for topic, received, payload, _ in opened:
            assert encode(decode(received[0], topic.type)) == payload, topic

    return exchange


@pytest.fixture(scope="session")
def example() -> Callable[[str], Any]:
    """Make a message of any type with a distinct value in every field."""
    return lambda type_name: _filled(type_name, iter(range(1, 100_000)))


def _filled(type_name: str, numbers: Iterator[int]) -> Any:
    _, fields = TYPES.fielddefs[type_name]
    return message(type_name, **{name: _value(description, numbers) for name, description in fields})


def _value(description: Any, numbers: Iterator[int]) -> Any:
    kind, detail = description
    if kind == Nodetype.NAME:
        return _filled(detail, numbers)
    if kind == Nodetype.BASE:
        name, number = detail[0], next(numbers)
        if name == "string":
            return f"text {number} µ"
        if name == "bool":
            return True
        return number + 0.25 if name.startswith("float") else number % 100
    element, length = detail
    # Three elements: an odd number of strings or bytes shifts the alignment of later fields.
    values = [_value(element, numbers) for _ in range(length if kind == Nodetype.ARRAY else 3)]
    if element[0] == Nodetype.BASE and element[1][0] not in ("string", "bool"):
        return np.array(values, dtype=_DTYPES.get(element[1][0], element[1][0]))
    return values
