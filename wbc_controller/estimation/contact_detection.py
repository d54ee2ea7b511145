"""Which contacts hold: by what is measured at them where something is, else as is meant."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass

from wbc_controller.records import Array


@dataclass(frozen=True, slots=True)
class HoldingLimits:
    """When a measured force says that a contact holds.

    Attributes:
        on: force along the normal above which a contact holds that did not, N.
        off: force below which one does not that did, N; at most `on`.
        timeout: age from which a force decides nothing, s.
    """

    on: float
    off: float
    timeout: float


@dataclass(frozen=True, slots=True)
class ContactSensing:
    """What has to be known of the sensors at the contacts.

    Attributes:
        normals: of each contact, the unit normal in the axes of each frame in which its force may be given, (3,).
        limits: from when on a force says that a contact holds.
    """

    normals: Mapping[str, Mapping[str, Array]]
    limits: HoldingLimits


class Holding:
    """Decides which contacts hold.

    Of each contact: its force, while it is fresh; else what its switch has said last, which may be long ago, as some
    switches speak on changes alone; else what is meant.

    Attributes:
        silent: contacts whose force was measured, and is not fresh any more, in the last decision.
    """

    def __init__(self, limits: HoldingLimits) -> None:
        """Begin with nothing measured."""
        self.limits = limits
        self.silent: tuple[str, ...] = ()
        self._pressed: dict[str, bool] = {}
        self._switched: dict[str, bool] = {}

    def press(self, contact: str, force: float) -> None:
        """Take the force on the robot along the normal of a contact, N, away from what it touches."""
        self._pressed[contact] = force > (self.limits.off if self._pressed.get(contact) else self.limits.on)

    def switch(self, contact: str, holds: bool) -> None:
        """Take what a switch says of a contact."""
        self._switched[contact] = holds

    def forget(self) -> None:
        """Forget the forces: the clock has begun anew."""
        self._pressed.clear()
        self.silent = ()

    def decide(self, meant: Collection[str], ages: Mapping[str, float]) -> frozenset[str]:
        """Names of the contacts that hold.

        Args:
            meant: names of those that are meant to hold.
            ages: of the newest force of each contact, s; those that have none may be missing.
        """
        fresh = {name: holds for name, holds in self._pressed.items() if ages[name] <= self.limits.timeout}
        self.silent = tuple(name for name in self._pressed if name not in fresh)
        said = {**self._switched, **fresh}
        return frozenset([name for name in meant if name not in said] + [name for name, holds in said.items() if holds])
