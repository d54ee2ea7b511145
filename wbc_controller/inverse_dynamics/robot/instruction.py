"""What compiled code needs to know of a task or contact to fill its rows (`robot.frame_kernels.fill_rows`)."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import pinocchio as pin

from wbc_controller.inverse_dynamics.robot.model import RobotModel
from wbc_controller.records import Array


@dataclass(frozen=True, slots=True)
class Instruction:
    """The rows of a task or contact, in numbers.

    Attributes:
        kind: one of the kinds of `robot.frame_kernels`.
        rows: the components that become rows, or, of a task on single joints, their indices in q and then in v.
        link: index of the link.
        other: index of the link that is touched; 0 for the world.
        first: first component of the frame's twist.
        size: number of components before the mask.
        constants: what never changes: where the frame is on the link, and more by kind.
    """

    kind: int
    rows: np.ndarray
    link: int = 0
    other: int = 0
    first: int = 0
    size: int = 0
    constants: Array = field(default_factory=lambda: np.zeros(0))


def on_link(model: RobotModel, frame_id: int, placement: pin.SE3 | None = None) -> tuple[int, pin.SE3]:
    """Index of a frame's link, and where the frame, or what is placed in it, is on that link."""
    frame = model.pinocchio.frames[frame_id]
    return int(frame.parentJoint), frame.placement if placement is None else frame.placement * placement


def numbers_of(placement: pin.SE3) -> Array:
    """A placement as (12,): the columns of the rotation, then the translation."""
    return np.concatenate([placement.rotation.T.ravel(), placement.translation])
