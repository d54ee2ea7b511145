"""Constraints A(q, v, t) v̇ = b (equation (30); S7).

A constraint keeps a position g(q, t) (holonomic) or a velocity γ(q, v, t) (non-holonomic) at zero. Baumgarte
("Stabilization of constraints and integrals of motion in dynamical systems", 1972): with the time constant T, errors
decay as g̈ + (2/T) ġ + g/T² = 0 and γ̇ + γ/T = 0.
"""

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from wbc_controller.errors import ConfigurationError
from wbc_controller.mechanics.checks import as_array, frame_index, single_joint
from wbc_controller.records import Array


class BodyMotion(NamedTuple):
    """Motion of a frame on a link or support."""

    placement: pin.SE3  # in the world
    twist: Array  # in its own axes, (6,) in m/s and rad/s
    jacobian: Array  # of the twist, (6, nv)
    drift: Array  # time derivative of the twist at v̇ = 0, (6,)

    def point(self) -> tuple[Array, Array, Array, Array]:
        """Return position (3,), velocity (3,), Jacobian (3, nv), drift (3,) of the origin, world axes."""
        R, linear, angular = self.placement.rotation, self.twist[:3], self.twist[3:]
        drift = self.drift[:3] + np.cross(angular, linear)  # the axes of the twist rotate
        return self.placement.translation, R @ linear, R @ self.jacobian[:3], R @ drift


@dataclass(frozen=True)
class Motion:
    """Motion of a rigid support at one instant."""

    placement: pin.SE3  # support in the world
    twist: Array = field(default_factory=lambda: np.zeros(6))  # velocity in its own axes, (6,) in m/s and rad/s
    acceleration: Array = field(default_factory=lambda: np.zeros(6))  # time derivative of the twist, (6,)

    def body(self, target: pin.SE3, nv: int) -> BodyMotion:
        """Return the motion of a frame fixed to the support."""
        change = target.inverse().action
        return BodyMotion(self.placement * target, change @ self.twist, np.zeros((6, nv)), change @ self.acceleration)


Support = Callable[[float], Motion]  # motion of a support as a function of time in s


def ground(t: float) -> Motion:
    """Return the motion of the world as support of (30) at t, s: at rest."""
    return Motion(pin.SE3.Identity())


def oscillating_support(direction: Array, amplitude: float, angular_frequency: float) -> Support:
    """Return a support of (30) that moves by amplitude · sin(ω t).

    Args:
        direction: unit vector, (3,), or unit twist, (6,), in the world.
        amplitude: m, or rad.
        angular_frequency: ω, rad/s.
    """
    screw = np.zeros(6)
    screw[: len(direction)] = direction

    def motion(t: float) -> Motion:
        phase = angular_frequency * t
        speed = amplitude * angular_frequency
        return Motion(
            pin.exp6(amplitude * math.sin(phase) * screw),
            speed * math.cos(phase) * screw,
            -speed * angular_frequency * math.sin(phase) * screw,
        )

    return motion


class Kinematics:
    """Positions, velocities and drifts J̇v at one state q, v, t of (30), shared by constraints."""

    def __init__(self, model: pin.Model, q: Array, v: Array, t: float = 0.0, *, data: pin.Data | None = None) -> None:
        self.model, self.q, self.v, self.t = model, q, v, t
        self._data = data or model.createData()
        pin.forwardKinematics(model, self._data, q, v, np.zeros(model.nv))
        pin.computeJointJacobians(model, self._data)
        pin.updateFramePlacements(model, self._data)

    def placement(self, frame: str) -> pin.SE3:
        """Return the placement of a frame in the world."""
        return self._data.oMf[frame_index(self.model, frame)]

    def point(self, frame: str, offset: Array) -> tuple[Array, Array, Array, Array]:
        """Return position (3,), velocity (3,), Jacobian (3, nv), drift (3,) of a point on a link, world axes."""
        return self.body(frame, _translation(offset)).point()

    def body(self, frame: str, offset: pin.SE3) -> BodyMotion:
        """Return the motion of a frame on a link."""
        index = frame_index(self.model, frame)
        change = offset.inverse().action
        J = change @ pin.getFrameJacobian(self.model, self._data, index, pin.LOCAL)
        drift = change @ pin.getFrameAcceleration(self.model, self._data, index, pin.LOCAL).vector
        return BodyMotion(self._data.oMf[index] * offset, J @ self.v, J, drift)


