"""Contact of a rolling wheel."""

from typing import Any

import numpy as np
import pinocchio as pin

from wbc_controller.inverse_dynamics.contacts.point import PointContact, unit
from wbc_controller.inverse_dynamics.robot.dynamics import Dynamics
from wbc_controller.inverse_dynamics.robot.model import RobotModel
from wbc_controller.records import Array

_UPRIGHT = 1.0e-6  # smallest projection of the normal onto the wheel's plane


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
