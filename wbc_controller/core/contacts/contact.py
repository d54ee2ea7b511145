"""What every contact is: a motion that it forbids, and the forces that it can bear."""

from __future__ import annotations

from abc import ABC, abstractmethod

import numpy as np
import pinocchio as pin

from wbc_controller.core.robot.dynamics import Dynamics
from wbc_controller.records import Array, frozen


class Contact(ABC):
    """A contact of a link with the environment, or with another link of the robot.

    It forbids motion, J v̇ + J̇v = -D J v (equation (30) of the note; D takes out what velocity there is), and in
    return exerts the generalized force Jᵀf (section 4.2.2), where f lies in the cone C f ≤ 0 and between bounds. For a
    contact between two links J v is their relative velocity, so that Jᵀf is what both of them feel.

    Attributes:
        name: the contact's name.
        basis: (6, k) with orthonormal columns: the wrench [force, moment] of f, as it is published, is basis f, and f
            is basisᵀ times the wrench.
        wrench_frame: the link in whose contact frame the wrench is given, or ``world``.
        cone: C, (rows, k).
        damping: D, 1/s.
        internal: whether it is between two links of the robot: then it exerts nothing on the robot as a whole.
        permanent: whether it is always made: no command makes or breaks it.
        bound_groups: what is bounded: a name, and from which component of f up to which (without it) that is.
        friction: Coulomb friction coefficient; 0 where the force has no cone.
        min_normal_force: smallest normal force, N; -inf where the contact also pulls.
        enabled: whether a user's own contact is active at activation; of a configured one its settings say so.
        ramp: time in which a user's own contact is loaded or unloaded, s; likewise.
    """

    permanent = False
    enabled: bool = True
    ramp: float = 0.2
    bound_groups: tuple[tuple[str, int, int], ...] = ()
    friction = 0.0
    min_normal_force = -np.inf

    def __init__(
        self, name: str, basis: Array, cone: Array, wrench_frame: str, *, damping: float, internal: bool
    ) -> None:
        self.name = name
        self.basis = basis
        self.wrench_frame = wrench_frame
        self.cone = cone
        self.damping = damping
        self.internal = internal
        #: Which components of f are moments, (k,).
        self.moments: np.ndarray = np.asarray(basis[3:].any(axis=0))
        #: Number of force components, k.
        self.size = basis.shape[1]

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

    @abstractmethod
    def bounds(self, activation: float) -> tuple[Array, Array]:
        """Lower and upper bounds of f, both (k,); to be read only.

        Args:
            activation: from 0 (about to break) to 1 (made); the largest forces are scaled by it.
        """

    def acceleration_at_rest(self, dynamics: Dynamics) -> Array:
        """What J v̇ has to be where J v = 0, (k,): the contact keeps still."""
        return -self.drift(dynamics)


class AnchoredContact(Contact):
    """A contact that is made at a place, its anchor, and goes back there where something moved it.

    To the acceleration that the contact has it adds K e, where e is the displacement from where it is to its anchor
    (`core.anchors` says how):

        J v̇ + J̇v = -D J v + K e

    Attributes:
        stiffness: K, 1/s²; 0 where it has no anchor.
    """

    def __init__(
        self,
        name: str,
        basis: Array,
        cone: Array,
        wrench_frame: str,
        *,
        stiffness: float,
        damping: float,
        internal: bool,
    ) -> None:
        super().__init__(name, basis, cone, wrench_frame, damping=damping, internal=internal)
        self.stiffness = stiffness

    @abstractmethod
    def pose(self, dynamics: Dynamics) -> pin.SE3:
        """Where the contact is, and how its link is turned, in what it touches: the world, or a link."""

    def anchor(self, dynamics: Dynamics) -> Array:
        """The anchor of a contact that is made now, (7,): position in m and quaternion of its pose."""
        return frozen(pin.SE3ToXYZQUAT(self.pose(dynamics)))

    @abstractmethod
    def displacement(self, dynamics: Dynamics, anchor: Array) -> Array:
        """e, along the axes in which f is expressed, (k,) in m and rad: what J v = e would undo in a second.

        To first order; of the axes of f along which there is no place to go back to it is 0.
        """


class UnilateralContact(AnchoredContact):
    """A contact that only pushes, and slides where friction does not hold it.

    Attributes:
        normal: index in f of the normal force.
        friction: Coulomb friction coefficient.
        min_normal_force: smallest normal force, N.
        max_normal_force: largest normal force, N.
        max_yaw_moment: largest moment about the normal, N·m; inf where the cone alone bounds it.
    """

    normal = 2

    def __init__(
        self,
        name: str,
        basis: Array,
        cone: Array,
        wrench_frame: str,
        *,
        internal: bool,
        friction: float = 0.7,
        min_normal_force: float = 0.0,
        max_normal_force: float = 1000.0,
        max_yaw_moment: float = np.inf,
        damping: float = 20.0,
        stiffness: float = 0.0,
    ) -> None:
        super().__init__(name, basis, cone, wrench_frame, stiffness=stiffness, damping=damping, internal=internal)
        self.friction = friction
        self.min_normal_force = min_normal_force
        self.max_normal_force = max_normal_force
        self.max_yaw_moment = max_yaw_moment
        self.bound_groups = (("normal_force", 2, 3),)
        self._largest = (np.nan, np.nan, np.nan)
        self._bounds = (np.zeros(0), np.zeros(0))
        if max_yaw_moment < np.inf:
            self.bound_groups += (("yaw_moment", 5, 6),)

    def bounds(self, activation: float) -> tuple[Array, Array]:
        """Lower and upper bounds of f, both (k,): the activation scales the largest normal force and yaw moment.

        While nothing changes they are the same arrays.
        """
        largest = (activation * self.max_normal_force, activation * self.max_yaw_moment, self.min_normal_force)
        if largest == self._largest:
            return self._bounds
        normal, yaw, smallest = largest
        lower, upper = np.full(self.size, -np.inf), np.full(self.size, np.inf)
        upper[2] = normal
        lower[2] = min(smallest, normal)
        if self.max_yaw_moment < np.inf:
            upper[5] = yaw
            lower[5] = -yaw
        self._largest, self._bounds = largest, (lower, upper)
        return self._bounds
