"""Contacts of a ball or point, and of a rolling wheel."""

from typing import Any

import numpy as np
import pinocchio as pin

from wbc_controller.errors import ConfigurationError
from wbc_controller.inverse_dynamics.contacts.contact import UnilateralContact
from wbc_controller.inverse_dynamics.contacts.mount import support_link
from wbc_controller.inverse_dynamics.contacts.support import friction_pyramid
from wbc_controller.inverse_dynamics.robot.dynamics import Dynamics
from wbc_controller.inverse_dynamics.robot.frame_kernels import BALL
from wbc_controller.inverse_dynamics.robot.instruction import Instruction, placement_on_link
from wbc_controller.inverse_dynamics.robot.model import RobotModel
from wbc_controller.records import Array

_WORLD_AXES = pin.LOCAL_WORLD_ALIGNED
UP = (0.0, 0.0, 1.0)
_UPRIGHT = 1.0e-6  # smallest projection of the normal onto a wheel's plane


def unit(key: str, vector: Array) -> Array:
    """Return the unit vector along a vector, (3,), of non-zero length."""
    length = float(np.linalg.norm(vector))
    if not length > 1.0e-9:
        raise ConfigurationError(f"{key} = {np.asarray(vector).tolist()}: the length must not be 0")
    return np.asarray(vector, dtype=np.float64) / length


def axes_with_normal(normal: Array) -> Array:
    """Return axes (3, 3) as columns: the world axes after the smallest rotation of z to a unit normal."""
    x, y, z = normal
    if z < -1.0 + 1.0e-9:
        return np.diag([1.0, -1.0, -1.0])
    return np.array([[1.0 - x * x / (1.0 + z), -x * y / (1.0 + z), x],
                     [-x * y / (1.0 + z), 1.0 - y * y / (1.0 + z), y],
                     [-x, -y, z]])  # fmt: skip


class PointContact(UnilateralContact):
    """Ball that rolls on a plane without slipping.

    The lowest point has zero velocity. With the centre p, the plane's unit normal n and r = -radius n,

        Eᵀ(ṗ + ω × r) = 0,    on a link B    Eᵀ(ṗ + ω × r - ṗ_B - ω_B × (p + r - p_B)) = 0.

    The columns of E are the axes of the force: two in the plane, then n; world axes for n along z.
    """

    ball = True  # the lowest point is independent of the link's orientation

    def __init__(
        self,
        name: str,
        model: RobotModel,
        frame: str,
        translation: Array,  # centre of the ball in that frame, (3,) in m
        radius: float,  # m
        *,
        normal: Array | tuple[float, ...] = UP,  # outward normal of the plane, (3,); in the world, or in `against`
        against: str | None = None,  # frame of the touched link; None for the world
        friction: float = 0.7,
        **limits: float,
    ) -> None:
        """Make a point contact; `limits` are other keywords of `UnilateralContact`."""
        self._axes = axes_with_normal(unit(f"contacts.{name}.normal", np.asarray(normal)))
        basis, cone = np.vstack([self._axes, np.zeros((3, 3))]), friction_pyramid(friction)
        internal = against is not None
        super().__init__(name, basis, cone, against or "world", internal=internal, friction=friction, **limits)
        self._frame_id = model.frame_id(frame, f"contacts.{name}.frame")
        self._other = support_link(model, name, frame, against)
        self._in_world_axes = self._other is None and bool(self._axes[2, 2] == 1.0)
        self._translation = np.array(translation, dtype=np.float64)
        self.radius = radius
        #: r of a ball on the world.
        self._constant_arm = -radius * self._axes[:, 2] if self._other is None and self.ball else None
        self._on_link = placement_on_link(model, self._frame_id)

    def axes(self, dynamics: Dynamics) -> Array:
        """Return E, (3, 3)."""
        if self._other is None:
            return self._axes
        return np.asarray(dynamics.placement(self._other).rotation @ self._axes)

    def arm(self, dynamics: Dynamics, normal: Array) -> Array:
        """Return r in world axes, (3,) in m."""
        return -self.radius * normal

    def arm_rate(self, dynamics: Dynamics, normal: Array, normal_rate: Array) -> Array:
        """Return ṙ, (3,) in m/s."""
        return -self.radius * normal_rate

    def _arms(self, dynamics: Dynamics) -> tuple[Array, Array]:
        """Return the vectors from frame origin to centre and to contact point from there, world axes, m."""
        centre, arm = dynamics.placement(self._frame_id).rotation @ self._translation, self._constant_arm
        return centre, self.arm(dynamics, self.axes(dynamics)[:, 2]) if arm is None else arm

    def instruction(self) -> Instruction | None:
        """Return the instruction, for a ball on the world."""
        if type(self) is not PointContact or self._constant_arm is None:
            return None
        link, placement = self._on_link
        constants = np.concatenate([placement.act(self._translation), self._constant_arm, self._axes.T.ravel()])
        return Instruction(BALL, np.arange(3), link, constants=constants)

    def jacobian(self, dynamics: Dynamics) -> Array:
        """Return J of the contact point's relative velocity along E, (3, nv)."""
        centre, arm = self._arms(dynamics)
        J = dynamics.jacobian(self._frame_id, _WORLD_AXES)
        J_point = J[:3] - pin.skew(centre + arm) @ J[3:]
        if self._other is not None:
            other = dynamics.jacobian(self._other, _WORLD_AXES)
            J_point -= other[:3] - pin.skew(self._from_other(dynamics, self._other, centre + arm)) @ other[3:]
        return np.asarray(J_point) if self._in_world_axes else np.asarray(self.axes(dynamics).T @ J_point)

    def _from_other(self, dynamics: Dynamics, other: int, arm: Array) -> Array:
        here, there = dynamics.placement(self._frame_id), dynamics.placement(other)
        return np.asarray(here.translation + arm - there.translation)

    def drift(self, dynamics: Dynamics) -> Array:
        """Return d/dt of the contact point's velocity at v̇ = 0 along E, (3,) in m/s²."""
        centre, arm = self._arms(dynamics)
        drift = dynamics.drift_world(self._frame_id)
        velocity = dynamics.velocity(self._frame_id, _WORLD_AXES)
        turning = pin.skew(velocity[3:]) @ centre
        result = drift[:3] + pin.skew(drift[3:]) @ (centre + arm) + pin.skew(velocity[3:]) @ turning
        if self._constant_arm is None:
            result += self._drift_of_support(dynamics, velocity, centre, arm)
        return np.asarray(result) if self._in_world_axes else np.asarray(self.axes(dynamics).T @ result)

    def _drift_of_support(self, dynamics: Dynamics, velocity: Array, centre: Array, arm: Array) -> Array:
        """Return the drift of a moving arm r and a moving plane in world axes, (3,)."""
        spin, normal = pin.skew(velocity[3:]), self.axes(dynamics)[:, 2]
        if self._other is None:
            return np.asarray(spin @ self.arm_rate(dynamics, normal, np.zeros(3)))
        other, drift = dynamics.velocity(self._other, _WORLD_AXES), dynamics.drift_world(self._other)
        turn = pin.skew(other[3:])
        rate = self.arm_rate(dynamics, normal, turn @ normal)
        from_other = self._from_other(dynamics, self._other, centre + arm)
        moving = velocity[:3] + spin @ centre + rate - other[:3]  # of the contact point relative to the origin of B
        slip = velocity[:3] + spin @ (centre + arm) - other[:3] - turn @ from_other  # the axes rotate with B
        return np.asarray(spin @ rate - drift[:3] - pin.skew(drift[3:]) @ from_other - turn @ (moving + slip))

    def points(self, dynamics: Dynamics) -> Array:
        """Return the contact point, (1, 3) in m."""
        centre, arm = self._arms(dynamics)
        return np.asarray(dynamics.placement(self._frame_id).translation + centre + arm)[None, :]

    def pose(self, dynamics: Dynamics) -> pin.SE3:
        """Return contact point and link orientation, in the world or the touched link."""
        here = pin.SE3(dynamics.placement(self._frame_id).rotation, self.points(dynamics)[0])
        return here if self._other is None else dynamics.placement(self._other).actInv(here)

    def displacement(self, dynamics: Dynamics, anchor: Array) -> Array:
        """Return e = Eᵀ(p_a + radius θ × n - p), (3,) in m: the displacement beyond rolling.

        p is the contact point, p_a its anchor, θ the link's rotation vector since activation; errors are of second
        order in θ.
        """
        present, made = self.pose(dynamics), pin.XYZQUATToSE3(anchor)
        turn = pin.log3(present.rotation @ made.rotation.T)
        rolled = made.translation + self.radius * (pin.skew(turn) @ self._axes[:, 2])
        return np.asarray(self._axes.T @ (rolled - present.translation))

    def wrench_in_world(self, dynamics: Dynamics, force: Array) -> Array:
        """Return the wrench, (6,)."""
        along = self.axes(dynamics) @ force
        return np.concatenate([along, pin.skew(self.points(dynamics)[0]) @ along])


