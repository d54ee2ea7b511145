"""General constraints A(q, v, t) v̇ = b (equation (30); S7).

Contacts, couplings of joints, closed loops, rolling without slipping, moving supports.

A constraint keeps a quantity at zero: a position g(q, t) (holonomic), or a velocity γ(q, v, t) that is not the rate of
any position (non-holonomic). There is one class per kind; the base class computes A and b for all of them.

A constraint on accelerations does not correct position errors, so that numerical errors drift. Baumgarte
("Stabilization of constraints and integrals of motion in dynamical systems", 1972) adds a spring and damper: with the
time constant T, errors decay as g̈ + (2/T) ġ + g/T² = 0 (critically damped) and γ̇ + γ/T = 0.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any

import numpy as np
import pinocchio as pin

from wbc_controller.errors import ConfigurationError
from wbc_controller.mechanics.checks import as_array, frame_index, single_joint
from wbc_controller.records import Array


def _cross(a: Array, b: Array) -> Array:
    """Cross product a × b; much faster than `numpy.cross` for one pair."""
    return np.asarray(pin.skew(a) @ b)


@dataclass(frozen=True)
class Motion:
    """Placement and motion of a rigid support at one instant.

    Attributes:
        placement: support in the world.
        twist: velocity of the support, in its own axes, (6,) in m/s and rad/s.
        acceleration: time derivative of the twist, (6,).
    """

    placement: pin.SE3
    twist: Array = field(default_factory=lambda: np.zeros(6))
    acceleration: Array = field(default_factory=lambda: np.zeros(6))


#: A support's motion as a function of time in s.
Support = Callable[[float], Motion]


def ground(t: float) -> Motion:
    """The world as the support of a constraint (30) at any time t, s: it does not move."""
    return Motion(pin.SE3.Identity())


def oscillating_support(direction: Array, amplitude: float, angular_frequency: float) -> Support:
    """A support that shakes along a direction, x = amplitude · sin(ω t), so that (30) depends on time.

    Args:
        direction: unit vector in the world, (3,); or unit twist (6,), whose angular part rotates the support.
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
    """Positions, velocities and drifts at one state, computed once for all constraints (the q, v, t of (30)).

    A drift is the value of an acceleration at v̇ = 0, the J̇v of the note.

    Attributes:
        model: the mechanism.
        q: configuration, (nq,).
        v: generalized velocity, (nv,).
        t: time, s.
    """

    def __init__(self, model: pin.Model, q: Array, v: Array, t: float = 0.0, *, data: pin.Data | None = None) -> None:
        self.model, self.q, self.v, self.t = model, q, v, t
        self._data = data if data is not None else model.createData()
        pin.forwardKinematics(model, self._data, q, v, np.zeros(model.nv))
        pin.computeJointJacobians(model, self._data)
        pin.updateFramePlacements(model, self._data)

    def placement(self, frame: str) -> pin.SE3:
        """Placement of a frame in the world."""
        return self._data.oMf[frame_index(self.model, frame)]

    def point(self, frame: str, offset: Array) -> tuple[Array, Array, Array, Array]:
        """Motion of a point fixed to a link, at `offset` (3,) in m in its frame, in world axes.

        Returns:
            Position (3,), velocity (3,), Jacobian (3, nv), drift (3,).
        """
        index = frame_index(self.model, frame)
        axes = pin.LOCAL_WORLD_ALIGNED
        placement: Any = self._data.oMf[index]
        arm = placement.rotation @ offset
        J = pin.getFrameJacobian(self.model, self._data, index, axes)
        twist = J @ self.v
        drift = pin.getFrameClassicalAcceleration(self.model, self._data, index, axes).vector
        return (
            placement.translation + arm,
            twist[:3] + _cross(twist[3:], arm),
            J[:3] - pin.skew(arm) @ J[3:],
            drift[:3] + _cross(drift[3:], arm) + _cross(twist[3:], _cross(twist[3:], arm)),
        )

    def angular(self, frame: str) -> tuple[Array, Array, Array]:
        """Rotation of a link, in world axes: angular velocity (3,), its Jacobian (3, nv), its drift (3,)."""
        index = frame_index(self.model, frame)
        axes = pin.LOCAL_WORLD_ALIGNED
        J = pin.getFrameJacobian(self.model, self._data, index, axes)[3:]
        drift = pin.getFrameAcceleration(self.model, self._data, index, axes).angular
        return J @ self.v, J, np.array(drift)

    def body(self, frame: str, offset: pin.SE3) -> tuple[pin.SE3, Array, Array, Array]:
        """Motion of a frame fixed to a link, at the placement `offset` in its frame, in its own axes.

        Returns:
            Placement in the world, twist (6,), Jacobian (6, nv), drift of the twist (6,).
        """
        index = frame_index(self.model, frame)
        change = offset.inverse().action
        J = change @ pin.getFrameJacobian(self.model, self._data, index, pin.LOCAL)
        drift = change @ pin.getFrameAcceleration(self.model, self._data, index, pin.LOCAL).vector
        return self._data.oMf[index] * offset, J @ self.v, J, drift


