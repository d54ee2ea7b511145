"""What is measured at the contacts, by force sensors and switches: messages in, contacts that hold out."""

from __future__ import annotations

from collections.abc import Callable, Collection

from wbc_controller.estimation.contact_detection import ContactDetector, ContactSensing
from wbc_controller.middleware.codec import decode
from wbc_controller.middleware.stamps import StampTracker
from wbc_controller.middleware.states import ContactForceReader
from wbc_controller.middleware.topics import Endpoint

#: Rows of the topic table that are read here.
KEYS = ("measured_wrench", "holds")


class ContactSensors:
    """Reads the sensors at the contacts, on the thread of the cycle."""

    def __init__(self, sensing: ContactSensing, tracker: Callable[[], StampTracker]) -> None:
        """Make it, with nothing heard.

        Args:
            sensing: what is known of the sensors.
            tracker: makes what judges the stamps of one stream.
        """
        self._detector = ContactDetector(sensing.limits)
        self._tracker = tracker
        self._readers = {name: ContactForceReader(name, normals) for name, normals in sensing.normals.items()}
        self._stamps: dict[str, StampTracker] = {}
        self._topics: dict[str, str] = {}

    def read(self, endpoint: Endpoint, received: float, payload: bytes) -> str | None:
        """Read a message.

        Args:
            endpoint: its topic.
            received: its time of arrival, s.
            payload: the serialized message.

        Returns:
            Why its stamp is refused, where it is.

        Raises:
            InputRefused: where it cannot be read.
        """
        contact = endpoint.subject
        if endpoint.key == "holds":
            self._detector.update_switch(contact, bool(decode(payload, endpoint.type).data))
            return None
        stamp, normal, _ = self._readers[contact].read(payload)
        if contact not in self._stamps:
            self._stamps[contact], self._topics[contact] = self._tracker(), endpoint.name
        reason = self._stamps[contact].judge(stamp, received)
        if reason is None:
            self._detector.update_force(contact, normal.item())
        return reason

    def restart(self) -> None:
        """Take the next stamps as those of a new time."""
        self._stamps.clear()
        self._detector.forget_forces()

    def decide(self, now: float, meant: Collection[str]) -> tuple[Collection[str], list[str]]:
        """Which contacts hold, and a sentence for each sensor that is newly silent.

        Args:
            now: s, on the clock of the arrivals.
            meant: names of the contacts that are meant to hold.
        """
        before = self._detector.silent
        holding = self._detector.active(meant, {name: stamps.age(now) for name, stamps in self._stamps.items()})
        return holding, [
            f"{self._topics[name]}: {self._silence(name)}" for name in self._detector.silent if name not in before
        ]

    def notes(self) -> dict[str, str]:
        """What to know about sensors that are silent, by topic."""
        return {self._topics[name]: self._silence(name) for name in self._detector.silent}

    def _silence(self, contact: str) -> str:
        return (
            f"the force sensor is silent for more than {self._detector.limits.timeout:g} s "
            f"(estimation.contact_timeout); contact {contact!r} counts as holding where it is meant to"
        )
