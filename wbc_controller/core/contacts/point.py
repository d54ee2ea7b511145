"""A ball or point in contact: three forces."""

from __future__ import annotations

import math

import numpy as np
import pinocchio as pin

from wbc_controller.core.contacts.contact import Contact
from wbc_controller.core.dynamics import Dynamics
from wbc_controller.core.model import RobotModel
from wbc_controller.records import Array


def friction_pyramid(friction: float) -> Array:
    """Four-sided pyramid inside the friction cone.

    Args:
        friction: Coulomb friction coefficient.

    Returns:
        C, (4, 3), so that C f ≤ 0 implies √(fx² + fy²) ≤ friction fz.
    """
    mu = friction / math.sqrt(2.0)
    return np.array([[1.0, 0.0, -mu], [-1.0, 0.0, -mu], [0.0, 1.0, -mu], [0.0, -1.0, -mu]])


class PointContact(Contact):
    """A ball that rolls on the ground without slipping; the force is in world axes, normal along world z.

    The ball's lowest point has no velocity: with its centre at p and r = -radius z, ṗ + ω × r = 0.
    """

    size = 3

    def __init__(
        self,
        name: str,
        model: RobotModel,
        frame: str,
        translation: Array,
        radius: float,
        *,
        friction: float = 0.7,
        min_normal_force: float = 0.0,
        max_normal_force: float = 1000.0,
        damping: float = 20.0,
    ) -> None:
        """Make a point contact.

        Args:
            name: the contact's name.
            model: the robot's model.
            frame: a frame of the URDF, fixed to the link that touches.
            translation: centre of the ball in that frame, (3,) in m.
            radius: of the ball, m.
            friction: Coulomb friction coefficient.
            min_normal_force: smallest normal force, N.
            max_normal_force: largest normal force, N.
            damping: D, 1/s.

        Raises:
            ConfigurationError: where the model has no such frame.
        """
        super().__init__(
            name,
            friction_pyramid(friction),
            friction=friction,
            min_normal_force=min_normal_force,
            max_normal_force=max_normal_force,
            damping=damping,
        )
        self._frame_id = model.frame_id(frame, f"contacts.{name}.frame")
        self._translation = np.array(translation)
        self._down = np.array([0.0, 0.0, -radius])

    def _arm(self, dynamics: Dynamics) -> Array:
        """From the frame's origin to the lowest point, in world axes, (3,) in m."""
        return np.asarray(dynamics.placement(self._frame_id).rotation @ self._translation + self._down)

    def jacobian(self, dynamics: Dynamics) -> Array:
        """Jacobian of the lowest point in world axes, (3, nv)."""
        J = dynamics.jacobian(self._frame_id, pin.LOCAL_WORLD_ALIGNED)
        return np.asarray(J[:3] - pin.skew(self._arm(dynamics)) @ J[3:])

    def drift(self, dynamics: Dynamics) -> Array:
        """Acceleration of the centre at v̇ = 0, plus that of the rolling, in world axes, (3,) in m/s²."""
        drift = dynamics.drift_world(self._frame_id)
        arm = self._arm(dynamics)
        # The part of the arm that is fixed to the link turns with it; the part that points down does not.
        spin = pin.skew(dynamics.velocity(self._frame_id, pin.LOCAL_WORLD_ALIGNED)[3:])
        return np.asarray(drift[:3] + pin.skew(drift[3:]) @ arm + spin @ spin @ (arm - self._down))

    def points(self, dynamics: Dynamics) -> Array:
        """The lowest point in the world, (1, 3) in m."""
        return np.asarray(dynamics.placement(self._frame_id).translation + self._arm(dynamics))[None, :]

    def wrench_in_world(self, dynamics: Dynamics, force: Array) -> Array:
        """The force at the lowest point, moved to the world's origin, (6,) in N and N·m."""
        return np.concatenate([force, pin.skew(self.points(dynamics)[0]) @ force])
