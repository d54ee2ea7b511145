"""URDF frames on MuJoCo's bodies."""

from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np
import pinocchio as pin

from wbc_controller.inverse_dynamics.arrays import cross
from wbc_controller.records import Array


@dataclass(frozen=True, slots=True)
class BodyFrame:
    """URDF frame on a MuJoCo body."""

    id: int  # of the body
    placement: pin.SE3  # on the body

    def in_world(self, data: Any) -> pin.SE3:
        """Return the placement in the world."""
        return pin.SE3(data.xmat[self.id].reshape(3, 3), data.xpos[self.id]) * self.placement

    def motion(self, model: Any, data: Any) -> tuple[Array, Array]:
        """Return angular velocity, rad/s, and velocity of the origin, m/s, in world axes, (3,) each."""
        motion = np.zeros(6)
        mujoco.mj_objectVelocity(model, data, mujoco.mjtObj.mjOBJ_XBODY, self.id, motion, 0)
        arm = self.in_world(data).translation - data.xpos[self.id]
        return motion[:3], motion[3:] + cross(motion[:3], arm)

    def specific_force(self, model: Any, data: Any) -> Array:
        """Return the acceleration of the origin minus gravity in world axes, (3,) in m/s²."""
        acceleration = np.zeros(6)
        mujoco.mj_rnePostConstraint(model, data)
        mujoco.mj_objectAcceleration(model, data, mujoco.mjtObj.mjOBJ_XBODY, self.id, acceleration, 0)
        arm, (turning, _) = self.in_world(data).translation - data.xpos[self.id], self.motion(model, data)
        # MuJoCo accelerates the world upwards instead of gravity: its acceleration is the specific force.
        return np.array(acceleration[3:] + cross(acceleration[:3], arm) + cross(turning, cross(turning, arm)))
