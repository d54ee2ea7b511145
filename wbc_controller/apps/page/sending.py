"""What a page sends: requests at once, and what is dragged at a bounded rate and only while it is being dragged."""

from __future__ import annotations

import logging
import queue
import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from wbc_controller.apps.terminal.sentences import Request, read_sentence
from wbc_controller.errors import WbcError
from wbc_controller.settings import Settings

_log = logging.getLogger(__name__)

#: Time between two messages of what is being dragged, s.
PERIOD = 0.05
#: Age from which on a drag is not sent any more, s: it has waited behind something, and its user has gone on.
STALE = 0.5
#: Requests that may wait; more than that is no user.
_MOST = 200


@dataclass(frozen=True, slots=True)
class Said:
    """What came of a request.

    Attributes:
        sentence: as `wbc send` would be told it; empty for one that was dragged.
        error: why it was not sent; empty where it was.
    """

    sentence: str
    error: str = ""


class Sender:
    """Sends what the pages ask for, on a thread of its own, so that no page waits for a node.

    What is dragged has a slot for its newest value, which is sent once per `PERIOD` at most. Nothing is ever sent that
    no event of a page has just asked for: the last event of a drag is its last message, whatever ends the drag.
    """

    def __init__(
        self,
        settings: Settings,
        send: Callable[[Request], None],
        told: Callable[[Said], None],
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        """Make it; `start` starts its thread.

        Args:
            settings: of the robot.
            send: sends one request, from any thread; may raise `WbcError`.
            told: called with what came of each, on the sender's thread or, for an emergency stop, on the caller's.
            clock: monotonic, s.
        """
        self._settings, self._send, self._told, self._clock = settings, send, told, clock
        self._requests: queue.Queue[Request | None] = queue.Queue(_MOST)
        self._dragged: dict[str, tuple[float, int, Sequence[str] | Request]] = {}
        self._sent: dict[str, float] = {}
        self._lock = threading.Lock()
        self._thread = threading.Thread(target=self._run, name="sender", daemon=True)

    def start(self) -> None:
        """Start to send."""
        self._thread.start()

    def close(self) -> None:
        """End the thread; what waits is not sent."""
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
        """Send a sentence of `wbc send`; an emergency stop overtakes everything that waits."""
        request = self._read(words)
        if request is not None:
            self.request(request, " ".join(words))

    def request(self, request: Request, sentence: str = "") -> None:
        """Send a request that is no sentence."""
        if (request.key, request.said) == ("command", "estop"):
            with self._lock:
                self._dragged.clear()
            self._deliver(request, sentence or request.said)
            return
        try:
            self._requests.put_nowait(request)
        except queue.Full:
            self._told(Said(sentence or request.said, "too many requests wait to be sent"))

    def drag(self, key: str, client: int, asked: Sequence[str] | Request) -> None:
        """Keep the newest value of what a page drags: a request, or the words of a sentence.

        Args:
            key: what is dragged: a newer value takes the place of one that waits.
            client: number of the page.
            asked: the value.
        """
        with self._lock:
            self._dragged[key] = self._clock(), client, asked

    def forget(self, client: int) -> None:
        """Drop what a page has dragged and what has not been sent yet: it is gone."""
        with self._lock:
            self._dragged = {key: value for key, value in self._dragged.items() if value[1] != client}

    def pump(self) -> None:
        """Send what is being dragged and is due."""
        now, due = self._clock(), []
        with self._lock:
            for key, (asked, _, what) in list(self._dragged.items()):
                if now - self._sent.get(key, -1.0e9) < PERIOD:
                    continue
                del self._dragged[key]
                if now - asked <= STALE:
                    self._sent[key] = now
                    due.append(what)
        for what in due:
            request = what if isinstance(what, Request) else self._read(what)
            if request is not None:
                self._deliver(request, "")

    def _read(self, words: Sequence[str]) -> Request | None:
        """Read a sentence; None if it cannot be sent, with the reason on the page."""
        try:
            return read_sentence(words, self._settings)
        except WbcError as error:
            self._told(Said(" ".join(words), str(error)))
        except Exception as error:  # the thread must survive it
            _log.exception("could not read the sentence %r", " ".join(words))
            self._told(Said(" ".join(words), f"could not be read: {error}"))
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
            self._deliver(request, request.said)
            self.pump()

    def _deliver(self, request: Request, sentence: str) -> None:
        try:
            self._send(request)
        except WbcError as error:
            self._told(Said(sentence or request.said, str(error)))
        except Exception as error:
            _log.exception("a request could not be sent")
            self._told(Said(sentence or request.said, f"it could not be sent: {error}"))
        else:
            self._told(Said(sentence))
