"""What every contact is: a motion that it forbids, and the forces that it can bear."""

from __future__ import annotations

from abc import ABC, abstractmethod

import numpy as np

from wbc_controller.core.dynamics import Dynamics
from wbc_controller.records import Array


class Contact(ABC):
    """A contact with the environment.

    It forbids motion, J v̇ + J̇v = -D J v (equation (30) of the note; D takes out what velocity there is), and in
    return exerts the generalized force Jᵀf (section 4.2.2), where f lies in the cone C f ≤ 0 and between bounds.

    Attributes:
        name: the contact's name.
        friction: Coulomb friction coefficient.
        cone: C, (rows, k).
        normal: index in f of the normal force.
        min_normal_force: smallest normal force, N.
        max_normal_force: largest normal force, N.
        damping: D, 1/s.
    """

    #: Number of force components, k.
    size: int

    def __init__(
        self,
        name: str,
        cone: Array,
        *,
        friction: float,
        min_normal_force: float,
        max_normal_force: float,
        damping: float,
    ) -> None:
        self.name = name
        self.friction = friction
        self.cone = cone
        self.normal = 2
        self.min_normal_force = min_normal_force
        self.max_normal_force = max_normal_force
        self.damping = damping

    @abstractmethod
    def jacobian(self, dynamics: Dynamics) -> Array:
        """J, (k, nv): velocity of the contact, in the axes in which f is expressed."""

    @abstractmethod
    def drift(self, dynamics: Dynamics) -> Array:
        """J̇v, (k,)."""

    @abstractmethod
    def points(self, dynamics: Dynamics) -> Array:
        """Corners of the support in the world, (n, 3) in m."""

    @abstractmethod
    def wrench_in_world(self, dynamics: Dynamics, force: Array) -> Array:
        """The force as a wrench about the world's origin, in world axes, (6,) in N and N·m."""

    def bounds(self, activation: float) -> tuple[Array, Array]:
        """Lower and upper bounds of f, both (k,).

        Args:
            activation: from 0 (about to break) to 1 (made); the largest normal force is scaled by it.
        """
        lower = np.full(self.size, -np.inf)
        upper = np.full(self.size, np.inf)
        upper[self.normal] = activation * self.max_normal_force
        lower[self.normal] = min(self.min_normal_force, upper[self.normal])
        return lower, upper
