"""Kinematics of contacts relative to the IMU."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from wbc_controller.inverse_dynamics.arrays import cross
from wbc_controller.inverse_dynamics.contacts import Contact, FixedContact, PointContact, SurfaceContact
from wbc_controller.inverse_dynamics.robot.dynamics import Dynamics, support_matrix
from wbc_controller.inverse_dynamics.robot.instruction import placement_on_link
from wbc_controller.inverse_dynamics.robot.model import RobotModel
from wbc_controller.records import Array

_SOLE_POINTS = 3  # tracked points of a sole; three determine its orientation
#: Tracked points of a held link, in contact axes, m.
_ARM = 0.05 * np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])


@dataclass(frozen=True, slots=True)
class ContactPoints:
    """Measured points of c contacts, k in all, relative to the IMU."""

    names: tuple[str, ...]  # by contact
    ends: np.ndarray  # index after each contact's last point, (c,)
    positions: Array  # y in IMU axes, (k, 3) in m
    covariance: Array  # of y, (3 k, 3 k) in m²
    link_angular_velocities: Array  # relative to the base in base axes, (c, 3) in rad/s
    velocities: Array  # ẏ by the joint velocities, (k, 3) in m/s


@dataclass(frozen=True, slots=True)
class _PointSet:
    names: tuple[str, ...]
    ends: np.ndarray
    links: list[int]
    points: Array  # in joint axes, m
    moves: Array  # rows of `support_matrix`, (c, nv)
    signs: Array  # by point, minus the IMU's, (k, 1, nv)
    noise: Array  # covariance, m²


class LegKinematics:
    """Forward kinematics from the IMU to contact points in the world; wheels and internal contacts have none.

    Attributes:
        points: names by contact.
        rolling: vector from contact point to centre of each ball in the world, (3,) in m; the centre is tracked.
        corners: weights of the points in each corner of a sole, (n, 3).
        imu_rotation: from IMU to base axes, (3, 3).
        imu_position: of the IMU in base axes, (3,) in m.
        imu_motion: twist of the IMU relative to the base in base axes, (6,) in m/s and rad/s.
    """

    def __init__(
        self, model: RobotModel, contacts: Mapping[str, Contact], frames: Mapping[str, str], imu_frame: str, *,
        joint_noise: float, point_noise: float,
    ) -> None:  # fmt: skip
        """Collect the contact points; `frames` are those of the links, the noises standard deviations, rad and m."""
        self.imu_frame, self._noise = imu_frame, (joint_noise, point_noise)
        self._model, self._pinocchio, self._data = model, model.pinocchio, model.pinocchio.createData()
        self._imu_joint, self._imu_placement = self.frame(imu_frame, "estimation.imu_frame")
        self._moves = support_matrix(self._pinocchio)
        self._q, self._v = pin.neutral(self._pinocchio), np.zeros(model.nv)
        self.points: dict[str, tuple[str, ...]] = {}
        self.rolling: dict[str, Array] = {}
        self.corners: dict[str, Array] = {}
        self._contacts: dict[str, tuple[int, Array]] = {}  # joint, points
        self._point_sets: dict[tuple[str, ...], _PointSet] = {}
        self._cache: dict[tuple[str, ...], ContactPoints] = {}  # at the joints' present state
        dynamics = Dynamics(model)
        for name, contact in contacts.items():
            if name not in frames or contact.internal:
                continue
            if isinstance(contact, SurfaceContact):
                support = contact.points(dynamics)
                corners = support[:_SOLE_POINTS]
                extended = np.column_stack([support, np.ones(len(support))]).T  # weights have the sum 1
                self.corners[name] = np.linalg.lstsq(extended[:, :_SOLE_POINTS], extended)[0].T
            elif isinstance(contact, FixedContact):
                corners = np.array([contact.placement(dynamics).act(offset) for offset in _ARM])
            elif isinstance(contact, PointContact) and contact.ball:
                self.rolling[name] = contact.radius * contact.axes(dynamics)[:, 2]
                corners = contact.points(dynamics) + self.rolling[name]
            else:
                continue
            link = model.frame_id(frames[name], f"contacts.{name}.frame")
            joint, placement = placement_on_link(model, link)
            to_joint = placement * dynamics.placement(link).inverse()
            self.points[name] = tuple(f"{name}/{i}" for i in range(len(corners)))
            self._contacts[name] = joint, np.array([to_joint.act(corner) for corner in corners])
        self.update(model.posture, np.zeros(model.nj))

    def update(self, q: Array, v: Array) -> None:
        """Set the joint positions and velocities, (nj,)."""
        model = self._model
        self._cache.clear()
        self._q[model.q_places], self._v[model.v_places] = q, v
        if model.followers is not None:
            model.followers.place(self._q)
            model.followers.move(self._v)
        pin.computeJointJacobians(self._pinocchio, self._data, self._q)
        self._imu = self._data.oMi[self._imu_joint] * self._imu_placement
        self.imu_rotation, self.imu_position = self._imu.rotation, self._imu.translation
        twist = self._data.J @ (self._moves[self._imu_joint] * self._v)  # at the base's origin; the base is at rest
        twist[:3] += cross(twist[3:], self.imu_position)
        self.imu_motion = twist

    def center_of_mass(self) -> Array:
        """Return the centre of mass in IMU axes, (3,) in m."""
        center = pin.centerOfMass(self._pinocchio, self._data, self._q)
        return np.asarray((center - self.imu_position) @ self.imu_rotation)

    def frame(self, name: str, key: str) -> tuple[int, pin.SE3]:
        """Return the joint of a frame and its placement there; `key` is the setting in a ConfigurationError."""
        return placement_on_link(self._model, self._model.frame_id(name, key))

    def from_imu(self, joint: int, placement: pin.SE3) -> pin.SE3:
        """Return the placement of a frame relative to the IMU."""
        return self._imu.actInv(self._data.oMi[joint] * placement)

    def contact_points(self, contacts: tuple[str, ...]) -> ContactPoints:
        """Return the points of some contacts: y = Rᵀ (r - p) and ẏ = D v, D = Rᵀ (Δ_linear - r × Δ_angular).

        Δ are the columns of joints that move the point's link, minus columns that move the IMU's link.
        """
        if contacts in self._cache:
            return self._cache[contacts]
        point_set, R, J = self._point_set(contacts), self.imu_rotation, self._data.J
        k, r = len(point_set.names), self._points(point_set)
        difference = J * point_set.signs  # (k, 6, nv)
        D = (R.T @ (difference[:, :3] - hats(r) @ difference[:, 3:])).reshape(3 * k, -1)
        found = self._cache[contacts] = ContactPoints(
            names=point_set.names,
            ends=point_set.ends,
            positions=(r - self.imu_position) @ R,
            covariance=self._noise[0] ** 2 * D @ D.T + point_set.noise,
            link_angular_velocities=(point_set.moves * self._v) @ J[3:].T,
            velocities=(D @ self._v).reshape(k, 3),
        )
        return found

    def positions(self, contacts: tuple[str, ...]) -> Array:
        """Return y of some contacts in IMU axes, (k, 3) in m."""
        return np.asarray((self._points(self._point_set(contacts)) - self.imu_position) @ self.imu_rotation)

    def _point_set(self, contacts: tuple[str, ...]) -> _PointSet:
        if contacts not in self._point_sets:
            joints = np.array([self._contacts[name][0] for name in contacts], dtype=np.int64)
            counts = [len(self.points[name]) for name in contacts]
            moves = self._moves[joints].astype(np.float64)
            self._point_sets[contacts] = _PointSet(
                names=tuple(point for name in contacts for point in self.points[name]),
                ends=np.cumsum(counts, dtype=np.int64),
                links=np.repeat(joints, counts).tolist(),
                points=np.concatenate([np.empty((0, 3)), *(self._contacts[name][1] for name in contacts)]),
                moves=moves,
                signs=np.repeat(moves - self._moves[self._imu_joint], counts, axis=0)[:, None],
                noise=self._noise[1] ** 2 * np.eye(3 * sum(counts)),
            )
        return self._point_sets[contacts]

    def _points(self, point_set: _PointSet) -> Array:
        placements, pairs = self._data.oMi, zip(point_set.links, point_set.points, strict=True)
        return np.array([placements[link].act(point) for link, point in pairs])


def hats(vectors: Array) -> Array:
    """Return the cross-product matrices of vectors, (k, 3): (k, 3, 3)."""
    x, y, z = vectors.T
    matrices = np.zeros((len(vectors), 3, 3))
    matrices[:, 0, 1], matrices[:, 0, 2], matrices[:, 1, 2] = -z, y, -x
    matrices[:, 1, 0], matrices[:, 2, 0], matrices[:, 2, 1] = z, -y, x
    return matrices
