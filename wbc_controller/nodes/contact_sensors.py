"""Force sensors and switches at the contacts: decodes their messages and returns the active contacts."""

from __future__ import annotations

from collections.abc import Callable, Collection

from wbc_controller.errors import InputRefused
from wbc_controller.estimation.contact_detection import ContactDetector, ContactSensing
from wbc_controller.middleware.codec import decode
from wbc_controller.middleware.stamps import StampTracker
from wbc_controller.middleware.states import ContactForceReader
from wbc_controller.middleware.topics import Endpoint

#: Rows of the topic table that are read here.
KEYS = ("measured_wrench", "holds")


class ContactSensors:
    """Decodes the messages of the sensors at the contacts, on the thread of the cycle."""

    def __init__(self, sensing: ContactSensing, tracker: Callable[[], StampTracker]) -> None:
        self._detector = ContactDetector(sensing.limits)
        self._tracker = tracker
        self._readers = {name: ContactForceReader(name, normals) for name, normals in sensing.normals.items()}
        self._stamps: dict[str, StampTracker] = {}
        self._topics: dict[str, str] = {}

    def read(self, endpoint: Endpoint, arrival: float, payload: bytes) -> None:
        """Decode and keep a message.

        Raises:
            InputRefused: if the message or its timestamp is invalid.
        """
        contact = endpoint.subject
        if endpoint.key == "holds":
            self._detector.update_switch(contact, bool(decode(payload, endpoint.type).data))
            return
        measured = self._readers[contact].read(payload)
        if contact not in self._stamps:
            self._stamps[contact], self._topics[contact] = self._tracker(), endpoint.name
        reason = self._stamps[contact].judge(measured.stamp, arrival)
        if reason is not None:
            raise InputRefused(reason)
        self._detector.update_force(contact, measured.normal)

    def restart(self) -> None:
        """Accept the next timestamps as those of a new time."""
        self._stamps.clear()
        self._detector.forget_forces()

    def decide(self, now: float, meant: Collection[str]) -> tuple[Collection[str], list[str]]:
        """Return the contacts that hold, and a sentence for each newly silent sensor.

        Args:
            now: s, on the clock of the arrivals.
            meant: names of the contacts that should hold.
        """
        before = self._detector.silent
        holding = self._detector.active(meant, {name: stamps.age(now) for name, stamps in self._stamps.items()})
        return holding, [
            f"{self._topics[name]}: {self._silence(name)}" for name in self._detector.silent if name not in before
        ]

    def notes(self) -> dict[str, str]:
        """Return a sentence for each silent sensor, by topic."""
        return {self._topics[name]: self._silence(name) for name in self._detector.silent}

    def _silence(self, contact: str) -> str:
        return (
            f"the force sensor is silent for more than {self._detector.limits.timeout:g} s "
            f"(estimation.contact_timeout); contact {contact!r} counts as holding where it is meant to"
        )
