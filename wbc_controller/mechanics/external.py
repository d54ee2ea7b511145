"""External wrenches in any frame, and their generalized forces (section 2.2, equations (20)–(22); S4)."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pinocchio as pin

from wbc_controller.errors import ConfigurationError
from wbc_controller.mechanics.checks import as_array, frame_index
from wbc_controller.records import Array

_AXES = {"LOCAL": pin.LOCAL, "LOCAL_WORLD_ALIGNED": pin.LOCAL_WORLD_ALIGNED, "WORLD": pin.WORLD}


@dataclass(frozen=True)
class ExternalWrench:
    """A force and a torque that the world exerts on the link of a frame: the τ of equation (22), before transformation.

    Attributes:
        frame: frame of the model whose link the wrench acts on.
        wrench: force in N, then torque in N·m about the point of application, (6,).
        axes: ``LOCAL``: in the frame's axes, at the frame's origin; ``LOCAL_WORLD_ALIGNED``: in world axes, at the
            frame's origin; ``WORLD``: in world axes, at the world's origin. As `pinocchio.ReferenceFrame`.
        point: point of application, measured from that origin and in those axes, (3,) in m; by default the origin.

    Raises:
        ConfigurationError: where `axes` has another value.
        InputRefused: where the wrench or the point has another shape, or is not finite.
    """

    frame: str
    wrench: Array
    axes: str = "LOCAL_WORLD_ALIGNED"
    point: Array = field(default_factory=lambda: np.zeros(3))

    def __post_init__(self) -> None:
        if self.axes not in _AXES:
            raise ConfigurationError(f"axes = {self.axes!r} of an external wrench; valid: {', '.join(_AXES)}")
        as_array("an external wrench", self.wrench, (6,))
        as_array("an external wrench's point", self.point, (3,))

    @property
    def at_origin(self) -> Array:
        """The wrench about the origin, (6,): point × force is added to the torque."""
        wrench = np.array(self.wrench, dtype=np.float64)
        wrench[3:] += np.cross(self.point, wrench[:3])
        return wrench


def generalized_force(
    model: pin.Model, q: Array, wrenches: Iterable[ExternalWrench], *, data: pin.Data | None = None
) -> Array:
    """Generalized force Σ Jᵀw of external wrenches (equation (22)), (nv,) in N and N·m.

    J is in the axes of each wrench. The work is the same in all coordinates, (Jᵀw)ᵀv = wᵀ(J v), as (21) requires.

    Raises:
        ConfigurationError: if a frame is unknown.
    """
    data = data if data is not None else model.createData()
    total = np.zeros(model.nv)
    wrenches = tuple(wrenches)
    if wrenches:
        pin.computeJointJacobians(model, data, q)
        pin.updateFramePlacements(model, data)
    for external in wrenches:
        J = pin.getFrameJacobian(model, data, frame_index(model, external.frame), _AXES[external.axes])
        total += J.T @ external.at_origin
    return total


def world_wrench(
    model: pin.Model, q: Array, wrenches: Iterable[ExternalWrench], *, data: pin.Data | None = None
) -> Array:
    """Sum of external wrenches about the world's origin, (6,) in N and N·m, world axes (equation (22) before its Jᵀ).

    Raises:
        ConfigurationError: if a frame is unknown.
    """
    data = data if data is not None else model.createData()
    pin.framesForwardKinematics(model, data, q)
    total = np.zeros(6)
    for external in wrenches:
        placement: Any = data.oMf[frame_index(model, external.frame)]
        wrench = external.at_origin
        if external.axes == "LOCAL":
            wrench = np.array(placement.act(pin.Force(wrench)).vector)
        elif external.axes == "LOCAL_WORLD_ALIGNED":
            wrench[3:] += np.cross(placement.translation, wrench[:3])
        total += wrench
    return total
