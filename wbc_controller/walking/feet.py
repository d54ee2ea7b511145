"""Feet: poses, references, and the reaction to their swing."""

import math
from dataclasses import dataclass, field

import numpy as np
import pinocchio as pin

from wbc_controller.inverse_dynamics.robot.dynamics import Dynamics
from wbc_controller.inverse_dynamics.robot.instruction import placement_numbers
from wbc_controller.records import Array, Reference
from wbc_controller.walking.feet_kernels import motion_of_sole, move_sole
from wbc_controller.walking.swing_kernels import DESCENT, Landing
from wbc_controller.walking.terrain import Ground

_SOLE_SHARE = (0.8, 0.7)  # shares of the half length and half width of the sole that the centre of pressure may use


@dataclass(slots=True)  # faster than frozen ones and named tuples
class Sole:
    """Pose and speed of a sole in the world."""

    place: complex  # of the centre on the ground, x + i y in m
    height: float  # of the centre, m
    heading: float  # angle of the x axis about the vertical, rad
    slope: complex  # increase of the height along x and y, dz/dx + i dz/dy
    rise: float  # vertical velocity of the centre, m/s
    speed: float  # of the centre, m/s
    turning: float  # horizontal angular velocity, rad/s

    @property
    def ground(self) -> Ground:
        """Plane of this sole."""
        return Ground(self.place, self.height, self.slope)


@dataclass(frozen=True, slots=True)
class Foot:
    """One foot: its contact, the task on the pose of its frame, and the index of the frame."""

    contact: str
    task: str
    frame: int
    placement: pin.SE3  # of the sole in the frame: centre, and axes with z upwards
    half: tuple[float, float]  # half length and half width of the sole, m
    link: int  # index of the link
    on_link: Array  # placement of the sole on the link, (12,)
    frame_in_sole: Array = field(init=False)  # placement of the frame in the sole, (12,)
    #: Half length and half width of the area of the centre of pressure, m.
    usable: tuple[float, float] = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "usable", (_SOLE_SHARE[0] * self.half[0], _SOLE_SHARE[1] * self.half[1]))
        object.__setattr__(self, "frame_in_sole", placement_numbers(self.placement.inverse()))

    def sole(self, dynamics: Dynamics) -> Sole:
        """Return pose and speed of the sole."""
        return Sole(*motion_of_sole(dynamics.joints, dynamics.links, self.link, self.on_link))

    def pose(self, dynamics: Dynamics) -> pin.SE3:
        """Return the placement of the sole in the world."""
        return dynamics.placement(self.frame) * self.placement

    def corners(self, dynamics: Dynamics) -> list[complex]:
        """Return the corners of the rectangle `half` on the ground, x + i y in m."""
        pose = self.pose(dynamics)
        (x, y, _), axes = pose.translation.tolist(), pose.rotation[0] + 1j * pose.rotation[1]
        length, width = self.half[0] * axes[0], self.half[1] * axes[1]
        return [complex(x, y) + a * length + b * width for a in (1.0, -1.0) for b in (1.0, -1.0)]

    def at_rest(self, dynamics: Dynamics) -> Reference:
        """Return the reference of the frame at rest in its present pose."""
        return Reference(pin.SE3ToXYZQUAT(dynamics.placement(self.frame)), np.zeros(6), np.zeros(6))

    def swung(
        self, swing: Array, landing: Landing, slope: complex, ground: complex, clearance: float, elapsed: float,
        dt: float, lag: float,
    ) -> tuple[Array, complex, complex, Reference]:  # fmt: skip
        """Return the motion of a sole in the air, (3, 4), after one cycle, and the reference of the frame.

        The acceleration of the reference is planned for the time at which the torques act, after `lag`, s; its
        horizontal part, x + i y in m/s², is the second result. The slope of the sole, the third result, approaches that
        of the ground. Other arguments as of `moved`.
        """
        motion, out = np.empty((3, 4)), np.empty(19)
        acceleration, slope = move_sole(
            swing, landing.place, landing.height, landing.heading, landing.time, landing.speed, landing.roughness,
            clearance, elapsed, dt, DESCENT, lag, slope, ground, self.frame_in_sole, motion, out,
        )  # fmt: skip
        return motion, acceleration, slope, Reference(out[:7], out[7:13], out[13:])


def mean_angle(a: float, b: float) -> float:
    """Return the angle in the middle of the shorter way from one angle to another, rad."""
    return a + 0.5 * math.remainder(b - a, math.tau)


def swing_reaction(dynamics: Dynamics, stance: Foot, swing: Foot, height: float) -> float:
    """Return μ of the reaction of the centre of mass to a swing foot that moves forward.

    The inverted pendulum has no swing leg. With the sagittal component L of its angular momentum about the centre of
    mass, m z (c̈ - ω² (c - p)) = -L̇. L = λ ẋ for a foot that moves at ẋ gives c̈ = ω² (c - p) + μ ẍ with μ = -λ / (m z).
    In the nominal posture, the centre of mass, at the height z above the ground in m, and the base's orientation rest.
    """
    feet = [dynamics.jacobian(foot.frame, pin.LOCAL_WORLD_ALIGNED) for foot in (stance, swing)]
    rows = np.vstack([*feet, np.eye(6, dynamics.model.nv)[3:], dynamics.com_jacobian])
    wanted = np.zeros(len(rows))
    wanted[6] = 1.0  # ẋ of the swing foot
    joints = dynamics.model.pinocchio.frames
    columns = np.any([dynamics.moves[joints[foot.frame].parentJoint] for foot in (stance, swing)], axis=0)
    v = np.zeros(dynamics.model.nv)
    v[columns] = np.linalg.lstsq(rows[:, columns], wanted, rcond=None)[0]
    momentum = dynamics.centroidal_matrix @ v
    return float(-momentum[4] / (dynamics.model.mass * height))
