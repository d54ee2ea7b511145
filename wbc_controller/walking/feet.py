"""The feet: poses of their soles, and references of the tasks on their frames."""

import math
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from wbc_controller.inverse_dynamics.arrays import cross
from wbc_controller.inverse_dynamics.robot.dynamics import Dynamics
from wbc_controller.records import Array, Reference
from wbc_controller.walking.swing import SwingFoot


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

    def height_at(self, place: complex) -> float:
        """Return the height of the plane of this sole at a place, m."""
        n, to = self.rotation[:, 2], place - self.place
        return float(self.centre[2] - (n[0] * to.real + n[1] * to.imag) / n[2])


@dataclass(frozen=True, slots=True)
class Foot:
    """One foot.

    Attributes:
        contact: name of its contact.
        task: name of the task on the pose of its frame.
        frame: index of the frame.
        placement: of the sole in that frame: centre, and axes with z upwards.
        half: half length and half width of the sole, m.
    """

    contact: str
    task: str
    frame: int
    placement: pin.SE3
    half: tuple[float, float]

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

    def in_swing(self, swing: SwingFoot, stance: Sole) -> Reference:
        """Return the reference of the frame for a sole in the air, parallel to the stance foot but for its heading."""
        turn = about_z(swing.heading.position - stance.heading)
        frame = pin.SE3(turn @ stance.rotation, np.zeros(3)) * self.placement.inverse()
        offset = frame.translation  # from the sole to the frame, in world axes
        across = np.array([-offset[1], offset[0], 0.0])  # e_z × offset
        inwards = np.array([-offset[0], -offset[1], 0.0])  # e_z × (e_z × offset)
        heading, axes = swing.heading, (swing.x, swing.y, swing.z)
        frame.translation = offset + [axis.position for axis in axes]
        velocity, acceleration = np.zeros(6), np.zeros(6)
        velocity[:3] = heading.velocity * across + [axis.velocity for axis in axes]
        acceleration[:3] = heading.acceleration * across + heading.velocity**2 * inwards
        acceleration[:3] += [axis.acceleration for axis in axes]
        velocity[5], acceleration[5] = heading.velocity, heading.acceleration
        return Reference(pin.SE3ToXYZQUAT(frame), velocity, acceleration)


def about_z(angle: float) -> Array:
    """Return the rotation about z by an angle in rad, (3, 3)."""
    c, s = math.cos(angle), math.sin(angle)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def mean_angle(a: float, b: float) -> float:
    """Return the angle in the middle of the shorter way from one angle to another, rad."""
    return a + 0.5 * math.remainder(b - a, math.tau)
