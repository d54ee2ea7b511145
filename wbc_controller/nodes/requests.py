"""Queue of users' requests.

Callbacks on the transport's thread recognize an emergency stop at once. The thread `reader` decodes and
validates requests; in lockstep the cycle does.
"""

import logging
import threading
import time
from collections import Counter, deque
from collections.abc import Callable

from wbc_controller.controller.report import UserRequests
from wbc_controller.errors import ConfigurationError, InputRefused
from wbc_controller.inverse_dynamics.references.changes import Change
from wbc_controller.middleware import decoding
from wbc_controller.middleware.codec import decode
from wbc_controller.middleware.topics import Endpoint
from wbc_controller.records import ChangeSettings

_log = logging.getLogger(__name__)

_REQUEST_DEPTH = 100  # capacity; further requests are dropped and counted
_TOO_MANY = f"more than {_REQUEST_DEPTH} requests at once"
_MOST_PER_CYCLE = 20  # requests, to bound the time of a cycle
#: Largest message, bytes: by row of the topic table, and all others.
_MAX_BYTES, _MAX_REQUEST_BYTES = {"trajectory": 1 << 20}, 1 << 18
_READER_SHARE = 0.25  # share of the processor time, since the interpreter runs one thread at a time
_LONGEST_REASON = 1000  # of a refusal, characters
_MAX_COMMAND = 40  # characters
_ESTOP = b"estop"  # in a serialized std_msgs/String
_NO_REQUESTS = UserRequests()


class Requests:
    """Queue between transport and cycles. `prepare` raises for an invalid change; an emergency stop calls `stop`."""

    def __init__(
        self,
        vocabulary: decoding.Vocabulary,
        prepare: Callable[[Change | ChangeSettings], None],
        stop: Callable[[], None],
    ) -> None:
        self._vocabulary, self._prepare, self._stop = vocabulary, prepare, stop
        self._estop = threading.Event()
        self._waiting = threading.Condition()  # re-entrant, guards the next three attributes
        self._requests: deque[tuple[Endpoint, bytes]] = deque()
        self._decoded_requests: deque[UserRequests] = deque()
        self._dropped: Counter[tuple[str, str]] = Counter()
        self._reader: threading.Thread | None = None
        self._ended = False

    def start_reader(self) -> None:
        """Start the reader thread."""
        self._ended = False
        self._reader = threading.Thread(target=self._run_reader, name="reader", daemon=True)
        self._reader.start()

    def stop_reader(self) -> None:
        """Stop the reader thread; decoded requests stay available."""
        reader, self._reader = self._reader, None
        if reader is not None:
            with self._waiting:
                self._ended = True
                self._waiting.notify()
            reader.join()

    def drop_unread(self, endpoint: Endpoint, why: str) -> None:
        """Count a dropped message."""
        with self._waiting:
            self._dropped[endpoint.name, why] += 1

    def put(self, endpoint: Endpoint, payload: bytes) -> None:
        """Store a request; an emergency stop bypasses the queue."""
        largest = _MAX_BYTES.get(endpoint.key, _MAX_REQUEST_BYTES)
        if len(payload) > largest:
            self.drop_unread(endpoint, f"more than {largest} bytes")
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
                self.drop_unread(endpoint, _TOO_MANY)

    def take(self) -> UserRequests:
        """Take up to `_MOST_PER_CYCLE` requests, an emergency stop first; decode them here without a reader thread."""
        if self._reader is None:
            while self._requests:
                self._decoded_requests.append(self._decode(*self._requests.popleft()))
        stopped = self._estop.is_set()
        if not (stopped or self._decoded_requests or self._dropped):
            return _NO_REQUESTS
        if stopped:
            self._estop.clear()
        with self._waiting:
            dropped, self._dropped = self._dropped, Counter()
            taken = [self._decoded_requests.popleft() for _ in range(min(len(self._decoded_requests), _MOST_PER_CYCLE))]
        refused = [sentence for each in taken for sentence in each.refused]
        refused += [f"{name}: {count} messages dropped: {why}" for (name, why), count in dropped.items()]
        return UserRequests(
            commands=("estop",) * stopped + tuple(word for each in taken for word in each.commands),
            changes=tuple(changes for each in taken for changes in each.changes),
            refused=tuple(refused),
            total=stopped + len(taken) + sum(dropped.values()),
        )

    def _run_reader(self) -> None:
        while True:
            with self._waiting:
                self._waiting.wait_for(lambda: self._requests or self._ended)
                if self._ended:
                    return
                endpoint, payload = self._requests.popleft()
            began = time.thread_time()  # a preempted thread must not pause longer
            read = self._decode(endpoint, payload)
            spent = time.thread_time() - began
            with self._waiting:
                if len(self._decoded_requests) < _REQUEST_DEPTH:
                    self._decoded_requests.append(read)
                else:
                    self.drop_unread(endpoint, _TOO_MANY)
            time.sleep(spent * (1.0 / _READER_SHARE - 1.0))

    def _decode(self, endpoint: Endpoint, payload: bytes) -> UserRequests:
        try:
            content = decode(payload, endpoint.type)
            if endpoint.key == "command":
                word = content.data.strip()
                if len(word) > _MAX_COMMAND:
                    raise InputRefused(f"command has {len(word)} characters (limit {_MAX_COMMAND})")
                return UserRequests(commands=(word,))
            changes = decoding.READERS[endpoint.key](self._vocabulary, endpoint.subject, content)
            for change in changes:
                self._prepare(change)
        except Exception as error:
            return UserRequests(refused=(f"{endpoint.name}: {refusal_reason(endpoint, error)}",))
        return UserRequests(changes=(changes,))


def refusal_reason(endpoint: Endpoint, error: Exception) -> str:
    """Return the reason of a refusal from the error of the decoding."""
    if isinstance(error, InputRefused | ConfigurationError):
        reason = str(error)
    else:  # a defect must not end the loop
        _log.error("decoding a message on %s failed", endpoint.name, exc_info=error)
        reason = f"cannot be decoded: {type(error).__name__}: {error}"
    return reason if len(reason) <= _LONGEST_REASON else reason[:_LONGEST_REASON] + "…"