@dataclass(frozen=True, slots=True)
class ConstraintTerms:
    """A constraint at one state.

    Attributes:
        jacobian: A, (k, nv).
        drift: d/dt(velocity) at v̇ = 0, (k,); the constraint's acceleration is A v̇ plus the drift.
        velocity: ġ or γ, (k,); zero if the velocity satisfies the constraint.
        position: g, (k,); zero if the position satisfies the constraint, and in non-holonomic rows.
        holonomic: whether each row has a position, (k,).
    """

    jacobian: Array
    drift: Array
    velocity: Array
    position: Array
    holonomic: np.ndarray


@dataclass(frozen=True, kw_only=True)
class Constraint(ABC):
    """One constraint of the form (30).

    Attributes:
        time_constant: T of Baumgarte's stabilization, s; infinite for none. It should be several integration steps.

    Raises:
        ConfigurationError: where the time constant is not positive.
    """

    time_constant: float = math.inf

    def __post_init__(self) -> None:
        if not self.time_constant > 0.0:
            raise ConfigurationError(f"time_constant = {self.time_constant} s; it must be positive (infinite: none)")

    @abstractmethod
    def terms(self, kinematics: Kinematics) -> ConstraintTerms:
        """Evaluate the constraint at one state.

        Raises:
            ConfigurationError: where the model has no such frame or joint.
        """

    def equation(self, kinematics: Kinematics) -> tuple[Array, Array]:
        """A, (k, nv), and b, (k,), of equation (30): b = -drift less the stabilization.

        Raises:
            ConfigurationError: where the model has no such frame or joint.
        """
        terms = self.terms(kinematics)
        return terms.jacobian, self.right_side(terms)

    def right_side(self, terms: ConstraintTerms) -> Array:
        """The right-hand side b, (k,): -drift less the stabilization, which removes errors with the time constant."""
        rate = 1.0 / self.time_constant
        damping = np.where(terms.holonomic, 2.0 * rate, rate)
        return np.asarray(-terms.drift - damping * terms.velocity - rate**2 * terms.position)


def _holonomic(jacobian: Array, drift: Array, velocity: Array, position: Array) -> ConstraintTerms:
    return ConstraintTerms(jacobian, drift, velocity, position, np.ones(len(position), dtype=bool))


