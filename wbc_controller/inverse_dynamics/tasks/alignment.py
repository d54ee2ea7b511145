"""Tasks that point an axis."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import pinocchio as pin

from wbc_controller.inverse_dynamics.contacts.point import unit
from wbc_controller.inverse_dynamics.robot.dynamics import Dynamics
from wbc_controller.inverse_dynamics.robot.model import RobotModel
from wbc_controller.inverse_dynamics.tasks.form import ReferenceForm
from wbc_controller.inverse_dynamics.tasks.task import MotionTask
from wbc_controller.records import Array, Reference

_TINY = 1.0e-9  # smallest distance of a target with a direction, m; smallest sin θ of a target beside the axis
_GAZE_DISTANCE = 1.0  # by default, m


class _AlignmentTask(MotionTask):
    """Base of both tasks: turn the axis n towards d = r / ‖r‖, with r the vector to the target, here a direction.

    The spin about n is free. The two rows are along axes b₁, b₂ fixed in the frame and perpendicular to its axis a: b₁
    is the frame axis farthest from a, made perpendicular to it, and b₂ = a × b₁. With the frame's orientation R and
    angular velocity ω, n = R a and T = [b₁ b₂]ᵀ Rᵀ,

        ẋ = T ω             ẍ = T ω̇                                       rad/s, rad/s²
        e = T θ (n × d) / ‖n × d‖,   θ the angle between n and d           rad
        ẋ_ref = T ω_d,   ω_d = r × ṙ / ‖r‖²                                rad/s
        ẍ_ref = T (ω̇_d + (n·ω) ṅ)                                         rad/s²

    The last term compensates the spin. If d is opposite to n, the frame turns about b₁.

    Source: angle-axis error as in Siciliano et al., Robotics, 2009, section 3.7.3.
    """

    unit = "rad"
    size = 2

    def __init__(self, name: str, model: RobotModel, frame: str, axis: Sequence[float], **gains: Any) -> None:
        """Make a task for an axis a, (3,) in the frame, with gains of `MotionTask` for b₁ and b₂."""
        super().__init__(name, [True, True], **gains)
        self.frame = frame
        self._frame_id = model.frame_id(frame, f"tasks.{name}.frame")
        self._axis = unit(f"tasks.{name}.axis", np.asarray(axis))
        side = np.eye(3)[np.argmin(np.abs(self._axis))]
        b1 = side - self._axis * (self._axis @ side)
        b1 /= np.linalg.norm(b1)
        self._sides = np.stack([b1, np.cross(self._axis, b1)])  # (2, 3), in the frame

    def direction(self, dynamics: Dynamics) -> Array:
        """Return the axis direction n in the world, a unit vector (3,)."""
        return np.asarray(dynamics.placement(self._frame_id).rotation @ self._axis)

    def position(self, dynamics: Dynamics) -> Array:
        return self.direction(dynamics)

    def error(self, dynamics: Dynamics, position: Array) -> Array:
        """Return the rotation from the axis to r, (2,) in rad."""
        target = dynamics.placement(self._frame_id).rotation.T @ position  # in the frame
        distance = math.sqrt(target @ target)
        if distance <= _TINY:
            return np.zeros(2)
        turn = self._sides @ np.cross(self._axis, target / distance)  # n × d has no component along n
        sine, cosine = math.hypot(*turn), self._axis @ target / distance
        if sine <= _TINY:
            return turn if cosine > 0.0 else np.array([math.pi, 0.0])
        return np.asarray(turn * (math.atan2(sine, cosine) / sine))

    def _rate_reference(self, dynamics: Dynamics, position: Array, r: Array, r_dot: Array, r_ddot: Array) -> Reference:
        square = float(r @ r)
        if square <= _TINY**2:
            return Reference(position, np.zeros(2), np.zeros(2))
        to_sides = self._sides @ dynamics.placement(self._frame_id).rotation.T
        rate = np.cross(r, r_dot) / square
        rate_dot = np.cross(r, r_ddot) / square - (2.0 * (r @ r_dot) / square) * rate
        omega = dynamics.velocity(self._frame_id, pin.LOCAL)[3:]
        spinning = (self._axis @ omega) * (self._sides @ np.cross(omega, self._axis))
        return Reference(position, to_sides @ rate, to_sides @ rate_dot + spinning)

    def equation(self, dynamics: Dynamics, reference: Reference) -> tuple[Array, Array, Array]:
        r, r_dot, r_ddot = reference.position, reference.velocity, reference.acceleration
        return super().equation(dynamics, self._rate_reference(dynamics, r, r, r_dot, r_ddot))

    def velocity(self, dynamics: Dynamics) -> Array:
        return np.asarray(self._sides @ dynamics.velocity(self._frame_id, pin.LOCAL)[3:])

    def jacobian(self, dynamics: Dynamics) -> Array:
        return np.asarray(self._sides @ dynamics.jacobian(self._frame_id, pin.LOCAL)[3:])

    def drift(self, dynamics: Dynamics) -> Array:
        return np.asarray(self._sides @ dynamics.drift_local(self._frame_id)[3:])


class AxisAlignmentTask(_AlignmentTask):
    """Task that points an axis fixed in a frame in a direction of the world: two rows, rad.

    The reference is a direction r, (3,), of non-zero length, with ṙ and r̈ for a unit vector. Between directions, at
    most 180° apart, it moves along their chord. Control law: `_AlignmentTask`.
    """

    form = ReferenceForm(direction=True)


class GazeTask(_AlignmentTask):
    """Task that points an axis through a frame's origin o at a point p of the world: two rows, rad.

    The reference is p, (3,) in m. Control law: `_AlignmentTask` with r = p - o and the acceleration J_o v̇ + J̇_o v of
    the origin:

        (T J_ω + T [r]× J_o / ‖r‖²) v̇ = ẍ_ref(v̇ = 0) + D (ẋ_ref - ẋ) + K e - T ω̇(v̇ = 0)

    Error and feed-forward are 0 for a point nearer than 1 nm.
    """

    form = ReferenceForm()

    def position(self, dynamics: Dynamics) -> Array:
        """Return the point on the axis 1 m ahead of the origin, (3,) in m."""
        return np.asarray(dynamics.placement(self._frame_id).translation + _GAZE_DISTANCE * self.direction(dynamics))

    def error(self, dynamics: Dynamics, position: Array) -> Array:
        """Return the rotation from the axis to a point, (2,) in rad."""
        return super().error(dynamics, position - dynamics.placement(self._frame_id).translation)

    def equation(self, dynamics: Dynamics, reference: Reference) -> tuple[Array, Array, Array]:
        """Return the rows for a point."""
        axes = pin.LOCAL_WORLD_ALIGNED
        placement = dynamics.placement(self._frame_id)
        r = reference.position - placement.translation
        r_dot = reference.velocity - dynamics.velocity(self._frame_id, axes)[:3]
        r_ddot = reference.acceleration - dynamics.drift_world(self._frame_id)[:3]
        turning = self._rate_reference(dynamics, reference.position, r, r_dot, r_ddot)
        J, right, error = MotionTask.equation(self, dynamics, turning)
        square = float(r @ r)
        if square > _TINY**2:
            to_sides = self._sides @ placement.rotation.T
            J += (to_sides @ pin.skew(r) / square) @ dynamics.jacobian(self._frame_id, axes)[:3]
        return J, right, error
