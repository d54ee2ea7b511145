"""Task on a relative pose."""

from typing import Any

import numpy as np
import pinocchio as pin

from wbc_controller.inverse_dynamics.robot.dynamics import Dynamics
from wbc_controller.inverse_dynamics.robot.model import RobotModel
from wbc_controller.inverse_dynamics.tasks.form import ReferenceForm
from wbc_controller.inverse_dynamics.tasks.frame import pose_error
from wbc_controller.inverse_dynamics.tasks.task import Mask, MotionTask
from wbc_controller.records import Array

_WORLD_AXES = pin.LOCAL_WORLD_ALIGNED


class RelativePoseTask(MotionTask):
    """Task on the pose of a frame B relative to a frame A of the robot, in the axes of A.

    With d = p_B - p_A and the rotation R_A of A, the pose is r = R_Aᵀ d in m and R = R_Aᵀ R_B. Seen from A,

        ṙ = R_Aᵀ (ḋ - ω_A × d)                                           m/s
        ω = R_Aᵀ (ω_B - ω_A)                                             rad/s
        r̈ = R_Aᵀ (d̈ - ω̇_A × d - 2 ω_A × ḋ + ω_A × (ω_A × d))             m/s²
        ω̇ = R_Aᵀ (ω̇_B - ω̇_A - ω_A × ω_B)                                rad/s²

    The task error is [r_ref - r, R log(Rᵀ R_ref)]. The reference is position and quaternion (x, y, z, w) of B in A,
    (7,), with velocity and acceleration (6,), linear part first.

    Source: Lewis and Maciejewski, IEEE International Conference on Systems Engineering, 1990.
    """

    unit = "m, rad"
    size = 6
    form = ReferenceForm(oriented=True)

    def __init__(
        self, name: str, model: RobotModel, frame: str, reference_frame: str, mask: Mask | None = None, **gains: Any
    ) -> None:
        super().__init__(name, [True] * 6 if mask is None else mask, **gains)
        self.frame = frame
        self.reference_frame = reference_frame
        self._b = model.frame_id(frame, f"tasks.{name}.frame")
        self._a = model.frame_id(reference_frame, f"tasks.{name}.reference_frame")

    def _pose(self, dynamics: Dynamics) -> pin.SE3:
        return dynamics.placement(self._a).actInv(dynamics.placement(self._b))

    def _axes_and_arm(self, dynamics: Dynamics) -> tuple[Array, Array]:
        a, b = dynamics.placement(self._a), dynamics.placement(self._b)
        return a.rotation.T, b.translation - a.translation

    def position(self, dynamics: Dynamics) -> Array:
        """Return position and quaternion of B in A, (7,)."""
        return np.asarray(pin.SE3ToXYZQUAT(self._pose(dynamics)))

    def error(self, dynamics: Dynamics, position: Array) -> Array:
        """Return displacement and rotation vector to the reference, (6,)."""
        return pose_error(self._pose(dynamics), position, self.form)

    def velocity(self, dynamics: Dynamics) -> Array:
        """Return ṙ and ω, (6,)."""
        to_a, d = self._axes_and_arm(dynamics)
        a, b = dynamics.velocity(self._a, _WORLD_AXES), dynamics.velocity(self._b, _WORLD_AXES)
        return np.concatenate([to_a @ (b[:3] - a[:3] - pin.skew(a[3:]) @ d), to_a @ (b[3:] - a[3:])])

    def jacobian(self, dynamics: Dynamics) -> Array:
        """Return the Jacobian of ṙ and ω, (6, nv)."""
        to_a, d = self._axes_and_arm(dynamics)
        a, b = dynamics.jacobian(self._a, _WORLD_AXES), dynamics.jacobian(self._b, _WORLD_AXES)
        difference = b - a
        difference[:3] += pin.skew(d) @ a[3:]  # -ω_A × d = d × ω_A
        return np.vstack([to_a @ difference[:3], to_a @ difference[3:]])

    def drift(self, dynamics: Dynamics) -> Array:
        """Return r̈ and ω̇ at v̇ = 0, (6,)."""
        to_a, d = self._axes_and_arm(dynamics)
        a, b = dynamics.velocity(self._a, _WORLD_AXES), dynamics.velocity(self._b, _WORLD_AXES)
        a_dot, b_dot = dynamics.drift_world(self._a), dynamics.drift_world(self._b)
        turn = pin.skew(a[3:])
        linear = b_dot[:3] - a_dot[:3] - pin.skew(a_dot[3:]) @ d - 2.0 * turn @ (b[:3] - a[:3]) + turn @ (turn @ d)
        return np.concatenate([to_a @ linear, to_a @ (b_dot[3:] - a_dot[3:] - turn @ b[3:])])