def _translation(offset: Array) -> pin.SE3:
    return pin.SE3(np.eye(3), np.asarray(offset, dtype=np.float64))


@dataclass(frozen=True, slots=True)
class ConstraintTerms:
    """Constraint at one state."""

    jacobian: Array  # A, (k, nv)
    drift: Array  # acceleration at v̇ = 0, (k,)
    velocity: Array  # ġ or γ, (k,)
    position: Array  # g, (k,); zero in non-holonomic rows
    holonomic: np.ndarray  # True for holonomic rows, (k,)


@dataclass(frozen=True, kw_only=True)
class Constraint(ABC):
    """Constraint of the form (30).

    Raises:
        ConfigurationError: if the time constant is not positive.
    """

    time_constant: float = math.inf  # T of Baumgarte's stabilization, s, several integration steps; infinite for none

    def __post_init__(self) -> None:
        if not self.time_constant > 0.0:
            raise ConfigurationError(f"time_constant = {self.time_constant} s: must be positive (infinite for none)")

    @abstractmethod
    def terms(self, kinematics: Kinematics) -> ConstraintTerms:
        """Evaluate the constraint at one state."""

    def right_side(self, terms: ConstraintTerms) -> Array:
        """Return b, (k,): -drift minus Baumgarte's stabilization."""
        rate = 1.0 / self.time_constant
        damping = np.where(terms.holonomic, 2.0 * rate, rate)
        return np.asarray(-terms.drift - damping * terms.velocity - rate**2 * terms.position)


def _holonomic(jacobian: Array, drift: Array, velocity: Array, position: Array) -> ConstraintTerms:
    return ConstraintTerms(jacobian, drift, velocity, position, np.ones(len(position), dtype=bool))


def _relative(first: tuple[Array, ...], second: tuple[Array, ...]) -> ConstraintTerms:
    """Return the motion of a point relative to another one, from `BodyMotion.point`."""
    position, velocity, jacobian, drift = (a - b for a, b in zip(first, second, strict=True))
    return _holonomic(jacobian, drift, velocity, position)


@dataclass(frozen=True, kw_only=True)
class PointContact(Constraint):
    """Point of a link fixed to a point of a support (three rows, world axes; (30), holonomic); λ is the force, N."""

    frame: str  # frame of the link
    offset: Array = field(default_factory=lambda: np.zeros(3))  # point in this frame, (3,) in m
    target: Array = field(default_factory=lambda: np.zeros(3))  # point in the support's frame, (3,) in m
    support: Support = ground  # motion of the support

    def terms(self, kinematics: Kinematics) -> ConstraintTerms:
        """Return the motion of the point relative to the support."""
        support = self.support(kinematics.t).body(_translation(self.target), kinematics.model.nv)
        return _relative(kinematics.point(self.frame, self.offset), support.point())


@dataclass(frozen=True, kw_only=True)
class SurfaceContact(Constraint):
    """Frame of a link fixed to a support (six rows, axes of the contact frame; (30), holonomic); λ is the wrench."""

    frame: str  # frame of the link
    placement: pin.SE3 = field(default_factory=pin.SE3.Identity)  # contact frame in this frame
    target: pin.SE3 = field(default_factory=pin.SE3.Identity)  # contact frame in the support's frame
    support: Support = ground  # motion of the support

    def terms(self, kinematics: Kinematics) -> ConstraintTerms:
        """Return the motion of the contact frame relative to the support."""
        support = self.support(kinematics.t).body(self.target, kinematics.model.nv)
        return _weld(kinematics.body(self.frame, self.placement), support)


def _weld(first: BodyMotion, second: BodyMotion) -> ConstraintTerms:
    """Return the motion of the first frame relative to the second, in axes of the first."""
    between = second.placement.actInv(first.placement)
    change = between.inverse().action
    carried = change @ second.twist
    relative = first.twist - carried
    # The axes rotate: d/dt change = -(relative ×) change.
    turning = np.array(pin.Motion(relative).cross(pin.Motion(carried)).vector)
    drift = first.drift - change @ second.drift + turning
    # ġ is the relative twist to first order in g, sufficient for the stabilization.
    return _holonomic(first.jacobian - change @ second.jacobian, drift, relative, np.array(pin.log6(between).vector))


