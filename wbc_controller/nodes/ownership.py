"""Check for other publishers."""

import logging
import math
import threading
import time
from collections.abc import Iterable, Mapping, Sequence

from wbc_controller.middleware.topics import Endpoint
from wbc_controller.middleware.transports.graph_watch import PERIOD, GraphWatch, OtherPublishers
from wbc_controller.middleware.transports.transport import Transport

_log = logging.getLogger(__name__)

#: Topics with a single publisher, by key. Joint states may have several, such as a gripper's driver.
_SINGLE_PUBLISHER = ("odom", "clock")


class Ownership:
    """Monitor of other publishers on the controller's topics, on a thread (`start`) or in lockstep (`refresh`)."""

    def __init__(
        self, transport: Transport, topics: Iterable[Endpoint], allowed: Sequence[str], node: str, *, simulated: bool
    ) -> None:
        """Check the graph once, after the topics were opened; `allowed` nodes may publish torques too."""
        self.contested: tuple[str, ...] = ()  # a sentence per topic with conflicting publishers; prevents activation
        self.shared: Mapping[str, str] = {}  # publishers of inputs with several, by topic name
        namespace = node.rpartition("/")[0]
        self._allowed = {name if name.startswith("/") else f"{namespace}/{name}" for name in allowed}
        keys = ("effort", "joint_states", "odom", *(("clock",) if simulated else ()))
        self._topics = {topic.key: topic.name for topic in topics if topic.key in keys}
        self._watch = GraphWatch(transport, [topic for topic in topics if topic.key in keys], self._update_publishers)
        self._watch.check()  # starts the discovery of node names
        self._running = False
        self._checked_at = -math.inf
        self._discovered_at = time.monotonic() + transport.discovery_time

    def start(self, stop: threading.Event) -> None:
        """Wait for discovery (or `stop`), so that two controllers see each other; then check on a separate thread."""
        unknown = self._discovered_at - time.monotonic()
        if unknown > 0.0:
            stop.wait(unknown)
        self._watch.start()
        self._running = True

    def stop(self) -> None:
        """End the thread."""
        self._watch.stop()
        self._running = False

    def refresh(self, now: float) -> None:
        """Check the graph if due and no thread does; `now` in s."""
        if not self._running and not (0.0 <= now - self._checked_at < PERIOD):
            self._checked_at = now
            self._watch.check()

    def _update_publishers(self, others: OtherPublishers) -> None:
        contested = []
        others_on_torques = [name for name in others["effort"] if name not in self._allowed]
        if others_on_torques:
            contested.append(
                f"torques on {self._topics['effort']} are published by {', '.join(others_on_torques)} too: stop it, or "
                "add it to safety.torque_publishers; a killed process stays in the graph for 10 s"
            )
        for key in _SINGLE_PUBLISHER:
            found = others.get(key, ())
            if len(found) > 1:
                contested.append(f"{self._topics[key]} has several publishers: {', '.join(found)}; stop all but one")
        for sentence in contested:
            if sentence not in self.contested:
                _log.warning("%s", sentence)
        shared = {
            self._topics[key]: ", ".join(names) for key, names in others.items() if key != "effort" and len(names) > 1
        }
        for topic, names in shared.items():
            if topic not in self.shared and topic == self._topics["joint_states"]:
                _log.warning("%s has several publishers: %s", topic, names)
        self.contested, self.shared = tuple(contested), shared
