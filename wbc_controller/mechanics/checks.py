"""Argument checks."""

from typing import Any

import numpy as np
import numpy.typing as npt
import pinocchio as pin

from wbc_controller.errors import ConfigurationError, InputRefused, require_known
from wbc_controller.records import Array


def as_array(name: str, values: npt.ArrayLike, shape: tuple[int, ...]) -> Array:
    """Return a finite array of a shape, or raise `InputRefused` with its name."""
    array = np.asarray(values, dtype=np.float64)
    if array.shape != shape:
        raise InputRefused(f"{name} has shape {array.shape}, expected {shape}")
    if not np.isfinite(array).all():
        where = [tuple(int(i) for i in index) for index in np.argwhere(~np.isfinite(array))[:5]]
        raise InputRefused(f"{name} is not finite at {where}; expected finite values")
    return array


def frame_index(model: pin.Model, name: str) -> int:
    """Return the index of a frame, of a link rather than of a joint, or raise `ConfigurationError`."""
    if model.existFrame(name, pin.BODY):
        return int(model.getFrameId(name, pin.BODY))
    if not model.existFrame(name):
        require_known(name, [frame.name for frame in model.frames if frame.type == pin.BODY], "unknown frame")
    return int(model.getFrameId(name))


def joint_index(model: pin.Model, name: str) -> int:
    """Return the index of a joint, or raise `ConfigurationError`."""
    require_known(name, list(model.names)[1:], "unknown joint")
    return int(model.getJointId(name))


def single_joint(model: pin.Model, name: str) -> Any:
    """Return a joint with one degree of freedom in one coordinate, or raise `ConfigurationError`."""
    joint = model.joints[joint_index(model, name)]
    if joint.nq != 1 or joint.nv != 1:
        raise ConfigurationError(
            f"joint {name!r} ({joint.shortname()}) has {joint.nv} degrees of freedom in {joint.nq} coordinates, "
            "expected one of each"
        )
    return joint
