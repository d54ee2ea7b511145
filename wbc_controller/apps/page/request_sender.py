"""Sender of a page's requests: at once, or for drags at a bounded rate and only while the drag lasts."""

from __future__ import annotations

import logging
import queue
import threading
import time
from collections.abc import Callable, Sequence

from wbc_controller.apps.terminal.request_parser import Request, parse_request
from wbc_controller.errors import WbcError
from wbc_controller.settings import Settings

_log = logging.getLogger(__name__)

#: Time between two messages of a drag, s.
PERIOD = 0.05
#: Age of a drag's value at which it is dropped, s.
STALE = 0.5
#: Largest number of waiting requests; no user sends more.
_MOST = 200


class RequestSender:
    """Sends the pages' requests on a thread of its own, so that no page waits for a node.

    A drag has a slot for its newest value, which is sent once per `PERIOD` at most. Each message answers an event of a
    page: the last event of a drag is its last message, whatever ends the drag.
    """

    def __init__(
        self,
        settings: Settings,
        send: Callable[[Request], None],
        report: Callable[[str, str], None],
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        """Create the sender; `start` starts its thread.

        Args:
            send: sends one request, from any thread; may raise `WbcError`.
            report: called with the words of each request, empty for a drag, and its error, empty if it was sent; on the
                sender's thread or, for an emergency stop, on the caller's.
            clock: monotonic clock, s.
        """
        self._settings, self._send, self._report, self._clock = settings, send, report, clock
        self._requests: queue.Queue[Request | None] = queue.Queue(_MOST)
        self._dragged: dict[str, tuple[float, int, Sequence[str]]] = {}
        self._sent: dict[str, float] = {}
        self._lock = threading.Lock()
        self._thread = threading.Thread(target=self._run, name="sender", daemon=True)

    def start(self) -> None:
        """Start the thread."""
        self._thread.start()

    def close(self) -> None:
        """End the thread; waiting requests are dropped."""
        with self._lock:
            self._dragged.clear()
        try:
            while True:
                self._requests.get_nowait()
        except queue.Empty:
            self._requests.put(None)
        if self._thread.is_alive():
            self._thread.join()

    def say(self, *words: str) -> None:
        """Send a request of `wbc send`; an emergency stop overtakes all waiting requests."""
        request = self._read(words)
        if request is not None:
            self.request(request, " ".join(words))

    def request(self, request: Request, words: str = "") -> None:
        """Send a request, reported by its words."""
        words = words or request.summary
        if (request.key, request.summary) == ("command", "estop"):
            with self._lock:
                self._dragged.clear()
            self._deliver(request, words)
            return
        try:
            self._requests.put_nowait(request)
        except queue.Full:
            self._report(words, "too many requests are waiting")

    def drag(self, key: str, client: int, value: Sequence[str]) -> None:
        """Keep the newest value of a page's drag.

        Args:
            key: the dragged control: a newer value replaces a waiting one.
            client: number of the page.
            value: the words of a request.
        """
        with self._lock:
            self._dragged[key] = self._clock(), client, value

    def forget(self, client: int) -> None:
        """Drop the waiting drags of a closed page."""
        with self._lock:
            self._dragged = {key: value for key, value in self._dragged.items() if value[1] != client}

    def pump(self) -> None:
        """Send the drags that are due."""
        now, due = self._clock(), []
        with self._lock:
            for key, (asked, _, words) in list(self._dragged.items()):
                if now - self._sent.get(key, -1.0e9) < PERIOD:
                    continue
                del self._dragged[key]
                if now - asked <= STALE:
                    self._sent[key] = now
                    due.append(words)
        for words in due:
            request = self._read(words)
            if request is not None:
                self._deliver(request, "")

    def _read(self, words: Sequence[str]) -> Request | None:
        """Parse a request; None if it is not valid, with the reason on the page."""
        try:
            return parse_request(words, self._settings)
        except WbcError as error:
            self._report(" ".join(words), str(error))
        except Exception as error:  # the thread must survive it
            _log.exception("could not read the request %r", " ".join(words))
            self._report(" ".join(words), f"could not be read: {error}")
        return None

    def _run(self) -> None:
        while True:
            try:
                request = self._requests.get(timeout=PERIOD / 4.0)
            except queue.Empty:
                self.pump()
                continue
            if request is None:
                return
            self._deliver(request, request.summary)
            self.pump()

    def _deliver(self, request: Request, words: str) -> None:
        try:
            self._send(request)
        except WbcError as error:
            self._report(words or request.summary, str(error))
        except Exception as error:
            _log.exception("a request could not be sent")
            self._report(words or request.summary, f"it could not be sent: {error}")
        else:
            self._report(words, "")
