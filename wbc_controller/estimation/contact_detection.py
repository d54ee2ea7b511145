"""Contact detection from force sensors and contact switches, else from the planned contacts."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass

from wbc_controller.records import Array


@dataclass(frozen=True, slots=True)
class DetectionLimits:
    """Thresholds of the measured normal force, with hysteresis.

    Attributes:
        on: force along the normal above which an inactive contact becomes active, N.
        off: force below which an active contact becomes inactive, N; at most `on`.
        timeout: age from which a force is stale, s.
    """

    on: float
    off: float
    timeout: float


@dataclass(frozen=True, slots=True)
class ContactSensing:
    """Parameters of the sensors at the contacts.

    Attributes:
        normals: of each contact, the unit normal in the axes of each frame in which its force may be given, (3,).
        limits: thresholds of the force.
    """

    normals: Mapping[str, Mapping[str, Array]]
    limits: DetectionLimits


class ContactDetector:
    """Decides which contacts are active.

    The order of precedence, per contact: its force, while it is fresh; the last message of its switch, of any age, as
    some switches publish changes only; the planned contacts.

    Attributes:
        silent: contacts whose force was measured and is stale, in the last decision.
    """

    def __init__(self, limits: DetectionLimits) -> None:
        """Start without measurements."""
        self.limits = limits
        self.silent: tuple[str, ...] = ()
        self._by_force: dict[str, bool] = {}
        self._by_switch: dict[str, bool] = {}

    def update_force(self, contact: str, force: float) -> None:
        """Store the force on the robot along the normal of a contact, N; positive if the contact pushes."""
        self._by_force[contact] = force > (self.limits.off if self._by_force.get(contact) else self.limits.on)

    def update_switch(self, contact: str, active: bool) -> None:
        """Store the state of a contact switch."""
        self._by_switch[contact] = active

    def forget_forces(self) -> None:
        """Forget the forces, after a restart of the clock."""
        self._by_force.clear()
        self.silent = ()

    def active(self, planned: Collection[str], ages: Mapping[str, float]) -> frozenset[str]:
        """Return the names of the active contacts.

        Args:
            planned: names of the contacts that the controller uses.
            ages: age of the newest force of each contact, s; contacts without forces may be missing.
        """
        fresh = {name: active for name, active in self._by_force.items() if ages[name] <= self.limits.timeout}
        self.silent = tuple(name for name in self._by_force if name not in fresh)
        measured = {**self._by_switch, **fresh}
        unmeasured = [name for name in planned if name not in measured]
        return frozenset(unmeasured + [name for name, active in measured.items() if active])
