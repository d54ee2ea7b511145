"""Force sensors and switches at contacts."""

from collections.abc import Callable, Collection, Mapping

from wbc_controller.errors import InputRefused
from wbc_controller.estimation.contact_detection import ContactDetector, ContactSensing
from wbc_controller.middleware.codec import decode
from wbc_controller.middleware.stamps import StampTracker
from wbc_controller.middleware.states import ContactForceReader
from wbc_controller.middleware.topics import Endpoint

KEYS = ("measured_wrench", "holds")  # rows of the topic table


class ContactSensors:
    """Decoders of the contact sensors, on the thread of the cycle."""

    def __init__(self, sensing: ContactSensing, tracker: Callable[[], StampTracker]) -> None:
        self._detector = ContactDetector(sensing)
        self._tracker = tracker
        self._readers = {name: ContactForceReader(name, normals) for name, normals in sensing.normals.items()}
        self._stamps: dict[str, StampTracker] = {}
        self._topics: dict[str, str] = {}

    def read(self, endpoint: Endpoint, arrival: float, payload: bytes) -> None:
        """Decode a message and update the contact detection; raises `InputRefused` if invalid."""
        contact = endpoint.subject
        if endpoint.key == "holds":
            self._detector.update_switch(contact, bool(decode(payload, endpoint.type).data))
            return
        measured = self._readers[contact].read(payload)
        if contact not in self._stamps:
            self._stamps[contact], self._topics[contact] = self._tracker(), endpoint.name
        reason = self._stamps[contact].check_stamp(measured.stamp, arrival)
        if reason is not None:
            raise InputRefused(reason)
        self._detector.update_force(contact, measured.normal)

    @property
    def measured(self) -> Mapping[str, bool]:
        """State of each contact with a fresh sensor, at the last `update_active`."""
        return self._detector.measured

    def restart(self) -> None:
        """Restart the timestamp trackers after a jump of the clock."""
        self._stamps.clear()
        self._detector.forget_forces()

    def update_active(self, now: float, commanded: Collection[str]) -> tuple[Collection[str], list[str]]:
        """Return the active ones of commanded contacts, and a sentence for each new sensor timeout."""
        before = self._detector.silent
        holding = self._detector.active(commanded, {name: stamps.age(now) for name, stamps in self._stamps.items()})
        return holding, [
            f"{self._topics[name]}: {self._timeout_note(name)}" for name in self._detector.silent if name not in before
        ]

    def notes(self) -> dict[str, str]:
        """Return a sentence for each timed-out sensor, by topic."""
        return {self._topics[name]: self._timeout_note(name) for name in self._detector.silent}

    def _timeout_note(self, contact: str) -> str:
        return (
            f"no force message for more than {self._detector.sensing.timeout:g} s (estimation.contact_timeout); "
            f"contact {contact!r} is active as commanded"
        )