@dataclass(frozen=True, kw_only=True)
class JointCoupling(Constraint):
    """Gear or tendon between joints, Σ cᵢ qᵢ = offset (one row; (30), holonomic)."""

    coefficients: Mapping[str, float]  # cᵢ by joint, each with one degree of freedom
    offset: float = 0.0  # right-hand side

    def __post_init__(self) -> None:
        Constraint.__post_init__(self)
        object.__setattr__(self, "coefficients", MappingProxyType(dict(self.coefficients)))

    def terms(self, kinematics: Kinematics) -> ConstraintTerms:
        """Return the weighted sum of the joints."""
        jacobian = np.zeros((1, kinematics.model.nv))
        position = -self.offset
        for name, coefficient in self.coefficients.items():
            joint = single_joint(kinematics.model, name)
            jacobian[0, joint.idx_v] += coefficient
            position += coefficient * kinematics.q[joint.idx_q]
        return _holonomic(jacobian, np.zeros(1), jacobian @ kinematics.v, np.array([position]))


@dataclass(frozen=True, kw_only=True)
class PinnedFrames(Constraint):
    """Two coincident points of two links (three rows, world axes; (30)); λ is the force on the first link, N."""

    first: str  # frame of the first link
    second: str  # frame of the second link
    first_offset: Array = field(default_factory=lambda: np.zeros(3))  # point in the first frame, (3,) in m
    second_offset: Array = field(default_factory=lambda: np.zeros(3))  # point in the second frame, (3,) in m

    def terms(self, kinematics: Kinematics) -> ConstraintTerms:
        """Return the motion of the first point relative to the second."""
        first = kinematics.point(self.first, self.first_offset)
        return _relative(first, kinematics.point(self.second, self.second_offset))


@dataclass(frozen=True, kw_only=True)
class WeldedFrames(Constraint):
    """Two coincident frames of two links (six rows, axes of the first; (30), holonomic); λ: wrench on the first."""

    first: str  # frame of the first link
    second: str  # frame of the second link
    first_placement: pin.SE3 = field(default_factory=pin.SE3.Identity)  # welded frame in the first frame
    second_placement: pin.SE3 = field(default_factory=pin.SE3.Identity)  # welded frame in the second frame

    def terms(self, kinematics: Kinematics) -> ConstraintTerms:
        """Return the relative motion of the two frames."""
        first = kinematics.body(self.first, self.first_placement)
        return _weld(first, kinematics.body(self.second, self.second_placement))


def _unit(name: str, vector: Array) -> Array:
    values = as_array(name, vector, (3,))
    length = float(np.linalg.norm(values))
    if not length > 1.0e-9:
        raise ConfigurationError(f"{name} = {values.tolist()}: must not be zero")
    return np.asarray(values / length)


