"""Base classes of contacts."""

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence

import numpy as np
import pinocchio as pin

from wbc_controller.errors import ConfigurationError
from wbc_controller.inverse_dynamics.method_calls import (
    array_from,
    bounds_from,
    call,
    checked,
    is_finite,
    raised,
    require_finite_result,
)
from wbc_controller.inverse_dynamics.robot.dynamics import Dynamics
from wbc_controller.inverse_dynamics.robot.instruction import Instruction
from wbc_controller.inverse_dynamics.tunable import Tunable
from wbc_controller.records import Array, frozen

_TANGENTIAL = (0, 1, 5)  # indices in f of the tangential forces and of the yaw moment of a unilateral contact


class Contact(Tunable, ABC):
    """Contact of a link with the environment or with another link.

    An active contact constrains motion by J v̇ + J̇v = -D J v (equation (30) of the note), and exerts the generalized
    force Jᵀf with bounds and the cone C f ≤ 0. Between two links, J v is relative, and Jᵀf acts on both.

    Settings override `enabled` and `ramp`. Constructors raise `ConfigurationError` for unknown frames, masks without
    held axis, and vectors of zero length.
    """

    permanent = False  # True if always active
    enabled: bool = True  # at activation
    ramp: float = 0.2  # duration of loading or unloading, s
    bound_groups: tuple[tuple[str, int, int], ...] = ()  # bounded parts of f: name, first component, end
    friction = 0.0  # Coulomb friction coefficient; 0 without a cone
    min_normal_force = -np.inf  # N; -inf if the contact can pull

    def __init__(
        self, name: str, basis: Array, cone: Array, wrench_frame: str, *, damping: float, internal: bool,
        stiffness: float = 0.0,
    ) -> None:  # fmt: skip
        self.name = name
        self.basis = basis  # orthonormal columns, (6, k): the published wrench [force, moment] is basis f
        self.wrench_frame = wrench_frame  # link with the contact frame of the wrench, or ``world``
        self.cone = cone  # friction or wrench cone C, (rows, k)
        self.damping = damping  # D of the contact velocity, 1/s
        self.stiffness = stiffness  # K of an `AnchoredContact`, 1/s²; 0 for no anchor
        self.internal = internal  # True between two links
        self.moments: np.ndarray = np.asarray(basis[3:].any(axis=0))  # components of f that are moments, (k,)
        self.size = basis.shape[1]  # k
        #: Diagonal of W in the regularization ½ ε_f fᵀ W f, (k,): 1 for forces, 1/ℓ² for moments, with ℓ the RMS lever
        #: of the sole's corners (1 m for a point).
        self.metric: Array = np.ones(self.size)

    @property
    def full_name(self) -> str:
        """Kind and name, for errors."""
        return f"contact {self.name!r}"

    def cone_for(self, friction: float, alone: bool) -> Array:
        """Return the cone for a share of the friction, 0 to 1, (rows, k); `alone`: the only contact with the world."""
        return self.cone

    @abstractmethod
    def jacobian(self, dynamics: Dynamics) -> Array:
        """Return J, (k, nv): J v is the contact velocity in the axes of f."""

    @abstractmethod
    def drift(self, dynamics: Dynamics) -> Array:
        """Return J̇v, (k,)."""

    @abstractmethod
    def points(self, dynamics: Dynamics) -> Array:
        """Return the corners of the support polygon in the world, (n, 3) in m."""

    @abstractmethod
    def wrench_in_world(self, dynamics: Dynamics, force: Array) -> Array:
        """Return f as a wrench about the world origin in world axes, (6,)."""

    @abstractmethod
    def bounds(self, activation: float) -> tuple[Array, Array]:
        """Return read-only bounds of f, (k,); the activation from 0 to 1 scales the largest forces."""

    def row_damping(self) -> Array:
        """Return D of each row of J, (k,) in 1/s."""
        return np.full(self.size, self.damping)

    def instruction(self) -> Instruction | None:
        """Return the instruction for compiled code; None to fill the rows in Python, and for subclasses."""
        return None

    def acceleration_at_rest(self, dynamics: Dynamics) -> Array:
        """Return the required J v̇ at J v = 0, (k,)."""
        return -checked(self, "drift", self.drift(dynamics), (self.size,))


class AnchoredContact(Contact):
    """Contact with position feedback to an anchor, its pose at activation.

    With the displacement e to the anchor,

        J v̇ + J̇v = -D J v + K e
    """

    @abstractmethod
    def pose(self, dynamics: Dynamics) -> pin.SE3:
        """Return contact position and link orientation, in the world or the touched link."""

    def anchor(self, dynamics: Dynamics) -> Array:
        """Return the anchor at this state, (7,): position and quaternion of the pose."""
        return frozen(pin.SE3ToXYZQUAT(self.pose(dynamics)))

    @abstractmethod
    def displacement(self, dynamics: Dynamics, anchor: Array) -> Array:
        """Return the displacement e to the anchor along the axes of f, (k,) in m and rad.

        To first order, J v = e returns to the anchor in one second; e is 0 along axes without a position.
        """


