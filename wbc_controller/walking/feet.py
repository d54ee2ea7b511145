"""Feet: poses and references."""

import math
from dataclasses import dataclass, field

import numpy as np
import pinocchio as pin

from wbc_controller.inverse_dynamics.arrays import cross
from wbc_controller.inverse_dynamics.robot.dynamics import Dynamics
from wbc_controller.inverse_dynamics.robot.instruction import placement_numbers
from wbc_controller.records import Array, Reference
from wbc_controller.walking.feet_kernels import frame_in_swing
from wbc_controller.walking.swing import SwingFoot
from wbc_controller.walking.terrain import Ground, parallel_to


@dataclass(frozen=True, slots=True)
class Sole:
    """Pose of a sole in the world: centre, (3,) in m, and rotation, (3, 3)."""

    centre: Array
    rotation: Array

    @property
    def place(self) -> complex:
        """Place of the centre on the ground, x + i y in m."""
        return complex(self.centre[0], self.centre[1])

    @property
    def heading(self) -> float:
        """Angle of the x axis about the vertical, rad."""
        return math.atan2(self.rotation[1, 0], self.rotation[0, 0])

    @property
    def ground(self) -> Ground:
        """Plane of this sole."""
        n = self.rotation[:, 2]
        return Ground(self.place, float(self.centre[2]), complex(-n[0] / n[2], -n[1] / n[2]))


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
        return Sole(pose.translation, pose.rotation)

    def corners(self, sole: Sole) -> list[complex]:
        """Return the corners of the rectangle `half` on the ground, x + i y in m."""
        axes = sole.rotation[0] + 1j * sole.rotation[1]
        length, width = self.half[0] * axes[0], self.half[1] * axes[1]
        return [sole.place + a * length + b * width for a in (1.0, -1.0) for b in (1.0, -1.0)]

    def velocity(self, dynamics: Dynamics) -> Array:
        """Return the velocity of the centre of the sole in world axes, (3,) in m/s."""
        twist = dynamics.velocity(self.frame, pin.LOCAL_WORLD_ALIGNED)
        arm = dynamics.placement(self.frame).rotation @ self.placement.translation
        return twist[:3] + cross(twist[3:], arm)

    def at_rest(self, sole: Sole) -> Reference:
        """Return the reference of the frame for a sole at rest."""
        frame = pin.SE3(sole.rotation, sole.centre) * self.placement.inverse()
        return Reference(pin.SE3ToXYZQUAT(frame), np.zeros(6), np.zeros(6))

    def in_swing(self, swing: SwingFoot, slope: complex) -> Reference:
        """Return the reference of the frame for a sole in the air, parallel to a slope."""
        axes = (swing.x, swing.y, swing.z, swing.heading)
        numbers = [number for axis in axes for number in (axis.position, axis.velocity, axis.acceleration)]
        sole, out = parallel_to(slope, swing.heading.position), np.empty(19)
        frame_in_swing(sole, np.array(numbers), self.frame_in_sole, out)
        return Reference(out[:7], out[7:13], out[13:])


def about_z(angle: float) -> Array:
    """Return the rotation about z by an angle in rad, (3, 3)."""
    c, s = math.cos(angle), math.sin(angle)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def mean_angle(a: float, b: float) -> float:
    """Return the angle in the middle of the shorter way from one angle to another, rad."""
    return a + 0.5 * math.remainder(b - a, math.tau)