@dataclass(frozen=True, kw_only=True)
class Rolling(Constraint):
    """Ball or wheel rolling on a plane without slip, ṗ + ω × r = 0 with r from centre to contact point (30).

    Two non-holonomic rows along the plane, one holonomic row along the normal; λ is the force on the link, N.
    """

    frame: str  # frame of the link
    radius: float  # m
    centre: Array = field(default_factory=lambda: np.zeros(3))  # centre in this frame, (3,) in m
    axis: Array | None = None  # axle in this frame, (3,); None for a ball
    #: normal of the plane in the world, (3,), towards the wheel
    normal: Array = field(default_factory=lambda: np.array([0.0, 0.0, 1.0]))
    height: float = 0.0  # height of the plane along its normal, m

    def terms(self, kinematics: Kinematics) -> ConstraintTerms:
        """Return velocity and height of the contact point.

        Raises:
            ConfigurationError: if normal or axis is zero, or the wheel lies flat on the plane.
        """
        normal = _unit("normal", self.normal)
        body = kinematics.body(self.frame, _translation(self.centre))
        R = body.placement.rotation
        position, velocity, jacobian, drift = body.point()
        omega, J_omega, omega_drift = R @ body.twist[3:], R @ body.jacobian[3:], R @ body.drift[3:]
        arm, arm_rate = self._arm(normal, R, omega)
        axes = _axes_with_normal(normal)
        height = float(normal @ (position + arm)) - self.height
        return ConstraintTerms(
            jacobian=axes @ (jacobian - pin.skew(arm) @ J_omega),
            drift=axes @ (drift + np.cross(omega_drift, arm) + np.cross(omega, arm_rate)),
            velocity=axes @ (velocity + np.cross(omega, arm)),
            position=np.array([0.0, 0.0, height]),
            holonomic=np.array([False, False, True]),
        )

    def _arm(self, normal: Array, R: Array, omega: Array) -> tuple[Array, Array]:
        """Return the vector from the centre to the lowest point and its rate, (3,), world axes."""
        if self.axis is None:
            return -self.radius * normal, np.zeros(3)
        axle = R @ _unit("axis", self.axis)
        turning = np.cross(omega, axle)
        # The lowest point is along the normal projected onto the disc.
        up = normal - (normal @ axle) * axle
        length = float(np.linalg.norm(up))
        if not length > 1.0e-6:
            raise ConfigurationError(f"wheel {self.frame!r} lies flat on the plane: no unique contact point")
        up_rate = -(normal @ turning) * axle - (normal @ axle) * turning
        unit = up / length
        return -self.radius * unit, -self.radius * (up_rate - unit * (unit @ up_rate)) / length


def _axes_with_normal(normal: Array) -> Array:
    """Return two directions in the plane and its normal as rows, (3, 3)."""
    if normal[2] > 1.0 - 1.0e-12:
        return np.eye(3)
    first = np.cross(normal, np.eye(3)[int(np.argmin(np.abs(normal)))])
    first /= np.linalg.norm(first)
    return np.vstack([first, np.cross(normal, first), normal])


@dataclass(frozen=True, kw_only=True)
class PlaneContact(Constraint):
    """Point of a link on a frictionless plane, also unilateral (one row; (30), holonomic); λ is the normal force, N."""

    frame: str  # frame of the link
    offset: Array = field(default_factory=lambda: np.zeros(3))  # point in this frame, (3,) in m
    #: outward normal of the plane in the world, (3,)
    normal: Array = field(default_factory=lambda: np.array([0.0, 0.0, 1.0]))
    height: float = 0.0  # height of the plane along its normal, m

    def terms(self, kinematics: Kinematics) -> ConstraintTerms:
        """Return the height above the plane.

        Raises:
            ConfigurationError: if the normal is zero.
        """
        n = _unit("normal", self.normal)[None]  # (1, 3)
        position, velocity, jacobian, drift = kinematics.point(self.frame, self.offset)
        return _holonomic(n @ jacobian, n @ drift, n @ velocity, n @ position - self.height)


@dataclass(frozen=True, slots=True)
class ConstraintEquation:
    """Stacked constraints (30)."""

    A: Array  # (k, nv)
    b: Array  # (k,)
    position: Array  # g, (k,)
    velocity: Array  # ġ and γ, (k,)
    rows: tuple[slice, ...]  # rows of each constraint


def constraint_equation(constraints: Sequence[Constraint], kinematics: Kinematics) -> ConstraintEquation:
    """Return stacked constraints A v̇ = b (30), (k, nv) and (k,) in m/s² and rad/s²."""
    terms = [constraint.terms(kinematics) for constraint in constraints]
    b = [constraint.right_side(own) for constraint, own in zip(constraints, terms, strict=True)]
    ends = np.cumsum([0, *(len(own.drift) for own in terms)]).tolist()
    return ConstraintEquation(
        A=np.vstack([np.zeros((0, kinematics.model.nv)), *(own.jacobian for own in terms)]),
        b=np.concatenate([np.zeros(0), *b]),
        position=np.concatenate([np.zeros(0), *(own.position for own in terms)]),
        velocity=np.concatenate([np.zeros(0), *(own.velocity for own in terms)]),
        rows=tuple(map(slice, ends[:-1], ends[1:])),
    )