@dataclass(frozen=True, kw_only=True)
class PointContact(Constraint):
    """A point of a link held at a point of a support (three rows, world axes; (30), holonomic).

    λ is the force of the support on the link, in N, world axes.

    Attributes:
        frame: frame of the link.
        offset: the point in that frame, (3,) in m.
        target: the point in the support's frame, (3,) in m.
        support: motion of the support.
    """

    frame: str
    offset: Array = field(default_factory=lambda: np.zeros(3))
    target: Array = field(default_factory=lambda: np.zeros(3))
    support: Support = ground

    def terms(self, kinematics: Kinematics) -> ConstraintTerms:
        """The motion of the point relative to the support."""
        position, velocity, jacobian, drift = kinematics.point(self.frame, self.offset)
        motion = self.support(kinematics.t)
        R, target = motion.placement.rotation, np.asarray(self.target)
        linear, angular = motion.twist[:3], motion.twist[3:]
        speed = linear + _cross(angular, target)
        # The support's twist is in its own axes, which rotate.
        change = motion.acceleration[:3] + _cross(motion.acceleration[3:], target) + _cross(angular, speed)
        return _holonomic(jacobian, drift - R @ change, velocity - R @ speed, position - motion.placement.act(target))


@dataclass(frozen=True, kw_only=True)
class SurfaceContact(Constraint):
    """A frame of a link that neither translates nor rotates relative to a support (six rows; (30), holonomic).

    Rows and λ are in the axes of the contact frame: λ is the wrench of the support on the link about its origin.

    Attributes:
        frame: frame of the link.
        placement: contact frame in that frame.
        target: placement at which the contact frame is held, in the support's frame.
        support: motion of the support.
    """

    frame: str
    placement: pin.SE3 = field(default_factory=pin.SE3.Identity)
    target: pin.SE3 = field(default_factory=pin.SE3.Identity)
    support: Support = ground

    def terms(self, kinematics: Kinematics) -> ConstraintTerms:
        """The motion of the contact frame relative to the support."""
        body = kinematics.body(self.frame, self.placement)
        motion = self.support(kinematics.t)
        to_target = self.target.inverse().action
        n = kinematics.model.nv
        other = (
            motion.placement * self.target,
            to_target @ motion.twist,
            np.zeros((6, n)),
            to_target @ motion.acceleration,
        )
        return _weld(body, other)


_Body = tuple[pin.SE3, Array, Array, Array]


def _weld(first: _Body, second: _Body) -> ConstraintTerms:
    """Relative motion of two frames, in the axes of the first."""
    between = second[0].inverse() * first[0]
    change = between.inverse().action
    carried = change @ second[1]
    relative = first[1] - carried
    # The axes rotate with the first frame: d/dt of the change is -(relative ×) change.
    turning = np.array(pin.Motion(relative).cross(pin.Motion(carried)).vector)
    drift = first[3] - change @ second[3] + turning
    # ġ equals the relative twist only to first order in the error g; that is enough for the stabilization.
    return _holonomic(first[2] - change @ second[2], drift, relative, np.array(pin.log6(between).vector))


@dataclass(frozen=True, kw_only=True)
class JointCoupling(Constraint):
    """A gear or tendon between joints, Σ cᵢ qᵢ = offset (one row; (30), holonomic).

    λ is in N·m or N per unit of c.

    Attributes:
        coefficients: cᵢ by joint; each joint with one degree of freedom.
        offset: right-hand side, in the units of c q.
    """

    coefficients: Mapping[str, float]
    offset: float = 0.0

    def __post_init__(self) -> None:
        Constraint.__post_init__(self)
        object.__setattr__(self, "coefficients", MappingProxyType(dict(self.coefficients)))

    def terms(self, kinematics: Kinematics) -> ConstraintTerms:
        """The weighted sum of the joints."""
        jacobian = np.zeros((1, kinematics.model.nv))
        position = -self.offset
        for name, coefficient in self.coefficients.items():
            joint = single_joint(kinematics.model, name)
            jacobian[0, joint.idx_v] += coefficient
            position += coefficient * kinematics.q[joint.idx_q]
        return _holonomic(jacobian, np.zeros(1), jacobian @ kinematics.v, np.array([position]))


