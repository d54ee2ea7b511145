"""Displacement of rolling balls."""

from collections.abc import Mapping, Sequence

import numpy as np

from wbc_controller.inverse_dynamics.arrays import cross
from wbc_controller.records import Array

_ZERO = np.zeros(3)


class Rolling:
    """Rolling displacements of the centres of active balls."""

    def __init__(self, radii: Mapping[str, Array]) -> None:
        """Start without contacts; the radii r n point from contact point to centre in the world, (3,) in m."""
        self._radii = radii
        self._displacements: dict[str, Array] = {}

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the active balls."""
        return tuple(self._displacements)

    def add(self, name: str) -> None:
        """Start a contact if it is a ball."""
        if name in self._radii:
            self._displacements[name] = _ZERO

    def remove(self, name: str) -> None:
        """End a contact."""
        self._displacements.pop(name, None)

    def integrate(self, omega: Array, dt: float) -> None:
        """Integrate ω × r n over dt, s; ω in the world, in the order of `names`, (c, 3)."""
        for name, turning in zip(self.names, omega, strict=True):
            self._displacements[name] = self._displacements[name] + dt * cross(turning, self._radii[name])

    def displacements(self, contacts: Sequence[str], ends: np.ndarray) -> Array:
        """Return the displacements of contact points in the world, (k, 3) in m."""
        ways = np.array([self._displacements.get(name, _ZERO) for name in contacts])
        return ways if ends[-1] == len(ways) else np.repeat(ways, np.diff(ends, prepend=0), axis=0)
