"""Placement of a contact on its link."""

import math
from collections.abc import Callable, Sequence

import numpy as np
import numpy.typing as npt
import pinocchio as pin

from wbc_controller.errors import ConfigurationError
from wbc_controller.inverse_dynamics.contacts.contact import AnchoredContact
from wbc_controller.inverse_dynamics.robot.dynamics import Dynamics
from wbc_controller.inverse_dynamics.robot.frame_kernels import SURFACE
from wbc_controller.inverse_dynamics.robot.instruction import Instruction, placement_numbers, placement_on_link
from wbc_controller.inverse_dynamics.robot.model import RobotModel
from wbc_controller.records import Array


def placement_of(translation: Sequence[float], rpy: Sequence[float] = (0.0, 0.0, 0.0)) -> pin.SE3:
    """Make a placement from a translation in m and roll, pitch, yaw in rad."""
    return pin.SE3(pin.rpy.rpyToMatrix(np.array(rpy, dtype=np.float64)), np.array(translation, dtype=np.float64))


def support_link(model: RobotModel, name: str, frame: str, against: str | None) -> int | None:
    """Return the frame id of the touched link, None for the world; requires a joint between both frames."""
    if against is None:
        return None
    other = model.frame_id(against, f"contacts.{name}.against")
    frames = model.pinocchio.frames
    if frames[other].parentJoint == frames[model.frame_id(frame, f"contacts.{name}.frame")].parentJoint:
        raise ConfigurationError(f"contacts.{name}.against = {against!r}: no joint is between it and {frame!r}")
    return other


def pose_displacement(pose: pin.SE3, hinge: Array | None = None) -> Array:
    """Return the displacement [r, log Q] of a pose (r, Q) from the identity, (6,) in m and rad.

    With a `hinge`, the single free rotation axis (3,), the angular part is the rotation between its two positions.
    """
    if hinge is None:
        turn = pin.log3(pose.rotation)
    else:
        n = pose.rotation @ hinge
        turn = np.cross(hinge, n)
        sine = float(np.linalg.norm(turn))
        turn = turn * (math.atan2(sine, float(hinge @ n)) / sine) if sine > 1.0e-12 else turn
    return np.concatenate([pose.translation, turn])


def held_axes(mask: Sequence[bool], key: str) -> tuple[npt.NDArray[np.intp], Array | None]:
    """Return the held axes of a mask, (k,), at least one; and the single free rotation axis, (3,), or None."""
    rows, free = np.flatnonzero(mask), np.flatnonzero(~np.asarray(mask[3:], dtype=bool))
    if not len(rows):
        raise ConfigurationError(f"{key} = {list(mask)}: at least one axis must be held")
    return rows, np.eye(3)[free[0]] if len(free) == 1 else None


class Mount:
    """Contact frame C fixed to a link, and its motion relative to the world or another link B.

    With X the transform of a twist from B to C, the twist of C relative to B in the axes of C is ν = ν_C - X ν_B. With
    Ẋ = -(ν ×) X,

        ν̇ = ν̇_C - X ν̇_B + ν × (X ν_B)

    with the cross product of spatial motion vectors (Featherstone, Rigid Body Dynamics Algorithms, 2008, section 2.9).
    """

    def __init__(
        self, model: RobotModel, name: str, frame: str, placement: pin.SE3, against: str | None = None
    ) -> None:
        self._id = model.frame_id(frame, f"contacts.{name}.frame")
        self._other = support_link(model, name, frame, against)
        self._placement = placement
        self._on_link = placement_on_link(model, self._id, placement)
        self._other_link = 0 if self._other is None else int(model.pinocchio.frames[self._other].parentJoint)

    def placement(self, dynamics: Dynamics) -> pin.SE3:
        """Return the placement of C in the world."""
        return dynamics.placement(self._id) * self._placement

    def pose(self, dynamics: Dynamics) -> pin.SE3:
        """Return the placement of C in the world, or in the frame of B."""
        placement = self.placement(dynamics)
        return placement if self._other is None else dynamics.placement(self._other).actInv(placement)

    def instruction(self, rows: np.ndarray) -> Instruction:
        """Return the instruction for the components `rows` (r,) of ν."""
        link, placement = self._on_link
        return Instruction(SURFACE, rows, link, self._other_link, constants=placement_numbers(placement))

    def relative(self, dynamics: Dynamics, of_frame: Callable[[int, pin.ReferenceFrame], Array]) -> Array:
        """Return ν, (6,), from `Dynamics.velocity`, or its Jacobian, (6, nv), from `Dynamics.jacobian`."""
        found = self._placement.toActionMatrixInverse() @ of_frame(self._id, pin.LOCAL)
        if self._other is not None:
            found -= self._from_other(dynamics, self._other) @ of_frame(self._other, pin.LOCAL)
        return np.asarray(found)

    def drift(self, dynamics: Dynamics) -> Array:
        """Return ν̇ at v̇ = 0, (6,)."""
        drift = self._placement.toActionMatrixInverse() @ dynamics.drift_local(self._id)
        if self._other is not None:
            X = self._from_other(dynamics, self._other)
            nu, carried = self.relative(dynamics, dynamics.velocity), X @ dynamics.velocity(self._other, pin.LOCAL)
            drift += pin.Motion(nu).cross(pin.Motion(carried)).vector - X @ dynamics.drift_local(self._other)
        return np.asarray(drift)

    def _from_other(self, dynamics: Dynamics, other: int) -> Array:
        X: Array = self.placement(dynamics).actInv(dynamics.placement(other)).toActionMatrix()
        return X


class MountedContact(AnchoredContact):
    """Contact of a frame fixed to a link, along some of its axes."""

    _mount: Mount
    _rows: npt.NDArray[np.intp]  # constrained components of the twist, (k,)

    def placement(self, dynamics: Dynamics) -> pin.SE3:
        """Return the placement of the contact frame in the world."""
        return self._mount.placement(dynamics)

    def pose(self, dynamics: Dynamics) -> pin.SE3:
        """Return `placement`, or the placement in the touched link."""
        return self._mount.pose(dynamics)

    def jacobian(self, dynamics: Dynamics) -> Array:
        """Return J of the relative twist in contact axes, (k, nv)."""
        return self._mount.relative(dynamics, dynamics.jacobian)[self._rows]

    def drift(self, dynamics: Dynamics) -> Array:
        """Return J̇v, (k,)."""
        return self._mount.drift(dynamics)[self._rows]

    def wrench_in_world(self, dynamics: Dynamics, force: Array) -> Array:
        """Return the wrench, (6,)."""
        return np.asarray(self.placement(dynamics).act(pin.Force(self.basis @ force)).vector)
