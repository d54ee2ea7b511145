"""Joint position task."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from wbc_controller.inverse_dynamics.arrays import as_slice
from wbc_controller.inverse_dynamics.robot.dynamics import Dynamics
from wbc_controller.inverse_dynamics.robot.frame_kernels import JOINTS
from wbc_controller.inverse_dynamics.robot.instruction import Instruction
from wbc_controller.inverse_dynamics.robot.model import RobotModel
from wbc_controller.inverse_dynamics.tasks.task import MotionTask
from wbc_controller.records import Array


class PostureTask(MotionTask):
    """Task on joint positions, (k,) in rad."""

    unit = "rad"

    def __init__(self, name: str, model: RobotModel, joints: Sequence[str] = (), **gains: Any) -> None:
        """Make a task, by default for all actuated joints, with the gains of `MotionTask`.

        A passive joint moves only by the accelerations of the others.
        """
        columns = model.joint_columns(joints or model.driven_joints, f"tasks.{name}.joints")
        super().__init__(name, [True] * len(columns), **gains)
        self.size = len(columns)
        self.joints = tuple(joints) or model.driven_joints
        self._q_index = as_slice(model.q_index[columns])
        self.columns = as_slice(model.v_index[columns])
        self._places = np.concatenate([model.q_index[columns], model.v_index[columns]])
        self._jacobian = np.zeros((self.size, model.nv))
        self._jacobian[np.arange(self.size), model.v_index[columns]] = 1.0
        self._drift = np.zeros(self.size)

    def instruction(self) -> Instruction | None:
        """Return the instruction."""
        return Instruction(JOINTS, self._places, size=self.size) if type(self) is PostureTask else None

    def position(self, dynamics: Dynamics) -> Array:
        """Return the joint positions, (k,) in rad."""
        return dynamics.q[self._q_index]

    def velocity(self, dynamics: Dynamics) -> Array:
        """Return the joint velocities, (k,) in rad/s."""
        return dynamics.v[self.columns]

    def error(self, dynamics: Dynamics, position: Array) -> Array:
        """Return the displacement to the reference, (k,) in rad."""
        return position - self.position(dynamics)

    def jacobian(self, dynamics: Dynamics) -> Array:
        """Return the selection matrix, (k, nv)."""
        return self._jacobian

    def drift(self, dynamics: Dynamics) -> Array:
        """Return 0, (k,)."""
        return self._drift
