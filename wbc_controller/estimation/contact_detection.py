"""Contact detection from sensors, else planned contacts."""

from collections.abc import Collection, Mapping
from dataclasses import dataclass

from wbc_controller.records import Array


@dataclass(frozen=True, slots=True)
class ContactSensing:
    """Contact force sensors, with hysteresis of the normal force."""

    normals: Mapping[str, Mapping[str, Array]]  # of each contact, (3,), by the frame in which a force may be given
    on: float  # force that activates a contact, N
    off: float  # force that deactivates it, N; at most `on`
    timeout: float  # age of a stale force, s


class ContactDetector:
    """Detector of active contacts: by fresh force, else by the last switch message, else as planned.

    Attributes:
        silent: contacts with a stale force.
        measured: state of each contact with a switch or a fresh force.
    """

    def __init__(self, sensing: ContactSensing) -> None:
        self.sensing = sensing
        self.silent: tuple[str, ...] = ()
        self.measured: Mapping[str, bool] = {}
        self._by_force: dict[str, bool] = {}
        self._by_switch: dict[str, bool] = {}

    def update_force(self, contact: str, force: float) -> None:
        """Store the normal force at a contact, N; positive if it pushes the robot."""
        self._by_force[contact] = force > (self.sensing.off if self._by_force.get(contact) else self.sensing.on)

    def update_switch(self, contact: str, active: bool) -> None:
        """Store the state of a contact switch."""
        self._by_switch[contact] = active

    def forget_forces(self) -> None:
        """Reset the forces after a restart of the clock."""
        self._by_force.clear()
        self.silent = ()
        self.measured = dict(self._by_switch)

    def active(self, planned: Collection[str], ages: Mapping[str, float]) -> frozenset[str]:
        """Return the active contacts from the planned ones and the forces' ages, s."""
        fresh = {name: active for name, active in self._by_force.items() if ages[name] <= self.sensing.timeout}
        self.silent = tuple(name for name in self._by_force if name not in fresh)
        self.measured = measured = {**self._by_switch, **fresh}
        unmeasured = [name for name in planned if name not in measured]
        return frozenset(unmeasured + [name for name, active in measured.items() if active])

    def timeout_note(self, contact: str) -> str:
        """Return a sentence on the stale force at a contact."""
        return (
            f"no force message for more than {self.sensing.timeout:g} s (estimation.contact_timeout); "
            f"contact {contact!r} is active as commanded"
        )
