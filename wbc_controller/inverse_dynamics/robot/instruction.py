"""Instructions for `robot.frame_kernels.fill_rows`."""

from dataclasses import dataclass, field

import numpy as np
import pinocchio as pin

from wbc_controller.inverse_dynamics.robot.model import RobotModel
from wbc_controller.records import Array


@dataclass(frozen=True, slots=True)
class Instruction:
    """Rows of a task or contact as numbers."""

    kind: int  # of `robot.frame_kernels`
    rows: np.ndarray  # selected components; for joint tasks their indices in q, then in v
    link: int = 0
    other: int = 0  # touched link; 0 for the world
    first: int = 0  # component of the frame's twist
    size: int = 0  # before the mask
    constants: Array = field(default_factory=lambda: np.zeros(0))  # e.g. the placement of the frame on its link


def placement_on_link(model: RobotModel, frame_id: int, placement: pin.SE3 | None = None) -> tuple[int, pin.SE3]:
    """Return the link index and the placement on the link, of a frame or of a placement in it."""
    frame = model.pinocchio.frames[frame_id]
    return int(frame.parentJoint), frame.placement if placement is None else frame.placement * placement


def placement_numbers(placement: pin.SE3) -> Array:
    """Return a placement as (12,): columns of the rotation, translation."""
    return np.concatenate([placement.rotation.T.ravel(), placement.translation])
