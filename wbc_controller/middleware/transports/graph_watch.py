"""Periodic check for other publishers."""

import logging
import threading
from collections.abc import Callable, Iterable, Mapping

from wbc_controller.errors import TransportError
from wbc_controller.middleware.topics import Endpoint
from wbc_controller.middleware.transports.transport import UNNAMED, Transport

_log = logging.getLogger(__name__)

PERIOD = 0.25  # period of the checks, s

OtherPublishers = Mapping[str, tuple[str, ...]]  # node names by row of the topic table


class GraphWatch:
    """Monitor of the other publishers on some topics; `changed` receives all of them at each change.

    Unnamed nodes count from the second check on, because names arrive after publishers.
    """

    def __init__(
        self, transport: Transport, topics: Iterable[Endpoint], changed: Callable[[OtherPublishers], None]
    ) -> None:
        self._transport = transport
        self._topics = {topic.key: topic for topic in topics}
        self._changed = changed
        self._found: dict[str, tuple[str, ...]] = {}
        self._reported: dict[str, tuple[str, ...]] = dict.fromkeys(self._topics, ())
        self._ended = threading.Event()
        self._thread: threading.Thread | None = None

    def check(self) -> None:
        """Check once; raises `TransportError` if the transport is closed or the graph cannot be read."""
        before, self._found = self._found, {key: self._transport.publishers(at) for key, at in self._topics.items()}
        others = {
            key: tuple(name for name in names if name != UNNAMED or UNNAMED in before.get(key, ()))
            for key, names in self._found.items()
        }
        if others != self._reported:
            self._reported = others
            self._changed(others)

    def start(self) -> None:
        """Check now, then every `PERIOD` on a thread."""
        self.check()
        self._ended.clear()
        self._thread = threading.Thread(target=self._run, name="graph", daemon=True)
        self._thread.start()

    def stop(self) -> None:
        """End the thread."""
        thread, self._thread = self._thread, None
        if thread is not None:
            self._ended.set()
            thread.join()

    def _run(self) -> None:
        while not self._ended.wait(PERIOD):
            try:
                self.check()
            except TransportError:
                _log.exception("the check for other publishers has ended")
                return
