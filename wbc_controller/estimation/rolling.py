"""Displacement of rolling balls."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import pinocchio as pin

from wbc_controller.records import Array

_ZERO = np.zeros(3)


class Rolling:
    """Rolling displacements of the centres of active balls, by name in `names`."""

    def __init__(self, radii: Mapping[str, Array]) -> None:
        """Start without contacts; the radii r n point from contact point to centre in the world, (3,) in m."""
        self.names: tuple[str, ...] = ()
        self._cross_matrices = {name: pin.skew(radius).T for name, radius in radii.items()}  # ω × r n = matrix @ ω
        self._displacements: dict[str, Array] = {}

    def add(self, name: str) -> None:
        """Start a contact if it is a ball."""
        if name in self._cross_matrices:
            self._displacements[name] = _ZERO
            self._update_stack()

    def remove(self, name: str) -> None:
        """End a contact."""
        if self._displacements.pop(name, None) is not None:
            self._update_stack()

    def _update_stack(self) -> None:
        self.names = tuple(self._displacements)
        self._stack = np.array([self._cross_matrices[name] for name in self.names])

    def integrate(self, omega: Array, dt: float) -> None:
        """Integrate ω × r n over dt, s; ω in the world, in the order of `names`, (c, 3)."""
        steps = dt * (self._stack @ omega[:, :, None])[:, :, 0]
        for i, name in enumerate(self.names):
            self._displacements[name] = self._displacements[name] + steps[i]

    def displacements(self, contacts: Sequence[str], ends: np.ndarray) -> Array:
        """Return the displacements of contact points in the world, (k, 3) in m."""
        ways = np.array([self._displacements.get(name, _ZERO) for name in contacts])
        return ways if ends[-1] == len(ways) else np.repeat(ways, np.diff(ends, prepend=0), axis=0)