def evaluate(contact: Contact, dynamics: Dynamics) -> None:
    """Check the motion methods (`method_calls`)."""
    k, nv = (contact.size,), dynamics.model.nv
    array_from(contact, "jacobian", (*k, nv), dynamics)
    array_from(contact, "drift", k, dynamics)
    array_from(contact, "acceleration_at_rest", k, dynamics)


def contact_motion(contact: Contact, dynamics: Dynamics) -> tuple[Array, Array]:
    """Return J and `Contact.acceleration_at_rest`, checked (`method_calls`)."""
    k = (contact.size,)
    try:
        J = checked(contact, "jacobian", contact.jacobian(dynamics), (*k, dynamics.model.nv))
        acceleration = checked(contact, "acceleration_at_rest", contact.acceleration_at_rest(dynamics), k)
    except Exception as error:
        evaluate(contact, dynamics)
        raise raised(contact, "acceleration_at_rest", error) from error
    if not (is_finite(J) and is_finite(acceleration)):
        evaluate(contact, dynamics)
    return J, acceleration


def points_of(contact: Contact, dynamics: Dynamics) -> Array:
    """Return `Contact.points`, checked (`method_calls`)."""
    points = call(contact, "points", dynamics)
    return checked(contact, "points", points, (np.shape(points)[0] if np.ndim(points) else 0, 3))


def anchor_of(contact: AnchoredContact, dynamics: Dynamics) -> Array:
    """Return `AnchoredContact.anchor`, checked (`method_calls`) and read-only."""
    return frozen(array_from(contact, "anchor", (7,), dynamics))


def anchor_feedback(
    rows: int, anchored: Sequence[tuple[AnchoredContact, slice]], dynamics: Dynamics, anchors: Mapping[str, Array]
) -> Array:
    """Return K e, (nf,) in m/s² and rad/s²; raises `ConfigurationError` without an anchor.

    `rows` is nf; `anchored`: contacts with a stiffness, and their rows of J, with 0 for the others.
    """
    wanted = np.zeros(rows)
    for contact, own in anchored:
        anchor = anchors.get(contact.name)
        if anchor is None:
            raise ConfigurationError(
                f"contact {contact.name!r} has stiffness = {contact.stiffness:g} 1/s², but no anchor in the references "
                f"(anchors: {', '.join(anchors) or 'none'}); make one with `AnchoredContact.anchor`"
            )
        displacement = call(contact, "displacement", dynamics, anchor)
        displacement = checked(contact, "displacement", displacement, (contact.size,))
        if not is_finite(displacement) and is_finite(anchor):
            require_finite_result(contact, "displacement", displacement)
        wanted[own] = contact.stiffness * displacement
    return wanted


def needed_activation(contact: Contact, force: Array) -> float:
    """Return the smallest activation with bounds that admit a force, (k,)."""
    lower, upper = bounds_from(contact, "bounds", contact.size, 1.0)
    bound = np.where(force > 0.0, upper, -lower)
    bounded = (force != 0.0) & (bound > 0.0)
    return float(np.max(np.abs(force[bounded]) / bound[bounded], initial=0.0).clip(0.0, 1.0))


class UnilateralContact(AnchoredContact):
    """Contact that can only push, with Coulomb friction."""

    normal = 2  # index in f of the normal force

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
        self.max_normal_force = max_normal_force  # N
        self.max_yaw_moment = max_yaw_moment  # largest moment about the normal, N·m; inf for none
        self.bound_groups = (("normal_force", 2, 3),)
        if max_yaw_moment < np.inf:
            self.bound_groups += (("yaw_moment", 5, 6),)

    def bounds(self, activation: float) -> tuple[Array, Array]:
        """Return bounds of f."""
        lower, upper = np.full(self.size, -np.inf), np.full(self.size, np.inf)
        upper[2] = activation * self.max_normal_force
        lower[2] = min(self.min_normal_force, upper[2])
        if self.max_yaw_moment < np.inf:
            upper[5] = activation * self.max_yaw_moment
            lower[5] = -upper[5]
        return lower, upper

    def cone_for(self, friction: float, alone: bool) -> Array:
        """Return the cone for a share s of the friction, (rows, k).

        Forces with s times the friction are forces in C with tangential forces and yaw moment times s, as the corners
        of a sole are in its plane: C diag(1/s, 1/s, 1, 1, 1, 1/s), with rows multiplied by s.
        """
        if friction == 1.0:
            return self.cone
        tangential = np.isin(np.arange(self.size), _TANGENTIAL)
        rows = self.cone[:, tangential].any(axis=1)
        cone = np.array(self.cone)
        cone[np.ix_(rows, ~tangential)] *= friction
        return cone
