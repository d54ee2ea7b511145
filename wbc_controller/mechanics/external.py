"""External wrenches and their generalized forces (section 2.2, equations (20)–(22); S4)."""

from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np
import pinocchio as pin

from wbc_controller.errors import ConfigurationError
from wbc_controller.mechanics.checks import as_array, frame_index
from wbc_controller.records import Array

_AXES = {"LOCAL": pin.LOCAL, "LOCAL_WORLD_ALIGNED": pin.LOCAL_WORLD_ALIGNED, "WORLD": pin.WORLD}


@dataclass(frozen=True)
class ExternalWrench:
    """External wrench on a link, the τ of equation (22).

    Raises:
        ConfigurationError: if `axes` is unknown.
        InputRefused: if an array is invalid.
    """

    frame: str  # frame of the link
    wrench: Array  # force in N and torque in N·m about the point of application, (6,)
    #: `pinocchio.ReferenceFrame`. ``LOCAL``: frame's axes and origin; ``LOCAL_WORLD_ALIGNED``: world axes, frame's
    #: origin; ``WORLD``: world's axes and origin
    axes: str = "LOCAL_WORLD_ALIGNED"
    #: point of application relative to this origin, in these axes, (3,) in m
    point: Array = field(default_factory=lambda: np.zeros(3))

    def __post_init__(self) -> None:
        if self.axes not in _AXES:
            raise ConfigurationError(f"unknown axes {self.axes!r} of an external wrench; valid: {', '.join(_AXES)}")
        as_array("an external wrench", self.wrench, (6,))
        as_array("an external wrench's point", self.point, (3,))

    @property
    def at_origin(self) -> Array:
        """Wrench about the origin, (6,)."""
        wrench = np.array(self.wrench, dtype=np.float64)
        wrench[3:] += np.cross(self.point, wrench[:3])
        return wrench


def generalized_force(
    model: pin.Model, q: Array, wrenches: Iterable[ExternalWrench], *, data: pin.Data | None = None
) -> Array:
    """Return the generalized force Σ Jᵀw of external wrenches (equation (22)), (nv,) in N and N·m.

    Raises:
        ConfigurationError: if a frame is unknown.
    """
    data = data or model.createData()
    total = np.zeros(model.nv)
    pin.computeJointJacobians(model, data, q)
    pin.updateFramePlacements(model, data)
    for external in wrenches:
        J = pin.getFrameJacobian(model, data, frame_index(model, external.frame), _AXES[external.axes])
        total += J.T @ external.at_origin
    return total


def world_wrench(
    model: pin.Model, q: Array, wrenches: Iterable[ExternalWrench], *, data: pin.Data | None = None
) -> Array:
    """Return the sum of external wrenches of (22) about the world's origin, (6,) in N and N·m, world axes.

    Raises:
        ConfigurationError: if a frame is unknown.
    """
    data = data or model.createData()
    pin.framesForwardKinematics(model, data, q)
    total = np.zeros(6)
    for external in wrenches:
        placement = data.oMf[frame_index(model, external.frame)]
        R = placement.rotation if external.axes == "LOCAL" else np.eye(3)
        p = np.zeros(3) if external.axes == "WORLD" else placement.translation
        total += pin.SE3(R, p).act(pin.Force(external.at_origin)).vector
    return total
