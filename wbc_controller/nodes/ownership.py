"""Check of the other publishers of the robot's torques, odometry and time."""

from __future__ import annotations

import logging
import math
import threading
import time
from collections.abc import Iterable, Mapping, Sequence

from wbc_controller.middleware.topics import Endpoint
from wbc_controller.middleware.transports.graph_watch import PERIOD, GraphWatch, Others
from wbc_controller.middleware.transports.transport import Transport

_log = logging.getLogger(__name__)

#: Topics that one node publishes, by key. Joint states may come from several, such as a gripper's driver.
_OF_ONE = ("odom", "clock")


class Ownership:
    """Checks the other publishers on the controller's topics.

    A loop in real time checks the graph on a thread of its own (`start`), one in lockstep in its cycles (`refresh`).

    Attributes:
        contested: a sentence for each topic with publishers that exclude each other; with any, the controller must not
            be activated.
        shared: node names of all publishers of an input with several, by the topic's name.
    """

    def __init__(
        self, transport: Transport, topics: Iterable[Endpoint], allowed: Sequence[str], node: str, *, simulated: bool
    ) -> None:
        """Start to look at the graph, after the controller's topics have been opened.

        Args:
            allowed: nodes that may publish torques too; without a leading slash, in the controller's namespace.
            simulated: True if the controller's clock is that of the topic ``clock``.
        """
        self.contested: tuple[str, ...] = ()
        self.shared: Mapping[str, str] = {}
        namespace = node.rpartition("/")[0]
        self._allowed = {name if name.startswith("/") else f"{namespace}/{name}" for name in allowed}
        keys = ("effort", "joint_states", "odom", *(("clock",) if simulated else ()))
        self._topics = {topic.key: topic.name for topic in topics if topic.key in keys}
        self._watch = GraphWatch(transport, [topic for topic in topics if topic.key in keys], self._judge)
        self._watch.look()  # names arrive from now on, for the check before the loop begins
        self._running = False
        self._looked = -math.inf
        self._known_at = time.monotonic() + transport.discovery_time

    def start(self, stop: threading.Event) -> None:
        """Look at the graph on a thread of its own from now on, until `stop()`.

        Wait first until the others are discovered, or `stop` is set: of two controllers that are started at once, each
        has to see the other before it can be activated.
        """
        unknown = self._known_at - time.monotonic()
        if unknown > 0.0:
            stop.wait(unknown)
        self._watch.start()
        self._running = True

    def stop(self) -> None:
        """End the thread."""
        self._watch.stop()
        self._running = False

    def refresh(self, now: float) -> None:
        """Look at the graph if it is due and no thread does; `now` is the time on the clock of the loop, s."""
        if not self._running and not (0.0 <= now - self._looked < PERIOD):
            self._looked = now
            self._watch.look()

    def _judge(self, others: Others) -> None:
        contested = []
        rivals = [name for name in others["effort"] if name not in self._allowed]
        if rivals:
            contested.append(
                f"torques on {self._topics['effort']} are published by {', '.join(rivals)} too: end it, or name it in "
                "safety.torque_publishers; a process that was killed is seen for some 10 s more"
            )
        for key in _OF_ONE:
            if len(others.get(key, ())) > 1:
                contested.append(
                    f"{self._topics[key]} has several publishers, {', '.join(others[key])}: end all but one"
                )
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
