"""Watch of the other publishers on some topics: periodic looks at the graph, on a thread of its own."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable, Iterable, Mapping

from wbc_controller.errors import TransportError
from wbc_controller.middleware.topics import Endpoint
from wbc_controller.middleware.transports.transport import UNNAMED, Transport

_log = logging.getLogger(__name__)

#: Time between two looks, s.
PERIOD = 0.25

#: Node names of the other publishers, by the key of their topic in the topic table.
Others = Mapping[str, tuple[str, ...]]


class GraphWatch:
    """Looks for other publishers on some topics, and reports each change.

    A node without a name counts from the second look on: names arrive a little later than publishers.
    """

    def __init__(self, transport: Transport, topics: Iterable[Endpoint], changed: Callable[[Others], None]) -> None:
        """Create a watch of topics with different keys, which has not looked yet.

        `changed` is called with the other publishers on all topics at each change, on the thread that looks.
        """
        self._transport = transport
        self._topics = {topic.key: topic for topic in topics}
        self._changed = changed
        self._found: dict[str, tuple[str, ...]] = {}
        self._said: dict[str, tuple[str, ...]] = dict.fromkeys(self._topics, ())
        self._ended = threading.Event()
        self._thread: threading.Thread | None = None

    def look(self) -> None:
        """Look once.

        Raises:
            TransportError: if the transport is closed, or the graph cannot be read.
        """
        before, self._found = self._found, {key: self._transport.publishers(at) for key, at in self._topics.items()}
        others = {
            key: tuple(name for name in names if name != UNNAMED or UNNAMED in before.get(key, ()))
            for key, names in self._found.items()
        }
        if others != self._said:
            self._said = others
            self._changed(others)

    def start(self) -> None:
        """Look once now, and then on a thread of its own, every `PERIOD`, until `stop`."""
        self.look()
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
                self.look()
            except TransportError:
                _log.exception("other publishers are no longer watched")
                return
