"""Settings of contacts and closed loops."""

import math
import reprlib
from typing import Annotated, Literal

from pydantic import AfterValidator, Field, model_validator

from wbc_controller.settings.values import Finite, Gain, NonNegative, Positive, Section, Vector3, axes_mask, key

Length = Annotated[Positive, Field(le=1.0)]  # half side or radius of a contact, m
Coordinate = Annotated[Finite, Field(ge=-1.0, le=1.0)]  # one coordinate of a corner, m
Corners = Annotated[list[Annotated[list[Coordinate], Field(min_length=2, max_length=2)]], Field(max_length=12)]


class _Contact(Section):
    live = ("enabled", "ramp")

    frame: str = Field(description="URDF frame on the link in contact.")
    translation: Vector3 = key([0.0, 0.0, 0.0], "Origin of the contact in `frame`, m.")
    against: str | None = key(None, "URDF frame on the touched link; none for the world.")
    enabled: bool = key(True, "Active when the controller is activated.")
    damping: Gain = key(20.0, "Damping D of the contact velocity, 1/s (docs/contacts.md).")
    stiffness: Gain = key(0.0, "Stiffness towards the pose at activation, 1/s².")
    ramp: NonNegative = key(0.2, "Duration of loading and unloading, s.", le=10.0)


class _PushingContact(_Contact):
    friction: Positive = key(0.7, "Assumed Coulomb friction coefficient.", le=2.0)
    min_normal_force: NonNegative = key(0.0, "Smallest normal force, N.", le=1.0e4)
    max_normal_force: Positive = Field(le=1.0e5, description="Largest normal force, N.")


_NORMAL = key([0.0, 0.0, 1.0], "Outward normal of the touched surface, in axes of `against` or the world; any length.")


def _require_nonzero(value: list[float]) -> list[float]:
    if not math.hypot(*value) > 1.0e-9:
        raise ValueError("must not be zero")
    return value


Direction = Annotated[Vector3, AfterValidator(_require_nonzero)]


class SurfaceContact(_PushingContact):
    """Flat rectangle or convex polygon without slip or rotation: six forces, exact linear wrench cone."""

    type: Literal["surface"]
    rpy: Vector3 = key(
        [0.0, 0.0, 0.0],
        "Orientation in `frame`: roll, pitch, yaw, rad. The z axis points away from the touched surface.",
    )
    half_length: Length | None = key(None, "Half side of the rectangle along x, m.")
    half_width: Length | None = key(None, "Half side of the rectangle along y, m.")
    vertices: Corners | None = key(
        None, "In place of the rectangle: up to 12 corners [x, y] of a convex polygon, m, in any order."
    )
    max_yaw_moment: Positive | None = key(
        None, "Largest moment about the normal, N·m; by default limited by the wrench cone only.", le=1.0e4
    )

    @property
    def corners(self) -> list[list[float]]:
        """Corners of the rectangle or polygon, [x, y] in m."""
        if self.vertices is not None:
            return self.vertices
        x, y = self.half_length or 0.0, self.half_width or 0.0
        return [[x, y], [x, -y], [-x, -y], [-x, y]]

    @model_validator(mode="after")
    def _one_shape(self) -> "SurfaceContact":
        wanted = {"half_length", "half_width"} if self.vertices is None else {"vertices"}
        for name in ("half_length", "half_width", "vertices"):
            value = getattr(self, name)
            if (value is not None) != (name in wanted):
                raise ValueError(
                    f"{name} = {reprlib.repr(value)}: a surface requires either half_length and half_width, or vertices"
                )
        return self


class PointContact(_PushingContact):
    """Ball or point without slip: three forces in a friction pyramid."""

    type: Literal["point"]
    normal: Direction = _NORMAL
    radius: Length = key(0.02, "Radius of the ball, m. Its centre is the origin of the contact.")


class RollingContact(_PushingContact):
    """Thin wheel, rolling without slip: three forces in a friction pyramid."""

    type: Literal["rolling"]
    axis: Direction = Field(description="Direction of the axle in `frame`; any length.")
    normal: Direction = _NORMAL
    radius: Length = Field(description="Radius of the wheel, m. Its centre is the origin of the contact.")


def _require_axis(mask: list[bool]) -> list[bool]:
    if not any(mask):
        raise ValueError("requires at least one axis")
    return mask


_Mask = Annotated[list[bool], AfterValidator(_require_axis)]
_MASK = axes_mask(6, "Constrained axes: translation along x, y, z, then rotation about x, y, z.")


class FixedContact(_Contact):
    """Fixed link, such as a bolted foot or a gripping hand: up to six forces of either sign, without a cone."""

    type: Literal["fixed"]
    rpy: Vector3 = key([0.0, 0.0, 0.0], "Orientation in `frame`: roll, pitch, yaw, rad.")
    mask: _Mask = _MASK
    max_force: Positive = Field(le=1.0e5, description="Largest force along each axis, N.")
    max_moment: Positive | None = key(
        None, "Largest moment about each axis, N·m; required if `mask` contains a rotation.", le=1.0e5
    )

    @model_validator(mode="after")
    def _consistent(self) -> "FixedContact":
        if any(self.mask[3:]) and self.max_moment is None:
            raise ValueError("max_moment = None: required, as the mask contains a rotation")
        return self


ContactSettings = Annotated[SurfaceContact | PointContact | FixedContact | RollingContact, Field(discriminator="type")]


class LoopSettings(Section):
    """Closed loop: a joint between two links that is not in the URDF's tree."""

    frame_a: str = Field(description="URDF frame on the first link.")
    frame_b: str = Field(description="URDF frame on the second link.")
    translation_a: Vector3 = key([0.0, 0.0, 0.0], "Origin of the joint in `frame_a`, m.")
    rpy_a: Vector3 = key([0.0, 0.0, 0.0], "Orientation of the joint in `frame_a`: roll, pitch, yaw, rad.")
    translation_b: Vector3 = key([0.0, 0.0, 0.0], "Origin of the joint in `frame_b`, m.")
    rpy_b: Vector3 = key([0.0, 0.0, 0.0], "Orientation of the joint in `frame_b`: roll, pitch, yaw, rad.")
    mask: _Mask = _MASK
    stiffness: Gain = key(400.0, "Stiffness of Baumgarte's stabilization, 1/s²; critically damped.")
