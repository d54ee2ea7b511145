"""The base classes of contacts: each has a motion constraint, and bounds and a cone for its force."""

from __future__ import annotations

from abc import ABC, abstractmethod

import numpy as np
import pinocchio as pin

from wbc_controller.errors import MethodError
from wbc_controller.inverse_dynamics.method_calls import array_from, call, checked, is_finite, raised
from wbc_controller.inverse_dynamics.robot.dynamics import Dynamics
from wbc_controller.inverse_dynamics.robot.instruction import Instruction
from wbc_controller.inverse_dynamics.tunable import Tunable
from wbc_controller.records import Array, frozen


class Contact(Tunable, ABC):
    """A contact of a link with the environment, or with another link of the robot.

    While active it constrains motion by J v̇ + J̇v = -D J v (equation (30) of the note; D damps out the velocity at the
    contact), and exerts the generalized force Jᵀf (section 4.2.2), where f lies in the cone C f ≤ 0 and between bounds.
    For a contact between two links J v is their relative velocity, so that Jᵀf contains the forces on both links.

    `enabled` and `ramp` apply to contacts that a user passes as objects; for contacts of a configuration file the
    settings decide.

    Attributes:
        name: the contact's name.
        basis: (6, k) with orthonormal columns: the published wrench [force, moment] is basis f, and f is basisᵀ times
            that wrench.
        wrench_frame: the link in whose contact frame the wrench is given, or ``world``.
        cone: friction cone or wrench cone C, (rows, k).
        damping: D, 1/s.
        internal: whether it acts between two links of the robot: it then exerts no net force on the robot.
        metric: diagonal of W in the regularization ½ ε_f fᵀ W f, (k,): 1 for a force; for a moment 1/ℓ², in m⁻²,
            where ℓ is the RMS lever of forces at the corners of the sole, and 1 m where the contact has no size.
        permanent: whether it is always active: no command activates or deactivates it.
        bound_groups: the bounded parts of f: a name, the first component, and the one after the last.
        friction: Coulomb friction coefficient; 0 where the force has no cone.
        min_normal_force: smallest normal force, N; -inf where the contact can also pull.
        enabled: whether the contact is active when the controller is activated.
        ramp: time in which the contact is loaded or unloaded, s.
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
        self.metric: Array = np.ones(self.size)

    @property
    def full_name(self) -> str:
        """Kind and name, for error messages."""
        return f"contact {self.name!r}"

    @abstractmethod
    def jacobian(self, dynamics: Dynamics) -> Array:
        """J, (k, nv): J v is the velocity of the contact, in the axes in which f is expressed."""

    @abstractmethod
    def drift(self, dynamics: Dynamics) -> Array:
        """J̇v, (k,)."""

    @abstractmethod
    def points(self, dynamics: Dynamics) -> Array:
        """Corners of the support polygon in the world, (n, 3) in m."""

    @abstractmethod
    def wrench_in_world(self, dynamics: Dynamics, force: Array) -> Array:
        """The force as a wrench about the world's origin, in world axes, (6,) in N and N·m."""

    @abstractmethod
    def bounds(self, activation: float) -> tuple[Array, Array]:
        """Lower and upper bounds of f, both (k,); not to be modified.

        The activation scales the largest forces, from 0 (about to be deactivated) to 1 (fully active).
        """

    def instruction(self) -> Instruction | None:
        """How compiled code fills J and the required J v̇ at J v = 0; None where it does not know them, and `fill` does.

        Only a class itself gives one, not those derived from it: they may override what the rows follow from.
        """
        return None

    def acceleration_at_rest(self, dynamics: Dynamics) -> Array:
        """The required J v̇ at J v = 0, (k,): the acceleration that keeps the contact at rest."""
        return -checked(self, "drift", self.drift(dynamics), (self.size,))


class AnchoredContact(Contact):
    """A contact with an anchor, the pose at which it was activated, and position feedback towards it.

    The feedback adds K e to the acceleration of the contact, where e is the displacement from the present pose to the
    anchor (see `formulation.anchors`):

        J v̇ + J̇v = -D J v + K e

    Attributes:
        stiffness: K, 1/s²; 0 for a contact without an anchor.
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
        """Position of the contact and orientation of its link, relative to the world or to the link that it touches."""

    def anchor(self, dynamics: Dynamics) -> Array:
        """The anchor of a contact activated at this state, (7,): position in m and quaternion of its pose."""
        return frozen(pin.SE3ToXYZQUAT(self.pose(dynamics)))

    @abstractmethod
    def displacement(self, dynamics: Dynamics, anchor: Array) -> Array:
        """e, the displacement to the anchor along the axes in which f is expressed, (k,) in m and rad.

        To first order, J v = e held for one second returns to the anchor. e is 0 along axes of f in which the contact
        has no position to return to.
        """


def evaluate(contact: Contact, dynamics: Dynamics) -> None:
    """Evaluate the methods of a contact's motion and check what they return, as `tasks.task.evaluate` does.

    Raises:
        MethodError: if a method raises an exception, or returns another shape or type, NaN or infinity.
    """
    k, nv = (contact.size,), dynamics.model.nv
    array_from(contact, "jacobian", (*k, nv), dynamics)
    array_from(contact, "drift", k, dynamics)
    array_from(contact, "acceleration_at_rest", k, dynamics)


def motion_of(contact: Contact, dynamics: Dynamics) -> tuple[Array, Array]:
    """Evaluate J, (k, nv), and the required J v̇ at J v = 0, (k,), and check them.

    Raises:
        MethodError: as `evaluate`, with the name of the method that failed.
    """
    k = (contact.size,)
    try:
        J = checked(contact, "jacobian", contact.jacobian(dynamics), (*k, dynamics.model.nv))
        acceleration = checked(contact, "acceleration_at_rest", contact.acceleration_at_rest(dynamics), k)
    except Exception as error:
        evaluate(contact, dynamics)
        method = "acceleration_at_rest"
        raise error if isinstance(error, MethodError) else raised(contact, method, error) from error
    if not (is_finite(J) and is_finite(acceleration)):
        evaluate(contact, dynamics)
    return J, acceleration


def points_of(contact: Contact, dynamics: Dynamics) -> Array:
    """Corners of the support polygon in the world, (n, 3) in m, checked.

    Raises:
        MethodError: if `Contact.points` raises an exception, or returns another shape, or NaN.
    """
    points = call(contact, "points", dynamics)
    return checked(contact, "points", points, (np.shape(points)[0] if np.ndim(points) else 0, 3))


def anchor_of(contact: AnchoredContact, dynamics: Dynamics) -> Array:
    """The anchor of a contact activated at this state, (7,), checked and read-only.

    Raises:
        MethodError: if `AnchoredContact.anchor` raises an exception, or returns another shape, or NaN.
    """
    return frozen(array_from(contact, "anchor", (7,), dynamics))


class UnilateralContact(AnchoredContact):
    """A contact that can only push, with Coulomb friction.

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

        The same arrays are returned while the activation and the limits do not change.
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
