"""Contact that holds a link: bilateral forces, without a cone."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pinocchio as pin

from wbc_controller.errors import ConfigurationError
from wbc_controller.inverse_dynamics.contacts.contact import AnchoredContact
from wbc_controller.inverse_dynamics.contacts.mount import Mount, hinge_of, opening
from wbc_controller.inverse_dynamics.robot.dynamics import Dynamics
from wbc_controller.inverse_dynamics.robot.instruction import Instruction
from wbc_controller.inverse_dynamics.robot.model import RobotModel
from wbc_controller.records import Array

#: The axes of a mask, in words.
_AXES = ("along x", "along y", "along z", "about x", "about y", "about z")


class FixedContact(AnchoredContact):
    """A bolted foot or a gripping hand: it cannot move along some axes of its frame, and can push and pull.

    f has one component for each held axis of the contact frame, forces first: along the free axes the link slides or
    rotates, and no force is transmitted.

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
        stiffness: float = 0.0,
    ) -> None:
        """Make a fixed contact.

        Args:
            frame: a frame of the URDF, fixed to the link that is held.
            placement: of the contact in that frame.
            mask: axes of the contact frame that are held: along x, y, z, about x, y, z.
            against: a frame of the URDF, fixed to the link that holds; None for the world.
            max_force: largest force along each axis, N.
            max_moment: largest moment about each axis, N·m.
            damping: D, 1/s.
            stiffness: K, 1/s².

        Raises:
            ConfigurationError: if the model has no such frame, no axis is held, or a stiffness is given although
                motions along the free axes can change the position along held ones (see `_reached`).
        """
        self._rows = np.flatnonzero(mask)
        if not len(self._rows):
            raise ConfigurationError(f"contacts.{name}.mask = {list(mask)}: it holds no axis")
        reached = _reached(self._rows)
        if stiffness > 0.0 and reached:
            raise ConfigurationError(
                f"contacts.{name}.stiffness = {stiffness:g}: with mask = {[bool(held) for held in mask]} the link gets "
                f"to other places {' and '.join(reached)} by its motions along the axes that are free, so that there "
                "is none to go back to; take 0, or another mask"
            )
        k = len(self._rows)
        super().__init__(
            name,
            np.eye(6)[:, self._rows],
            np.zeros((0, k)),
            frame,
            stiffness=stiffness,
            damping=damping,
            internal=against is not None,
        )
        self._hinge = hinge_of(mask)
        self._held = np.array(mask[:3], dtype=np.float64)
        self._mount = Mount(model, name, frame, placement, against)
        self.max_force = max_force
        self.max_moment = max_moment
        forces = k - int(self.moments.sum())
        groups = (("force", 0, forces), ("moment", forces, k))
        self.bound_groups = tuple(group for group in groups if group[1] < group[2])

    def placement(self, dynamics: Dynamics) -> pin.SE3:
        """Placement of the contact frame in the world."""
        return self._mount.placement(dynamics)

    def pose(self, dynamics: Dynamics) -> pin.SE3:
        """Placement of the contact frame in the world, or relative to the link that holds."""
        return self._mount.pose(dynamics)

    def displacement(self, dynamics: Dynamics, anchor: Array) -> Array:
        """e, along the held axes of the contact frame, (k,) in m and rad."""
        there = self._mount.seen(dynamics, anchor)
        # Remove the sliding along the free axes. These are the axes at activation, such as the direction of a rail.
        Q = there.rotation
        there.translation = Q @ (self._held * (Q.T @ there.translation))
        return opening(there, self._hinge)[self._rows]

    def instruction(self) -> Instruction | None:
        """How compiled code fills the rows."""
        return self._mount.instruction(self._rows) if type(self) is FixedContact else None

    def jacobian(self, dynamics: Dynamics) -> Array:
        """Jacobian of the contact frame along the held axes, (k, nv)."""
        return self._mount.jacobian(dynamics)[self._rows]

    def drift(self, dynamics: Dynamics) -> Array:
        """Spatial acceleration of the contact frame at v̇ = 0, along the held axes, (k,)."""
        return self._mount.drift(dynamics)[self._rows]

    def points(self, dynamics: Dynamics) -> Array:
        """The contact frame's origin in the world, (1, 3) in m."""
        return np.array(self.placement(dynamics).translation)[None, :]

    def wrench_in_world(self, dynamics: Dynamics, force: Array) -> Array:
        """The wrench, transformed from the contact frame to the world's origin and axes, (6,) in N and N·m."""
        return np.asarray(self.placement(dynamics).act(pin.Force(self.basis @ force)).vector)

    def bounds(self, activation: float) -> tuple[Array, Array]:
        """Lower and upper bounds of f, both (k,): the activation scales all of them."""
        most = activation * np.where(self.moments, self.max_moment, self.max_force)
        return -most, most


def _reached(held: np.ndarray) -> list[str]:
    """Name the held axes along which a sequence of motions along free axes can still displace the link.

    A car parks sideways in this way. Where the twists along the free axes do not form a Lie algebra, the constraint is
    not holonomic and does not restrict the position (Frobenius; Murray, Li and Sastry, A Mathematical Introduction to
    Robotic Manipulation, 1994, section 7.2).
    """
    free = [pin.Motion(axis) for i, axis in enumerate(np.eye(6)) if i not in held]
    brackets = np.array([a.cross(b).vector for a in free for b in free]).reshape(-1, 6)
    return [_AXES[i] for i in held if brackets[:, i].any()]
