"""Contact of a rectangle or polygon."""

import math

import numpy as np
import pinocchio as pin

from wbc_controller.inverse_dynamics.contacts.contact import UnilateralContact
from wbc_controller.inverse_dynamics.contacts.mount import Mount, MountedContact, pose_displacement
from wbc_controller.inverse_dynamics.contacts.support import Support
from wbc_controller.inverse_dynamics.robot.dynamics import Dynamics
from wbc_controller.inverse_dynamics.robot.instruction import Instruction
from wbc_controller.inverse_dynamics.robot.model import RobotModel
from wbc_controller.records import Array

#: Share of the yaw moment of corner forces of a single sole; evenly loaded, it exerts 0.54 (square) to 0.71 (narrow).
_YAW_SHARE = 0.5
_ROTATION = 2.5  # factor of the damping of rotations without an anchor: a sole on an edge tips slower


class SurfaceContact(MountedContact, UnilateralContact):
    """Flat sole without translation and rotation; the wrench [f, τ] is in the contact frame, with z the normal."""

    _rows = np.arange(6)

    def __init__(
        self,
        name: str,
        model: RobotModel,
        frame: str,
        placement: pin.SE3,
        support: Support,
        *,
        against: str | None = None,
        friction: float = 0.7,
        **limits: float,
    ) -> None:
        """Make a surface contact with the shape `support`; other arguments as `PointContact`.

        The z axis of `placement`, of the contact in the frame, points away from the touched surface.
        """
        cone, internal = support.cone(friction / math.sqrt(2.0)), against is not None
        super().__init__(name, np.eye(6), cone, frame, internal=internal, friction=friction, **limits)
        self._mount = Mount(model, name, frame, placement, against)
        self._corners = np.column_stack([support.vertices, np.zeros(len(support.vertices))])
        # For n corners of a rectangle, fᵀ W f / n is the least sum of squares of equivalent corner forces. A narrow
        # sole transfers load to the other foot before its centre of pressure reaches the edge.
        x, y = np.mean(support.vertices**2, axis=0)
        self.metric = 1.0 / np.array([1.0, 1.0, 1.0, y, x, x + y])

    def cone_for(self, friction: float, alone: bool) -> Array:
        """Return the cone for a share of the friction; if `alone`, with rows for half of the yaw moment added."""
        cone = super().cone_for(friction, alone)
        if not alone:
            return cone
        return np.vstack([cone, cone[cone[:, 5] != 0.0] / np.array([1.0, 1.0, 1.0, 1.0, 1.0, _YAW_SHARE])])

    def displacement(self, dynamics: Dynamics, anchor: Array) -> Array:
        """Return e, (6,)."""
        return pose_displacement(self.pose(dynamics).actInv(pin.XYZQUATToSE3(anchor)))

    def instruction(self) -> Instruction | None:
        """Return the instruction."""
        return self._mount.instruction(self._rows) if type(self) is SurfaceContact else None

    def row_damping(self) -> Array:
        """Return D of each row of J, (6,) in 1/s."""
        factor = _ROTATION if self.stiffness == 0.0 else 1.0
        return np.where(self.moments, factor * self.damping, self.damping)

    def points(self, dynamics: Dynamics) -> Array:
        """Return the corners of the support, (n, 3) in m."""
        placement = self.placement(dynamics)
        return np.asarray(self._corners @ placement.rotation.T + placement.translation)