@dataclass(frozen=True, kw_only=True)
class PinnedFrames(Constraint):
    """Two points of two links held together, such as a ball joint that closes a loop (three rows, world axes; (30)).

    λ is the force of the second link on the first, in N, world axes; the opposite force acts on the second.

    Attributes:
        first: frame of the first link.
        second: frame of the second link.
        first_offset: the point in the first frame, (3,) in m.
        second_offset: the point in the second frame, (3,) in m.
    """

    first: str
    second: str
    first_offset: Array = field(default_factory=lambda: np.zeros(3))
    second_offset: Array = field(default_factory=lambda: np.zeros(3))

    def terms(self, kinematics: Kinematics) -> ConstraintTerms:
        """The motion of the first point relative to the second."""
        a = kinematics.point(self.first, self.first_offset)
        b = kinematics.point(self.second, self.second_offset)
        return _holonomic(a[2] - b[2], a[3] - b[3], a[1] - b[1], a[0] - b[0])


@dataclass(frozen=True, kw_only=True)
class WeldedFrames(Constraint):
    """Two frames of two links held together, position and orientation (six rows; (30), holonomic).

    Rows and λ are in the axes of the first; λ is the wrench of the second link on the first about its origin.

    Attributes:
        first: frame of the first link.
        second: frame of the second link.
        first_placement: the welded frame in the first frame.
        second_placement: the welded frame in the second frame.
    """

    first: str
    second: str
    first_placement: pin.SE3 = field(default_factory=pin.SE3.Identity)
    second_placement: pin.SE3 = field(default_factory=pin.SE3.Identity)

    def terms(self, kinematics: Kinematics) -> ConstraintTerms:
        """The relative motion of the two frames."""
        return _weld(
            kinematics.body(self.first, self.first_placement), kinematics.body(self.second, self.second_placement)
        )


def _unit(name: str, vector: Array) -> Array:
    values = as_array(name, vector, (3,))
    length = float(np.linalg.norm(values))
    if not length > 1.0e-9:
        raise ConfigurationError(f"{name} = {values.tolist()}; it must have a length")
    return np.asarray(values / length)


@dataclass(frozen=True, kw_only=True)
class Rolling(Constraint):
    """A ball or wheel that rolls on a plane without slipping (three rows, world axes; (30)).

    The contact point of the link has no velocity, ṗ + ω × r = 0, where r leads from the centre to the contact point.
    Along the plane this is non-holonomic: no function of q stays constant. Along the normal it is holonomic and keeps
    the height. λ is the force of the plane on the link, in N.

    Rows are rotated so that the last is along the normal, and the first two span the plane.

    Attributes:
        frame: frame of the link.
        radius: m.
        centre: of the ball or wheel, in that frame, (3,) in m.
        axis: the wheel's axle in that frame, (3,); None for a ball.
        normal: of the plane, in the world, (3,), pointing to the side of the wheel.
        height: of the plane along its normal, m.
    """

    frame: str
    radius: float
    centre: Array = field(default_factory=lambda: np.zeros(3))
    axis: Array | None = None
    normal: Array = field(default_factory=lambda: np.array([0.0, 0.0, 1.0]))
    height: float = 0.0

    def terms(self, kinematics: Kinematics) -> ConstraintTerms:
        """The velocity of the contact point, and its height.

        Raises:
            ConfigurationError: where the normal or the axis is zero, or the wheel lies flat on the plane.
        """
        normal = _unit("normal", self.normal)
        position, velocity, jacobian, drift = kinematics.point(self.frame, self.centre)
        omega, J_omega, omega_drift = kinematics.angular(self.frame)
        arm, arm_rate = self._arm(normal, kinematics.placement(self.frame).rotation, omega)
        axes = _axes_with_normal(normal)
        height = float(normal @ (position + arm)) - self.height
        return ConstraintTerms(
            jacobian=axes @ (jacobian - pin.skew(arm) @ J_omega),
            drift=axes @ (drift + _cross(omega_drift, arm) + _cross(omega, arm_rate)),
            velocity=axes @ (velocity + _cross(omega, arm)),
            position=np.array([0.0, 0.0, height]),
            holonomic=np.array([False, False, True]),
        )

    def _arm(self, normal: Array, R: Array, omega: Array) -> tuple[Array, Array]:
        """From the centre to the lowest point, and its rate of change, in world axes; both (3,)."""
        if self.axis is None:
            return -self.radius * normal, np.zeros(3)
        axle = R @ _unit("axis", self.axis)
        turning = _cross(omega, axle)
        # The lowest point of a disc lies along the projection of the normal onto the plane of the disc.
        up = normal - (normal @ axle) * axle
        length = float(np.linalg.norm(up))
        if not length > 1.0e-6:
            raise ConfigurationError(f"the wheel {self.frame!r} lies flat on its plane: no single point touches")
        up_rate = -(normal @ turning) * axle - (normal @ axle) * turning
        unit = up / length
        return -self.radius * unit, -self.radius * (up_rate - unit * (unit @ up_rate)) / length


