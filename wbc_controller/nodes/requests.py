"""Queue of users' requests: stored as bytes on arrival, decoded on a thread of its own, taken by a cycle.

They are stored by callbacks on the transport's thread, where an emergency stop is recognized: no queue of requests can
delay it. The thread `reader` decodes and validates them, and leaves the loop most of the processor. Where no such
thread runs, as in lockstep, they are decoded when a cycle looks for them.
"""

from __future__ import annotations

import logging
import threading
import time
from collections import Counter, deque
from collections.abc import Callable
from dataclasses import dataclass, field

from wbc_controller.controller.report import UserRequests
from wbc_controller.errors import ConfigurationError, InputRefused
from wbc_controller.inverse_dynamics.references.changes import Change
from wbc_controller.middleware import decoding
from wbc_controller.middleware.codec import decode
from wbc_controller.middleware.topics import Endpoint
from wbc_controller.records import ChangeSettings

_log = logging.getLogger(__name__)

#: Largest number of requests that wait to be read; further ones are dropped and counted.
_REQUEST_DEPTH = 100
#: Largest number of requests that one cycle takes, to bound its time; the next cycles take the others.
_MOST_PER_CYCLE = 20
#: Largest message, in bytes, by row of the topic table: trajectories, and others.
_LARGEST, _LARGEST_REQUEST = {"trajectory": 1 << 20}, 1 << 18
#: Share of the time that the reader of requests may use; the interpreter runs one thread at a time.
_READER_SHARE = 0.25
#: Longest reason of a refusal, in characters; a longer one is cut, since it may quote the message.
_LONGEST_REASON = 1000
#: Longest word on the command topic, in characters.
_LONGEST_WORD = 40
#: The word of an emergency stop in a serialized std_msgs/String.
_ESTOP = b"estop"


@dataclass(slots=True)
class _Read:
    """The content of one request."""

    commands: list[str] = field(default_factory=list)
    changes: list[tuple[Change | ChangeSettings, ...]] = field(default_factory=list)
    refused: list[str] = field(default_factory=list)


class Requests:
    """Requests on their way from the transport to the cycles.

    Args:
        prepare: validates a change before a cycle takes it; raises `ConfigurationError` or `InputRefused`.
        stop: called at an emergency stop, on the thread that receives it.
    """

    def __init__(
        self,
        vocabulary: decoding.Vocabulary,
        prepare: Callable[[Change | ChangeSettings], None],
        stop: Callable[[], None],
    ) -> None:
        self._vocabulary, self._prepare, self._stop = vocabulary, prepare, stop
        self._estop = threading.Event()
        self._waiting = threading.Condition()  # guards the three below
        self._requests: deque[tuple[Endpoint, bytes]] = deque()
        self._read: deque[_Read] = deque()
        self._dropped: Counter[tuple[str, str]] = Counter()
        self._reader: threading.Thread | None = None
        self._ended = False

    def start_reader(self) -> None:
        """Decode requests on a thread of their own from now on, until `stop_reader`."""
        self._ended = False
        self._reader = threading.Thread(target=self._read_requests, name="reader", daemon=True)
        self._reader.start()

    def stop_reader(self) -> None:
        """End the thread that decodes requests; decoded requests can still be taken."""
        reader, self._reader = self._reader, None
        if reader is not None:
            with self._waiting:
                self._ended = True
                self._waiting.notify()
            reader.join()

    def turn_away(self, endpoint: Endpoint, why: str) -> None:
        """Count a message that is dropped unread."""
        with self._waiting:
            self._dropped[endpoint.name, why] += 1

    def put(self, endpoint: Endpoint, payload: bytes) -> None:
        """Store a request; an emergency stop bypasses the queue."""
        largest = _LARGEST.get(endpoint.key, _LARGEST_REQUEST)
        if len(payload) > largest:
            self.turn_away(endpoint, f"more than {largest} bytes")
            return
        if endpoint.key == "command" and _ESTOP in payload and decode(payload, endpoint.type).data.strip() == "estop":
            self._estop.set()
            self._stop()
            return
        with self._waiting:
            if len(self._requests) < _REQUEST_DEPTH:
                self._requests.append((endpoint, payload))
                self._waiting.notify()
            else:
                self._dropped[endpoint.name, f"more than {_REQUEST_DEPTH} requests at once"] += 1

    def wait_to_be_taken(self) -> bool:
        """Return True if a cycle has requests to take; without a thread, decode them now."""
        if self._reader is None:
            while self._requests:
                self._read.append(self._decoded(*self._requests.popleft()))
        return bool(self._read or self._dropped or self._estop.is_set())

    def take(self) -> UserRequests:
        """Take the decoded requests, an emergency stop first, at most `_MOST_PER_CYCLE`."""
        commands: list[str] = []
        changes: list[tuple[Change | ChangeSettings, ...]] = []
        refused: list[str] = []
        stopped = self._estop.is_set()
        if stopped:
            self._estop.clear()
            commands.append("estop")
        with self._waiting:
            dropped, self._dropped = self._dropped, Counter()
            taken = [self._read.popleft() for _ in range(min(len(self._read), _MOST_PER_CYCLE))]
        for read in taken:
            commands += read.commands
            changes += read.changes
            refused += read.refused
        refused += [f"{name}: {count} messages refused: {why}" for (name, why), count in dropped.items()]
        total = stopped + len(taken) + sum(dropped.values())
        return UserRequests(commands=tuple(commands), changes=tuple(changes), refused=tuple(refused), total=total)

    def _read_requests(self) -> None:
        """Decode requests as they come, in a share of the time."""
        while True:
            with self._waiting:
                self._waiting.wait_for(lambda: self._requests or self._ended)
                if self._ended:
                    return
                endpoint, payload = self._requests.popleft()
            began = time.perf_counter()
            read = self._decoded(endpoint, payload)
            spent = time.perf_counter() - began
            with self._waiting:
                if len(self._read) < _REQUEST_DEPTH:
                    self._read.append(read)
                else:
                    self._dropped[endpoint.name, f"more than {_REQUEST_DEPTH} requests at once"] += 1
            time.sleep(spent * (1.0 / _READER_SHARE - 1.0))

    def _decoded(self, endpoint: Endpoint, payload: bytes) -> _Read:
        """Decode and validate one request."""
        read = _Read()
        try:
            self._read_request(endpoint, payload, read)
        except Exception as error:
            return _Read(refused=[f"{endpoint.name}: {refusal(endpoint, error)}"])
        return read

    def _read_request(self, endpoint: Endpoint, payload: bytes, read: _Read) -> None:
        content = decode(payload, endpoint.type)
        if endpoint.key == "command":
            word = content.data.strip()
            if len(word) > _LONGEST_WORD:
                raise InputRefused(f"a command has at most {_LONGEST_WORD} characters, not {len(word)}")
            read.commands.append(word)
            return
        reader: Callable[..., tuple[Change | ChangeSettings, ...]] = decoding.READERS[endpoint.key]
        changes = reader(self._vocabulary, endpoint.subject, content)
        for change in changes:
            self._prepare(change)
        read.changes.append(changes)


def refusal(endpoint: Endpoint, error: Exception) -> str:
    """Return the reason why a message is refused, from the error of its decoding."""
    if isinstance(error, InputRefused | ConfigurationError):
        reason = str(error)
    else:  # a message that exposes a bug must not end the loop
        _log.error("reading a message on %s failed", endpoint.name, exc_info=error)
        reason = f"cannot be read: {type(error).__name__}: {error}"
    return reason if len(reason) <= _LONGEST_REASON else reason[:_LONGEST_REASON] + "…"
