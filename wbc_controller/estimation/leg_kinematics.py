"""Where contact points are seen from the IMU, by the joints alone."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from wbc_controller.core.contacts import Contact, FixedContact, PointContact, SurfaceContact
from wbc_controller.core.robot.dynamics import Dynamics, moved_by, placements
from wbc_controller.core.robot.model import RobotModel
from wbc_controller.estimation.invariant_filter import hat
from wbc_controller.kernels.frames import sight
from wbc_controller.records import Array

#: Points of a sole that are followed: three that are not on a line tell its orientation too.
_CORNERS = 3
#: The points of a link that is held, in the axes of the contact, m.
_ARM = 0.05 * np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])


@dataclass(frozen=True, slots=True)
class Sight:
    """Contact points as seen from the IMU.

    Attributes:
        places: their positions in the axes of the IMU, (k, 3) in m.
        jacobian: of these positions with respect to the positions of the joints and their followers, (3 k, nv - 6).
        turning: angular velocity of their link against the base, in the base's axes, (3,) in rad/s.
    """

    places: Array
    jacobian: Array
    turning: Array


@dataclass(frozen=True, slots=True)
class _Touch:
    """The points of one contact.

    Attributes:
        joint: index of the joint that moves them.
        points: their positions in its axes, (k, 3) in m.
    """

    joint: int
    points: Array


class LegKinematics:
    """Forward kinematics from the IMU to the points of contacts with the world.

    Wheels and contacts between two links of the robot have no points that stay where they are.

    Attributes:
        imu_frame: name of the IMU's frame.
        points: names of the points of each contact, by the contact's name.
        rolling: of contacts that are balls, the vector from the contact point to the centre, in the world, (3,) in m:
            their point is the centre, which moves as the ball rolls.
        imu_rotation: from the axes of the IMU to those of the base, (3, 3).
        imu_position: of the IMU in the base's axes, (3,) in m.
    """

    def __init__(
        self, model: RobotModel, contacts: Mapping[str, Contact], frames: Mapping[str, str], imu_frame: str
    ) -> None:
        """Find the points of the contacts.

        Args:
            model: the robot's model, with a floating base.
            contacts: the contacts, by name.
            frames: the link's frame of each contact, by name.
            imu_frame: the frame of the IMU.

        Raises:
            ConfigurationError: where the model has no such frame.
        """
        self.imu_frame = imu_frame
        self._model = model
        self._pinocchio = model.pinocchio
        self._data = model.pinocchio.createData()
        frame = self._pinocchio.frames[model.frame_id(imu_frame, "estimation.imu_frame")]
        self._imu_joint, self._imu_placement = int(frame.parentJoint), frame.placement
        self._links, self._moves = placements(self._data), moved_by(self._pinocchio)
        self._q, self._v = pin.neutral(self._pinocchio), np.zeros(model.nv)
        self.points: dict[str, tuple[str, ...]] = {}
        self.rolling: dict[str, Array] = {}
        self._touches: dict[str, _Touch] = {}
        self._sights: dict[str, Sight] = {}  # at the joints' present state
        dynamics = Dynamics(model)
        for name, contact in contacts.items():
            if name not in frames or contact.internal:
                continue
            if isinstance(contact, SurfaceContact):
                corners = contact.points(dynamics)[:_CORNERS]
            elif isinstance(contact, FixedContact):
                corners = np.array([contact.placement(dynamics).act(offset) for offset in _ARM])
            elif isinstance(contact, PointContact) and contact.ball:
                self.rolling[name] = contact.radius * contact.axes(dynamics)[:, 2]
                corners = contact.points(dynamics) + self.rolling[name]
            else:
                continue
            link = model.frame_id(frames[name], f"contacts.{name}.frame")
            frame = self._pinocchio.frames[link]
            to_joint = frame.placement * dynamics.placement(link).inverse()
            self._touches[name] = _Touch(int(frame.parentJoint), np.array([to_joint.act(corner) for corner in corners]))
            self.points[name] = tuple(f"{name}/{i}" for i in range(len(corners)))
        self.update(model.posture, np.zeros(model.nj))

    def update(self, q: Array, v: Array) -> None:
        """Take the joints' state.

        Args:
            q: positions of the joints, (nj,) in rad.
            v: velocities of the joints, (nj,) in rad/s.
        """
        model = self._model
        self._sights.clear()
        self._q[model.q_index], self._v[model.v_index] = q, v
        if model.followers is not None:
            model.followers.place(self._q)
            model.followers.move(self._v)
        pin.computeJointJacobians(self._pinocchio, self._data, self._q)
        imu = self._data.oMi[self._imu_joint] * self._imu_placement
        self.imu_rotation, self.imu_position = np.array(imu.rotation), np.array(imu.translation)
        self._imu = np.concatenate([self.imu_rotation.T.ravel(), self.imu_position])

    def frame(self, name: str, key: str) -> tuple[int, pin.SE3]:
        """The joint that moves a frame, and where the frame is on it, for `from_imu`.

        Args:
            name: of the frame.
            key: the setting that names it.

        Raises:
            ConfigurationError: where the robot has no such frame.
        """
        frame = self._pinocchio.frames[self._model.frame_id(name, key)]
        return int(frame.parentJoint), frame.placement

    def from_imu(self, joint: int, placement: pin.SE3) -> pin.SE3:
        """The pose of a frame from the IMU and in its axes."""
        imu = self._data.oMi[self._imu_joint] * self._imu_placement
        return imu.actInv(self._data.oMi[joint] * placement)

    def imu_motion(self) -> tuple[Array, Array]:
        """Linear and angular velocity of the IMU against the base, in the base's axes, both (3,), in m/s and rad/s."""
        # of its link, at the base's origin
        twist = self._data.J[:, 6:] @ (self._moves[self._imu_joint, 6:] * self._v[6:])
        return twist[:3] - hat(self.imu_position) @ twist[3:], twist[3:]

    def sight(self, contact: str) -> Sight:
        """The points of a contact as seen from the IMU."""
        if contact not in self._sights:
            self._sights[contact] = self._look(contact)
        return self._sights[contact]

    def _look(self, contact: str) -> Sight:
        touch = self._touches[contact]
        k = len(touch.points)
        seen = Sight(np.empty((k, 3)), np.empty((3 * k, self._model.nv - 6)), np.empty(3))
        sight(
            self._links, self._data.J, self._moves, touch.joint, self._imu_joint, self._imu, touch.points, self._v,
            seen.places, seen.jacobian, seen.turning,
        )  # fmt: skip
        return seen
