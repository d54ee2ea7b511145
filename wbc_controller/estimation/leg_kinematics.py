"""Positions of the contact points relative to the IMU, from the joint positions."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from wbc_controller.inverse_dynamics.arrays import cross
from wbc_controller.inverse_dynamics.contacts import Contact, FixedContact, PointContact, SurfaceContact
from wbc_controller.inverse_dynamics.robot.dynamics import Dynamics, support_matrix
from wbc_controller.inverse_dynamics.robot.model import RobotModel
from wbc_controller.records import Array

#: Points of a sole that are followed: three that are not on a line tell its orientation too.
_CORNERS = 3
#: The points of a link that is held, in the axes of the contact, m.
_ARM = 0.05 * np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])


@dataclass(frozen=True, slots=True)
class Sight:
    """The points of some contacts as seen from the IMU.

    Attributes:
        names: of the points, contact by contact, k of them.
        ends: after which of the points those of each contact end, (c,).
        places: their positions in the axes of the IMU, (k, 3) in m.
        covariance: of these positions, from noise of the joints' positions and of the points, (3 k, 3 k) in m².
        turning: angular velocity of each contact's link against the base, in the base's axes, (c, 3) in rad/s.
        rates: time derivatives of the positions, from the joint velocities, (k, 3) in m/s.
    """

    names: tuple[str, ...]
    ends: np.ndarray
    places: Array
    covariance: Array
    turning: Array
    rates: Array


@dataclass(frozen=True, slots=True)
class _Touch:
    """The points of some contacts.

    Attributes:
        names: of the points, contact by contact, k of them.
        joints: index of the joint that moves those of each contact, (c,).
        ends: after which of the points those of each contact end, (c,).
        points: their positions in the axes of that joint, (k, 3) in m.
    """

    names: tuple[str, ...]
    joints: np.ndarray
    ends: np.ndarray
    points: Array

    @property
    def links(self) -> np.ndarray:
        """Index of the joint that moves each point, (k,)."""
        return np.repeat(self.joints, np.diff(self.ends, prepend=0))

    @staticmethod
    def of(touches: Sequence[_Touch]) -> _Touch:
        """Several as one."""
        return _Touch(
            tuple(name for touch in touches for name in touch.names),
            np.array([touch.joints[0] for touch in touches], dtype=np.int64),
            np.cumsum([len(touch.names) for touch in touches], dtype=np.int64),
            np.concatenate([np.empty((0, 3)), *(touch.points for touch in touches)]),
        )


class LegKinematics:
    """Forward kinematics from the IMU to the points of contacts with the world.

    Wheels and contacts between two links of the robot have no points that stay where they are.

    Attributes:
        imu_frame: name of the IMU's frame.
        points: names of the points of each contact, by the contact's name.
        rolling: of contacts that are balls, the vector from the contact point to the centre, in the world, (3,) in m:
            their point is the centre, which moves as the ball rolls.
        soles: names of the contacts that are soles.
        imu_rotation: from the axes of the IMU to those of the base, (3, 3).
        imu_position: of the IMU in the base's axes, (3,) in m.
        imu_motion: twist of the IMU against the base, in the base's axes, (6,) in m/s and rad/s.
    """

    def __init__(
        self,
        model: RobotModel,
        contacts: Mapping[str, Contact],
        frames: Mapping[str, str],
        imu_frame: str,
        *,
        joint_noise: float,
        point_noise: float,
    ) -> None:
        """Find the points of the contacts.

        Args:
            model: the robot's model, with a floating base.
            frames: the link's frame of each contact, by name.
            imu_frame: the frame of the IMU.
            joint_noise: of the joints' positions, rad, one standard deviation.
            point_noise: of the position of a point beside that, such as from soft soles, m.

        Raises:
            ConfigurationError: where the model has no such frame.
        """
        self.imu_frame = imu_frame
        self._model = model
        self._pinocchio = model.pinocchio
        self._data = model.pinocchio.createData()
        frame = self._pinocchio.frames[model.frame_id(imu_frame, "estimation.imu_frame")]
        self._imu_joint, self._imu_placement = int(frame.parentJoint), frame.placement
        self._moves = support_matrix(self._pinocchio)
        self._q, self._v = pin.neutral(self._pinocchio), np.zeros(model.nv)
        self.imu_rotation, self.imu_position, self.imu_motion = np.eye(3), np.zeros(3), np.zeros(6)
        self._noise = joint_noise, point_noise
        self.points: dict[str, tuple[str, ...]] = {}
        self.rolling: dict[str, Array] = {}
        self.soles: tuple[str, ...] = ()
        self._touches: dict[str, _Touch] = {}
        self._together: dict[tuple[str, ...], _Touch] = {}
        self._sights: dict[tuple[str, ...], Sight] = {}  # at the joints' present state
        dynamics = Dynamics(model)
        for name, contact in contacts.items():
            if name not in frames or contact.internal:
                continue
            if isinstance(contact, SurfaceContact):
                corners = contact.points(dynamics)[:_CORNERS]
                self.soles += (name,)
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
            self.points[name] = tuple(f"{name}/{i}" for i in range(len(corners)))
            self._touches[name] = _Touch(
                self.points[name],
                np.array([int(frame.parentJoint)]),
                np.array([len(corners)]),
                np.array([to_joint.act(corner) for corner in corners]),
            )
        self.update(model.posture, np.zeros(model.nj))

    def update(self, q: Array, v: Array) -> None:
        """Take the joints' positions, (nj,) in rad, and velocities, (nj,) in rad/s."""
        model = self._model
        self._sights.clear()
        self._q[model.q_places], self._v[model.v_places] = q, v
        if model.followers is not None:
            model.followers.place(self._q)
            model.followers.move(self._v)
        pin.computeJointJacobians(self._pinocchio, self._data, self._q)
        imu = self._data.oMi[self._imu_joint] * self._imu_placement
        self.imu_rotation, self.imu_position = imu.rotation, imu.translation
        twist = self._data.J @ (self._moves[self._imu_joint] * self._v)  # at the base's origin; the base is at rest
        twist[:3] += cross(twist[3:], self.imu_position)
        self.imu_motion = twist

    def center_of_mass(self) -> Array:
        """Position of the centre of mass from the IMU and in its axes, (3,) in m."""
        center = pin.centerOfMass(self._pinocchio, self._data, self._q)
        return np.asarray((center - self.imu_position) @ self.imu_rotation)

    def frame(self, name: str, key: str) -> tuple[int, pin.SE3]:
        """The joint that moves a frame, and the frame's placement on it, for `from_imu`; the key names its setting.

        Raises:
            ConfigurationError: if the robot has no such frame.
        """
        frame = self._pinocchio.frames[self._model.frame_id(name, key)]
        return int(frame.parentJoint), frame.placement

    def from_imu(self, joint: int, placement: pin.SE3) -> pin.SE3:
        """The pose of a frame from the IMU and in its axes."""
        imu = self._data.oMi[self._imu_joint] * self._imu_placement
        return imu.actInv(self._data.oMi[joint] * placement)

    def sight(self, contacts: tuple[str, ...]) -> Sight:
        """The points of some contacts as seen from the IMU."""
        if contacts not in self._sights:
            self._sights[contacts] = self._look(contacts)
        return self._sights[contacts]

    def places(self, contacts: tuple[str, ...]) -> Array:
        """Positions of the points of some contacts, y = Rᵀ (r - p) in the axes of the IMU, (k, 3) in m."""
        return np.asarray((self._points(self._touch(contacts)) - self.imu_position) @ self.imu_rotation)

    def _touch(self, contacts: tuple[str, ...]) -> _Touch:
        if contacts not in self._together:
            self._together[contacts] = _Touch.of([self._touches[name] for name in contacts])
        return self._together[contacts]

    def _points(self, touch: _Touch) -> Array:
        """Positions of the points in the base's axes, (k, 3) in m."""
        placements = self._data.oMi
        return np.array(
            [placements[link].act(point) for link, point in zip(touch.links.tolist(), touch.points, strict=True)]
        )

    def _look(self, contacts: tuple[str, ...]) -> Sight:
        """Compute the points of some contacts in the axes of the IMU, y = Rᵀ (r - p), and the Jacobian ẏ = D v.

        With Δ the columns of the joints that move the point's link, minus those that move the IMU's link,
        D = Rᵀ (Δ_linear - r × Δ_angular).
        """
        touch, R, J = self._touch(contacts), self.imu_rotation, self._data.J
        k, links, r = len(touch.names), touch.links, self._points(touch)
        difference = J * (self._moves[links] - self._moves[self._imu_joint])[:, None]  # (k, 6, nv)
        D = (R.T @ (difference[:, :3] - hats(r) @ difference[:, 3:])).reshape(3 * k, -1)
        joint_noise, point_noise = self._noise
        return Sight(
            names=touch.names,
            ends=touch.ends,
            places=(r - self.imu_position) @ R,
            covariance=joint_noise**2 * D @ D.T + point_noise**2 * np.eye(3 * k),
            turning=(self._moves[touch.joints] * self._v) @ J[3:].T,
            rates=(D @ self._v).reshape(k, 3),
        )


def hats(vectors: Array) -> Array:
    """Return the matrices x × of some vectors, (k, 3): (k, 3, 3)."""
    x, y, z = vectors.T
    zero = np.zeros(len(vectors))
    return np.stack([zero, -z, y, z, zero, -x, -y, x, zero], axis=1).reshape(-1, 3, 3)
