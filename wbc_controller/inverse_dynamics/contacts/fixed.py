"""Contact with bilateral forces."""

from collections.abc import Sequence

import numpy as np
import pinocchio as pin

from wbc_controller.errors import ConfigurationError
from wbc_controller.inverse_dynamics.contacts.mount import Mount, MountedContact, held_axes, pose_displacement
from wbc_controller.inverse_dynamics.robot.dynamics import Dynamics
from wbc_controller.inverse_dynamics.robot.instruction import Instruction
from wbc_controller.inverse_dynamics.robot.model import RobotModel
from wbc_controller.records import Array

_AXES = ("along x", "along y", "along z", "about x", "about y", "about z")


class FixedContact(MountedContact):
    """Bolted foot or gripping hand: some axes of its frame are held, with forces in both directions.

    f has one component per held axis of the contact frame, forces first.
    """

    def __init__(
        self,
        name: str,
        model: RobotModel,
        frame: str,
        placement: pin.SE3,  # of the contact in the frame
        mask: Sequence[bool] = (True,) * 6,  # held axes of the contact frame: along x, y, z, about x, y, z
        *,
        against: str | None = None,  # frame of the holding link; None for the world
        max_force: float = 1000.0,  # along each axis, N
        max_moment: float = 100.0,  # about each axis, N·m
        damping: float = 20.0,
        stiffness: float = 0.0,  # K, 1/s², for holonomic masks only (see `_nonholonomic_axes`)
    ) -> None:
        self._rows, self._hinge = held_axes(mask, f"contacts.{name}.mask")
        reached = _nonholonomic_axes(self._rows)
        if stiffness > 0.0 and reached:
            raise ConfigurationError(
                f"contacts.{name}.stiffness = {stiffness:g}: with mask = {[bool(held) for held in mask]}, motions "
                f"along the free axes can displace the link {' and '.join(reached)}, so the anchor position is "
                "undefined; set stiffness to 0, or change the mask"
            )
        k = len(self._rows)
        basis, internal = np.eye(6)[:, self._rows], against is not None
        super().__init__(name, basis, np.zeros((0, k)), frame, stiffness=stiffness, damping=damping, internal=internal)
        self._held = np.array(mask[:3], dtype=np.float64)
        self._mount = Mount(model, name, frame, placement, against)
        self.max_force = max_force
        self.max_moment = max_moment
        forces = k - int(self.moments.sum())
        groups = (("force", 0, forces), ("moment", forces, k))
        self.bound_groups = tuple(group for group in groups if group[1] < group[2])

    def displacement(self, dynamics: Dynamics, anchor: Array) -> Array:
        """Return e along the held axes of the contact frame, (k,)."""
        there = self.pose(dynamics).actInv(pin.XYZQUATToSE3(anchor))  # the anchor in the contact frame
        # Remove sliding along the axes that were free at activation, e.g. a rail.
        Q = there.rotation
        there.translation = Q @ (self._held * (Q.T @ there.translation))
        return pose_displacement(there, self._hinge)[self._rows]

    def instruction(self) -> Instruction | None:
        """Return the instruction."""
        return self._mount.instruction(self._rows) if type(self) is FixedContact else None

    def points(self, dynamics: Dynamics) -> Array:
        """Return the contact frame's origin in the world, (1, 3) in m."""
        return np.array(self.placement(dynamics).translation)[None, :]

    def bounds(self, activation: float) -> tuple[Array, Array]:
        """Return bounds of f, (k,)."""
        most = activation * np.where(self.moments, self.max_moment, self.max_force)
        return -most, most


def _nonholonomic_axes(held: np.ndarray) -> list[str]:
    """Name the held axes along which sequences of motions along free axes can displace the link.

    None if the twists along the free axes form a Lie algebra; otherwise the constraint is nonholonomic (Murray, Li and
    Sastry, 1994, section 7.2).
    """
    free = [pin.Motion(axis) for i, axis in enumerate(np.eye(6)) if i not in held]
    brackets = np.array([a.cross(b).vector for a in free for b in free]).reshape(-1, 6)
    return [_AXES[i] for i in held if brackets[:, i].any()]
