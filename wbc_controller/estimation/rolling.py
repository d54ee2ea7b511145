"""Balls that roll on the ground: their points of contact are not fixed to them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from wbc_controller.estimation.invariant_filter import hat
from wbc_controller.records import Array

_NO_WAY = np.zeros(3)


class Rolling:
    """By how far the centres of balls have rolled since their contacts began.

    Attributes:
        names: of the contacts that are balls and hold.
    """

    def __init__(self, radii: Mapping[str, Array]) -> None:
        """Begin without contacts; the radii r n lead from contact point to centre in the world, (3,) in m."""
        self.names: tuple[str, ...] = ()
        self._turned = {name: hat(radius).T for name, radius in radii.items()}  # ω × r n is this times ω
        self._ways: dict[str, Array] = {}

    def enter(self, name: str) -> None:
        """Begin with a contact, if it is a ball."""
        if name in self._turned:
            self._ways[name] = _NO_WAY
            self._remember()

    def leave(self, name: str) -> None:
        """End a contact."""
        if self._ways.pop(name, None) is not None:
            self._remember()

    def _remember(self) -> None:
        self.names = tuple(self._ways)
        self._stack = np.array([self._turned[name] for name in self.names])

    def turn(self, omega: Array, dt: float) -> None:
        """Let the balls turn for dt, s: centres move by ω × r n; ω in the world, in the order of `names`, (c, 3)."""
        steps = dt * (self._stack @ omega[:, :, None])[:, :, 0]
        for i, name in enumerate(self.names):
            self._ways[name] = self._ways[name] + steps[i]

    def of(self, contacts: Sequence[str], ends: np.ndarray) -> Array:
        """How far the points of some contacts have rolled, in the world, (k, 3) in m: zero but for balls.

        `ends` says after which of the points those of each contact end, (c,).
        """
        ways = np.array([self._ways.get(name, _NO_WAY) for name in contacts])
        return ways if ends[-1] == len(ways) else np.repeat(ways, np.diff(ends, prepend=0), axis=0)
