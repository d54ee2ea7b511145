"""Joint torque task."""

from collections.abc import Sequence

import numpy as np

from wbc_controller.errors import ConfigurationError, require_known
from wbc_controller.inverse_dynamics.robot.model import RobotModel
from wbc_controller.inverse_dynamics.tasks.task import Efforts, EffortTask
from wbc_controller.records import Array, Reference


class TorqueTask(EffortTask):
    """Task on joint torques, (k,) in N·m; a target of 0 minimizes them."""

    unit = "N·m"

    def __init__(self, name: str, model: RobotModel, joints: Sequence[str], target: Sequence[float]) -> None:
        """Make a task, by default for all actuated joints, with the target 0."""
        key = f"tasks.{name}.joints"
        columns = model.joint_columns(joints or model.driven_joints, key)
        require_known(joints, model.driven_joints, f"{key}: no actuator drives")
        if target and len(target) != len(columns):
            raise ConfigurationError(
                f"tasks.{name}.target has {len(target)} values; expected {len(columns)}, one per joint"
            )
        super().__init__(name, [True] * len(columns), np.array(target or np.zeros(len(columns)), dtype=np.float64))
        self.size = len(columns)
        self.joints = tuple(joints) or model.driven_joints
        self._ratios = model.actuation.ratios[:, columns].T  # (k, na)
        self._rows = model.actuation.motors_of(columns)

    def equation(self, efforts: Efforts, reference: Reference) -> tuple[Array, Array]:
        """Return the rows of the joint torques, (k, n), and their right-hand sides, (k,)."""
        rows, offset = efforts.torque_map
        if self._rows is not None:
            return rows[self._rows], reference.position - offset[self._rows]
        return self._ratios @ rows, reference.position - self._ratios @ offset
