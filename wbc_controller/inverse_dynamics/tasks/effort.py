"""Contact wrench and joint torque tasks."""

from collections.abc import Sequence

import numpy as np

from wbc_controller.errors import ConfigurationError, require_known
from wbc_controller.inverse_dynamics.contacts import Contact
from wbc_controller.inverse_dynamics.robot.model import RobotModel
from wbc_controller.inverse_dynamics.tasks.task import Efforts, EffortTask, Mask
from wbc_controller.records import Array, Reference

_AXES = ("x", "y", "z", "about x", "about y", "about z")


class ContactWrenchTask(EffortTask):
    """Task on a contact wrench, (6,) in N and N·m, in the axes of `Contact.basis`; no rows for an inactive contact."""

    unit = "N, N·m"
    size = 6

    def __init__(self, name: str, contact: Contact, mask: Mask, target: Sequence[float]) -> None:
        """Make a task with a default reference wrench, (6,) in N and N·m; the mask must select a transmitted axis."""
        super().__init__(name, mask, np.array(target, dtype=np.float64))
        borne = np.flatnonzero(contact.basis.any(axis=1))
        self.rows = np.intersect1d(self.rows, borne)
        if not len(self.rows):
            raise ConfigurationError(
                f"tasks.{name}.mask selects no force or moment of contact {contact.name!r}; valid: "
                f"{', '.join(_AXES[axis] for axis in borne)}"
            )
        self._basis = contact.basis[self.rows]
        self.contact = contact.name

    def equation(self, efforts: Efforts, reference: Reference) -> tuple[Array, Array] | None:
        """Return R (k, n) of the wrench, and the reference wrench (k,)."""
        force = efforts.force_map(self.contact)
        return None if force is None else (self._basis @ force, reference.position[self.rows])


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
        motors = model.actuation.motors
        self._motors = None if motors is None else np.array([motors.tolist().index(joint) for joint in columns])

    def equation(self, efforts: Efforts, reference: Reference) -> tuple[Array, Array]:
        """Return the rows of the joint torques, (k, n), and their right-hand sides, (k,)."""
        rows, offset = efforts.torque_map
        if self._motors is not None:
            return rows[self._motors], reference.position - offset[self._motors]
        return self._ratios @ rows, reference.position - self._ratios @ offset
