"""Sender of requests from the pages."""

import contextlib
import logging
import queue
import threading
import time
from collections.abc import Callable, Sequence

from wbc_controller.apps.terminal.request_parser import Request, parse_request
from wbc_controller.errors import WbcError
from wbc_controller.settings import Settings

_log = logging.getLogger(__name__)

PERIOD = 0.05  # of a drag, s
MAX_AGE = 0.5  # of a drag, s
_QUEUE_SIZE = 200


class RequestSender:
    """Sends requests on its own thread; the newest value of each drag once per `PERIOD`."""

    def __init__(
        self,
        settings: Settings,
        send: Callable[[Request], object],
        report: Callable[[str, str], None],
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        """Create the sender.

        `send` may raise `WbcError`. `report` receives the words of each request, empty for a drag, and its error or an
        empty text.
        """
        self._settings, self._send, self._report, self._clock = settings, send, report, clock
        self._requests: queue.Queue[Request] = queue.Queue(_QUEUE_SIZE)
        self._dragged: dict[str, tuple[float, int, Sequence[str] | Request]] = {}
        self._sent: dict[str, float] = {}
        self._lock, self._closed = threading.Lock(), threading.Event()
        self._thread = threading.Thread(target=self._run, name="sender", daemon=True)

    def start(self) -> None:
        """Start the thread."""
        self._thread.start()

    def close(self) -> None:
        """End the thread, without the queued requests."""
        self._closed.set()
        with self._lock:
            self._dragged.clear()
        if self._thread.is_alive():
            self._thread.join()

    def send_words(self, *words: str) -> None:
        """Send a request of `wbc send`; emergency stops overtake."""
        request = self._parse(words)
        if request is not None:
            self.request(request, " ".join(words))

    def request(self, request: Request, words: str = "") -> None:
        """Queue a request, reported by its words."""
        words = words or request.summary
        if (request.key, request.summary) == ("command", "estop"):
            with self._lock:
                self._dragged.clear()
            self._deliver(request, words)
            return
        try:
            self._requests.put_nowait(request)
        except queue.Full:
            self._report(words, f"dropped: the queue of {_QUEUE_SIZE} requests is full")

    def drag(self, key: str, client: int, value: Sequence[str] | Request) -> None:
        """Store the newest value of a page's drag: a request, or its words."""
        with self._lock:
            self._dragged[key] = self._clock(), client, value

    def drop_drags(self, client: int) -> None:
        """Drop the drags of a closed page."""
        with self._lock:
            self._dragged = {key: value for key, value in self._dragged.items() if value[1] != client}

    def send_due_drags(self) -> None:
        """Send the drags that are due."""
        now, due = self._clock(), []
        with self._lock:
            for key, (requested_at, _, value) in list(self._dragged.items()):
                if now - self._sent.get(key, -1.0e9) < PERIOD:
                    continue
                del self._dragged[key]
                if now - requested_at <= MAX_AGE:
                    self._sent[key] = now
                    due.append(value)
        for value in due:
            request = value if isinstance(value, Request) else self._parse(value)
            if request is not None:
                self._deliver(request, "")

    def _parse(self, words: Sequence[str]) -> Request | None:
        try:
            return parse_request(words, self._settings)
        except WbcError as error:
            self._report(" ".join(words), str(error))
        except Exception as error:
            _log.exception("parsing of the request %r failed", " ".join(words))
            self._report(" ".join(words), f"parsing failed: {error}")
        return None

    def _run(self) -> None:
        while not self._closed.is_set():
            with contextlib.suppress(queue.Empty):
                request = self._requests.get(timeout=PERIOD / 4.0)
                self._deliver(request, request.summary)
            self.send_due_drags()

    def _deliver(self, request: Request, words: str) -> None:
        try:
            self._send(request)
        except WbcError as error:
            self._report(words or request.summary, str(error))
        except Exception as error:
            _log.exception("sending of a request failed")
            self._report(words or request.summary, f"sending failed: {error}")
        else:
            self._report(words, "")
