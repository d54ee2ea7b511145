"""Settings of contacts and closed loops: one class per kind."""

from __future__ import annotations

import math
import reprlib
from typing import Annotated, Literal

from pydantic import AfterValidator, Field, model_validator

from wbc_controller.settings.values import Finite, Gain, NonNegative, Positive, Section, Vector3, axes_mask

#: Half side or radius of a contact, m: a larger value was probably meant in centimetres or millimetres.
Length = Annotated[Positive, Field(le=1.0)]
#: One coordinate of a corner, m.
Coordinate = Annotated[Finite, Field(ge=-1.0, le=1.0)]
Corners = Annotated[list[Annotated[list[Coordinate], Field(min_length=2, max_length=2)]], Field(max_length=12)]


class _Contact(Section):
    live = ("enabled", "ramp")

    frame: str = Field(description="A frame of the URDF, fixed to the link in contact.")
    translation: Vector3 = Field([0.0, 0.0, 0.0], description="Origin of the contact in that frame, m.")
    against: str | None = Field(
        None, description="A frame of the URDF, fixed to the link that is touched; none for the world."
    )
    enabled: bool = Field(True, description="Whether the contact is active at activation of the controller.")
    damping: Gain = Field(20.0, description="Damping of a residual velocity of the contact, 1/s.")
    stiffness: Gain = Field(
        0.0,
        description="Stiffness of the return to the pose at which the contact was activated, 1/s²: (damping / 2)² is "
        "critical; 0 for no return.",
    )
    ramp: NonNegative = Field(0.2, le=10.0, description="Time in which the contact is loaded or unloaded, s.")


class _PushingContact(_Contact):
    friction: Annotated[Positive, Field(le=2.0)] = Field(0.7, description="Coulomb friction coefficient assumed.")
    min_normal_force: NonNegative = Field(0.0, le=1.0e4, description="Smallest normal force, N.")
    max_normal_force: Annotated[Positive, Field(le=1.0e5)] = Field(description="Largest normal force, N.")


_NORMAL = Field(
    [0.0, 0.0, 1.0],
    description="Outward normal of the touched surface, of any non-zero length; in the axes of `against`, or of the "
    "world.",
)


def _with_a_length(value: list[float]) -> list[float]:
    if not math.hypot(*value) > 1.0e-9:
        raise ValueError("must have a length")
    return value


Direction = Annotated[Vector3, AfterValidator(_with_a_length)]


class SurfaceContact(_PushingContact):
    """A flat rectangle or convex polygon that neither slips nor turns: six forces, exact linear wrench cone."""

    type: Literal["surface"]
    rpy: Vector3 = Field(
        [0.0, 0.0, 0.0],
        description="Orientation of the contact in the frame: roll, pitch, yaw, rad; "
        "its z axis is the normal, pointing away from the touched surface.",
    )
    half_length: Length | None = Field(None, description="Half of the rectangle's side along x, m.")
    half_width: Length | None = Field(None, description="Half of the rectangle's side along y, m.")
    vertices: Corners | None = Field(
        None, description="Instead of a rectangle: up to 12 corners [x, y] of a convex polygon, in any order, m."
    )
    max_yaw_moment: Annotated[Positive, Field(le=1.0e4)] | None = Field(
        None, description="Largest moment about the normal, N·m; by default only the wrench cone bounds it."
    )

    @property
    def corners(self) -> list[list[float]]:
        """Corners of the rectangle or polygon, [x, y] in m."""
        if self.vertices is not None:
            return self.vertices
        x, y = self.half_length or 0.0, self.half_width or 0.0
        return [[x, y], [x, -y], [-x, -y], [-x, y]]

    @model_validator(mode="after")
    def _one_shape(self) -> SurfaceContact:
        given = {key: getattr(self, key) for key in ("half_length", "half_width", "vertices")}
        wanted = {"half_length", "half_width"} if self.vertices is None else {"vertices"}
        for key, value in given.items():
            if (value is not None) != (key in wanted):
                raise ValueError(
                    f"{key} = {reprlib.repr(value)}: a surface takes half_length and half_width, or vertices instead"
                )
        return self


class PointContact(_PushingContact):
    """A ball or point that does not slip: three forces in a friction pyramid."""

    type: Literal["point"]
    normal: Direction = _NORMAL
    radius: Length = Field(0.02, description="Radius of the ball, m. The contact's origin is the ball's centre.")


class RollingContact(_PushingContact):
    """A thin wheel that rolls without slipping, lengthwise or sideways: three forces in a friction pyramid."""

    type: Literal["rolling"]
    axis: Direction = Field(description="Direction of the axle in the frame, of any non-zero length.")
    normal: Direction = _NORMAL
    radius: Length = Field(description="Radius of the wheel, m. The contact's origin is the wheel's centre.")


_MASK = axes_mask(6, "Axes that are held: translation along x, y, z, then rotation about x, y, z. The others are free.")


class FixedContact(_Contact):
    """A held link, such as a bolted foot or a gripping hand: up to six forces of either sign, without a cone."""

    type: Literal["fixed"]
    rpy: Vector3 = Field([0.0, 0.0, 0.0], description="Orientation of the contact in the frame: roll, pitch, yaw, rad.")
    mask: list[bool] = _MASK
    max_force: Annotated[Positive, Field(le=1.0e5)] = Field(description="Largest force along each held axis, N.")
    max_moment: Annotated[Positive, Field(le=1.0e5)] | None = Field(
        None, description="Largest moment about each held axis, N·m; required if the mask holds a rotation."
    )

    @model_validator(mode="after")
    def _consistent(self) -> FixedContact:
        if not any(self.mask):
            raise ValueError(f"mask = {self.mask}: it holds no axis")
        if any(self.mask[3:]) and self.max_moment is None:
            raise ValueError("max_moment = None: it is required, as the mask holds a rotation")
        return self


ContactSettings = Annotated[SurfaceContact | PointContact | FixedContact | RollingContact, Field(discriminator="type")]


class LoopSettings(Section):
    """A closed loop: two frames that are always held together by a joint outside the URDF's tree."""

    frame_a: str = Field(description="A frame of the URDF, fixed to one link.")
    frame_b: str = Field(description="A frame of the URDF, fixed to the other link.")
    translation_a: Vector3 = Field([0.0, 0.0, 0.0], description="Origin of the joint in `frame_a`, m.")
    rpy_a: Vector3 = Field([0.0, 0.0, 0.0], description="Orientation of the joint in `frame_a`: roll, pitch, yaw, rad.")
    translation_b: Vector3 = Field([0.0, 0.0, 0.0], description="Origin of the joint in `frame_b`, m.")
    rpy_b: Vector3 = Field([0.0, 0.0, 0.0], description="Orientation of the joint in `frame_b`: roll, pitch, yaw, rad.")
    mask: list[bool] = _MASK
    stiffness: Gain = Field(
        400.0, description="Stiffness that closes a position error of the loop (Baumgarte), 1/s²; critically damped."
    )

    @model_validator(mode="after")
    def _consistent(self) -> LoopSettings:
        if not any(self.mask):
            raise ValueError(f"mask = {self.mask}: it holds no axis")
        return self