def _axes_with_normal(normal: Array) -> Array:
    """Two directions in the plane and its normal, as rows, (3, 3); the world axes for a horizontal plane."""
    if normal[2] > 1.0 - 1.0e-12:
        return np.eye(3)
    first = _cross(normal, np.eye(3)[int(np.argmin(np.abs(normal)))])
    first /= np.linalg.norm(first)
    return np.vstack([first, _cross(normal, first), normal])


@dataclass(frozen=True, kw_only=True)
class PlaneContact(Constraint):
    """A point of a link on a frictionless plane (one row; (30), holonomic).

    Meant for the unilateral form, in which the plane can only push: λ ≥ 0 is the normal force, in N.

    Attributes:
        frame: frame of the link.
        offset: the point in that frame, (3,) in m.
        normal: of the plane, in the world, (3,), pointing away from it.
        height: of the plane along its normal, m.
    """

    frame: str
    offset: Array = field(default_factory=lambda: np.zeros(3))
    normal: Array = field(default_factory=lambda: np.array([0.0, 0.0, 1.0]))
    height: float = 0.0

    def terms(self, kinematics: Kinematics) -> ConstraintTerms:
        """The point's height above the plane.

        Raises:
            ConfigurationError: where the normal is zero.
        """
        normal = _unit("normal", self.normal)
        position, velocity, jacobian, drift = kinematics.point(self.frame, self.offset)
        return _holonomic(
            (normal @ jacobian)[None, :],
            np.array([normal @ drift]),
            np.array([normal @ velocity]),
            np.array([normal @ position - self.height]),
        )


@dataclass(frozen=True, slots=True)
class ConstraintEquation:
    """Several constraints stacked to one equation (30).

    Attributes:
        A: (k, nv).
        b: (k,).
        position: g of all constraints, (k,).
        velocity: ġ and γ of all constraints, (k,).
        rows: rows of each constraint, in order.
    """

    A: Array
    b: Array
    position: Array
    velocity: Array
    rows: tuple[slice, ...]


def constraint_equation(constraints: Sequence[Constraint], kinematics: Kinematics) -> ConstraintEquation:
    """Stack constraints, which may be redundant, to one equation A v̇ = b (30), (k, nv) and (k,) in m/s² and rad/s².

    Args:
        kinematics: the state, with nv velocities.

    Raises:
        ConfigurationError: if the model has no such frame or joint.
    """
    A, b = [np.zeros((0, kinematics.model.nv))], [np.zeros(0)]
    position, velocity, rows, start = [np.zeros(0)], [np.zeros(0)], [], 0
    for constraint in constraints:
        terms = constraint.terms(kinematics)
        A.append(terms.jacobian)
        b.append(constraint.right_side(terms))
        position.append(terms.position)
        velocity.append(terms.velocity)
        rows.append(slice(start, start + len(terms.drift)))
        start += len(terms.drift)
    return ConstraintEquation(
        np.vstack(A), np.concatenate(b), np.concatenate(position), np.concatenate(velocity), tuple(rows)
    )
