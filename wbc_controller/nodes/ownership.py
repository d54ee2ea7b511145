"""One owner of the robot: who else publishes its torques, its odometry or its time."""

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
    """Judges who else publishes on the controller's topics.

    A loop in real time looks at the graph on a thread of its own (`start`), one in lockstep in its cycles (`refresh`).

    Attributes:
        contested: a sentence for each topic on which nodes publish that exclude each other; with any, the controller
            must not be activated.
        shared: node names of all publishers of an input, where there are several, by the topic's name.
    """

    def __init__(
        self, transport: Transport, topics: Iterable[Endpoint], allowed: Sequence[str], node: str, *, simulated: bool
    ) -> None:
        """Make it when the topics have been opened.

        Args:
            transport: the controller's own.
            topics: the controller's endpoints.
            allowed: nodes that may publish torques too; those without a slash at the start are in the controller's
                namespace.
            node: name of the controller's node with its namespace.
            simulated: whether the controller's clock is that of the topic ``clock``.
        """
        self.contested: tuple[str, ...] = ()
        self.shared: Mapping[str, str] = {}
        namespace = node.rpartition("/")[0]
        self._allowed = {name if name.startswith("/") else f"{namespace}/{name}" for name in allowed}
        keys = ("effort", "joint_states", "odom", *(("clock",) if simulated else ()))
        self._topics = {topic.key: topic.name for topic in topics if topic.key in keys}
        self._watch = GraphWatch(transport, [topic for topic in topics if topic.key in keys], self._judge)
        self._watch.look()  # names arrive from now on, so that the look before the loop begins can tell whose they are
        self._running = False
        self._looked = -math.inf
        self._known_at = time.monotonic() + transport.discovery_time

    def start(self, stop: threading.Event) -> None:
        """Look at the graph on a thread of its own from now on, until `stop()`.

        Waits until the others can be known: of two controllers that are started at once, each has to see the other
        before it can be activated.

        Args:
            stop: event that ends the wait.
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
        """Look at the graph where no thread does, if it is time to.

        Args:
            now: s, on the clock of the loop.
        """
        if not self._running and not (0.0 <= now - self._looked < PERIOD):
            self._looked = now
            self._watch.look()

    def _judge(self, others: Others) -> None:
        contested = []
        rivals = [name for name in others["effort"] if name not in self._allowed]
        if rivals:
            contested.append(
                f"torques on {self._topics['effort']} are published by {_listed(rivals)} too: end it, or name it in "
                "safety.torque_publishers; a process that was killed is seen for some 10 s more"
            )
        for key in _OF_ONE:
            if len(others.get(key, ())) > 1:
                contested.append(f"{self._topics[key]} has several publishers, {_listed(others[key])}: end all but one")
        for sentence in contested:
            if sentence not in self.contested:
                _log.warning("%s", sentence)
        shared = {
            self._topics[key]: _listed(names) for key, names in others.items() if key != "effort" and len(names) > 1
        }
        for topic, names in shared.items():
            if topic not in self.shared and topic == self._topics["joint_states"]:
                _log.warning("%s has several publishers: %s", topic, names)
        self.contested, self.shared = tuple(contested), shared


def _listed(names: Sequence[str]) -> str:
    return ", ".join(names)
