"""Instructions for compiled code to fill the rows of a task or contact (`robot.frame_kernels.fill_rows`)."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import pinocchio as pin

from wbc_controller.inverse_dynamics.robot.model import RobotModel
from wbc_controller.records import Array


@dataclass(frozen=True, slots=True)
class Instruction:
    """Description of the rows of a task or contact by numbers.

    Attributes:
        kind: a kind of `robot.frame_kernels`.
        rows: selected components; for a task on single joints their indices in q, then in v.
        link: index of the link.
        other: index of the touched link; 0 for the world.
        first: first component of the frame's twist.
        size: number of components before the mask.
        constants: constant numbers, such as the placement of the frame on its link.
    """

    kind: int
    rows: np.ndarray
    link: int = 0
    other: int = 0
    first: int = 0
    size: int = 0
    constants: Array = field(default_factory=lambda: np.zeros(0))


def placement_on_link(model: RobotModel, frame_id: int, placement: pin.SE3 | None = None) -> tuple[int, pin.SE3]:
    """Return the index of a frame's link, and the placement on that link of the frame, or of a placement in it."""
    frame = model.pinocchio.frames[frame_id]
    return int(frame.parentJoint), frame.placement if placement is None else frame.placement * placement


def placement_numbers(placement: pin.SE3) -> Array:
    """Return a placement as (12,): columns of the rotation, then the translation."""
    return np.concatenate([placement.rotation.T.ravel(), placement.translation])