class RollingContact(PointContact):
    """Thin wheel that rolls on a plane without slipping forwards or sideways.

    With the axle a, a unit vector fixed to the link,

        r = -radius u / ‖u‖,    u = n - (n · a) a
        ṙ = -radius (u̇ - u (u · u̇) / ‖u‖²) / ‖u‖,    u̇ = ṅ - (ṅ · a + n · ȧ) a - (n · a) ȧ,    ȧ = ω × a

    The constraint equals `wbc_controller.mechanics.Rolling`, in other axes.
    """

    ball = False

    def __init__(
        self, name: str, model: RobotModel, frame: str, translation: Array, radius: float, axis: Array, **options: Any
    ) -> None:
        """Make a `PointContact`, with its options and the axle `axis` in the frame, (3,)."""
        super().__init__(name, model, frame, translation, radius, **options)
        self._axle = unit(f"contacts.{name}.axis", axis)

    def _upward(self, dynamics: Dynamics, normal: Array) -> tuple[Array, Array, float]:
        axle = np.asarray(dynamics.placement(self._frame_id).rotation @ self._axle)
        up = normal - (normal @ axle) * axle
        return axle, up, max(_UPRIGHT, float(np.linalg.norm(up)))

    def displacement(self, dynamics: Dynamics, anchor: Array) -> Array:
        """Return e, (3,) in m: displacement along n, 0 along the plane."""
        height = self._axes[:, 2] @ (anchor[:3] - self.pose(dynamics).translation)
        return np.array([0.0, 0.0, height])

    def arm(self, dynamics: Dynamics, normal: Array) -> Array:
        """Return r in world axes, (3,) in m."""
        _, up, length = self._upward(dynamics, normal)
        return -self.radius / length * up

    def arm_rate(self, dynamics: Dynamics, normal: Array, normal_rate: Array) -> Array:
        """Return ṙ, (3,) in m/s."""
        axle, up, length = self._upward(dynamics, normal)
        turning = pin.skew(dynamics.velocity(self._frame_id, pin.LOCAL_WORLD_ALIGNED)[3:]) @ axle
        rate = normal_rate - (normal_rate @ axle + normal @ turning) * axle - (normal @ axle) * turning
        return np.asarray(-self.radius / length * (rate - up * (up @ rate) / length**2))
