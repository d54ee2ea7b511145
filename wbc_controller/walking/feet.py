"""Feet: poses and references."""

import math
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from wbc_controller.inverse_dynamics.robot.dynamics import Dynamics
from wbc_controller.inverse_dynamics.robot.instruction import placement_numbers
from wbc_controller.records import Array, Reference
from wbc_controller.walking.feet_kernels import frame_in_swing
from wbc_controller.walking.terrain import Ground


class Sole(NamedTuple):
    """Pose of a sole in the world.

    Attributes:
        place: of the centre on the ground, x + i y in m.
        height: of the centre, m.
        heading: angle of the x axis about the vertical, rad.
        rotation: (3, 3).
    """

    place: complex
    height: float
    heading: float
    rotation: Array

    @property
    def centre(self) -> Array:
        """Centre, (3,) in m."""
        return np.array([self.place.real, self.place.imag, self.height])

    @property
    def ground(self) -> Ground:
        """Plane of this sole."""
        n = self.rotation[:, 2]
        return Ground(self.place, self.height, complex(-n[0] / n[2], -n[1] / n[2]))


@dataclass(frozen=True, slots=True)
class Foot:
    """One foot: its contact, the task on the pose of its frame, and the index of the frame.

    Attributes:
        placement: of the sole in the frame: centre, and axes with z upwards.
        half: half length and half width of the sole, m.
        frame_in_sole: placement of the frame in the sole, (12,).
    """

    contact: str
    task: str
    frame: int
    placement: pin.SE3
    half: tuple[float, float]
    frame_in_sole: Array = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "frame_in_sole", placement_numbers(self.placement.inverse()))

    def sole(self, dynamics: Dynamics) -> Sole:
        """Return the pose of the sole."""
        pose = dynamics.placement(self.frame) * self.placement
        x, y, z = pose.translation.tolist()
        R = pose.rotation
        return Sole(complex(x, y), z, math.atan2(R[1, 0], R[0, 0]), R)

    def corners(self, sole: Sole) -> list[complex]:
        """Return the corners of the rectangle `half` on the ground, x + i y in m."""
        axes = sole.rotation[0] + 1j * sole.rotation[1]
        length, width = self.half[0] * axes[0], self.half[1] * axes[1]
        return [sole.place + a * length + b * width for a in (1.0, -1.0) for b in (1.0, -1.0)]

    def velocity(self, dynamics: Dynamics) -> Array:
        """Return the velocity of the centre of the sole in world axes, (3,) in m/s."""
        vx, vy, vz, wx, wy, wz = dynamics.velocity(self.frame, pin.LOCAL_WORLD_ALIGNED).tolist()
        frame = dynamics.placement(self.frame)
        fx, fy, fz = frame.translation.tolist()
        x, y, z = (frame * self.placement).translation.tolist()
        x, y, z = x - fx, y - fy, z - fz
        return np.array([vx + wy * z - wz * y, vy + wz * x - wx * z, vz + wx * y - wy * x])

    def at_rest(self, sole: Sole) -> Reference:
        """Return the reference of the frame for a sole at rest."""
        frame = pin.SE3(sole.rotation, sole.centre) * self.placement.inverse()
        return Reference(pin.SE3ToXYZQUAT(frame), np.zeros(6), np.zeros(6))

    def in_swing(self, swing: Array, slope: complex) -> Reference:
        """Return the reference of the frame for the motion of a sole in the air, (3, 4), parallel to a slope."""
        out = np.empty(19)
        frame_in_swing(swing, slope, self.frame_in_sole, out)
        return Reference(out[:7], out[7:13], out[13:])


def about_z(angle: float) -> Array:
    """Return the rotation about z by an angle in rad, (3, 3)."""
    c, s = math.cos(angle), math.sin(angle)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def mean_angle(a: float, b: float) -> float:
    """Return the angle in the middle of the shorter way from one angle to another, rad."""
    return a + 0.5 * math.remainder(b - a, math.tau)
