"""A link that is held: forces both ways, without a cone."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pinocchio as pin

from wbc_controller.core.contacts.contact import Contact
from wbc_controller.core.contacts.mount import Mount
from wbc_controller.core.dynamics import Dynamics
from wbc_controller.core.model import RobotModel
from wbc_controller.errors import ConfigurationError
from wbc_controller.records import Array


class FixedContact(Contact):
    """A bolted foot, or a hand that grips: along some axes of its frame it cannot move, and pulls as it pushes.

    f has one component for each axis of the contact frame that is held, forces first: along the others the link slides
    or turns, and nothing is transmitted.

    Attributes:
        max_force: largest force along each axis, N.
        max_moment: largest moment about each axis, N·m.
    """

    def __init__(
        self,
        name: str,
        model: RobotModel,
        frame: str,
        placement: pin.SE3,
        mask: Sequence[bool] = (True,) * 6,
        *,
        against: str | None = None,
        max_force: float = 1000.0,
        max_moment: float = 100.0,
        damping: float = 20.0,
    ) -> None:
        """Make a fixed contact.

        Args:
            name: the contact's name.
            model: the robot's model.
            frame: a frame of the URDF, fixed to the link that is held.
            placement: of the contact in that frame.
            mask: axes of the contact frame that are held: along x, y, z, about x, y, z.
            against: a frame of the URDF, fixed to the link that holds; None for the world.
            max_force: largest force along each axis, N.
            max_moment: largest moment about each axis, N·m.
            damping: D, 1/s.

        Raises:
            ConfigurationError: where the model has no such frame, or no axis is held.
        """
        self._rows = np.flatnonzero(mask)
        if not len(self._rows):
            raise ConfigurationError(f"contacts.{name}.mask = {list(mask)}: it holds no axis")
        k = len(self._rows)
        super().__init__(
            name, np.eye(6)[:, self._rows], np.zeros((0, k)), frame, damping=damping, internal=against is not None
        )
        self._mount = Mount(model, name, frame, placement, against)
        self.max_force = max_force
        self.max_moment = max_moment
        forces = k - int(self.moments.sum())
        groups = (("force", 0, forces), ("moment", forces, k))
        self.bound_groups = tuple(group for group in groups if group[1] < group[2])

    def placement(self, dynamics: Dynamics) -> pin.SE3:
        """Placement of the contact frame in the world."""
        return self._mount.placement(dynamics)

    def jacobian(self, dynamics: Dynamics) -> Array:
        """Jacobian of the contact frame along the axes that are held, (k, nv)."""
        return self._mount.jacobian(dynamics)[self._rows]

    def drift(self, dynamics: Dynamics) -> Array:
        """Spatial acceleration of the contact frame at v̇ = 0 along these axes, (k,)."""
        return self._mount.drift(dynamics)[self._rows]

    def points(self, dynamics: Dynamics) -> Array:
        """The contact frame's origin in the world, (1, 3) in m."""
        return np.array(self.placement(dynamics).translation)[None, :]

    def wrench_in_world(self, dynamics: Dynamics, force: Array) -> Array:
        """The wrench, moved from the contact frame to the world's origin, (6,) in N and N·m."""
        return np.asarray(self.placement(dynamics).act(pin.Force(self.basis @ force)).vector)

    def bounds(self, activation: float) -> tuple[Array, Array]:
        """Lower and upper bounds of f, both (k,): the activation scales all of them."""
        most = activation * np.where(self.moments, self.max_moment, self.max_force)
        return -most, most
