"""The floating-base dynamics at one state: the snapshot that tasks, contacts and limits share."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pinocchio as pin
from numpy.lib.stride_tricks import as_strided

from wbc_controller.inverse_dynamics.robot.link_motion_kernels import LinkMotion, link_terms
from wbc_controller.inverse_dynamics.robot.model import RobotModel
from wbc_controller.records import Array

_WORLD = pin.Convention.WORLD
# Looked up once: the module has thousands of names.
_crba, _bias_forces = pin.crba, pin.nonLinearEffects


class Dynamics:
    """Terms of M(q) v̇ + h(q, v) = Sᵀτ + Σ Jᵢᵀfᵢ at one state (equations (7), (22), (34) of the note; S1).

    The arrays are Pinocchio's own and are overwritten by the next `update`: copy them to keep their values.

    Attributes:
        model: the robot's model.
        q: configuration, (nq,).
        v: generalized velocity, (nv,).
        M: joint-space inertia matrix, (nv, nv), symmetric.
        h: Coriolis, centrifugal and gravity terms, less the forces of passive joints' springs and dampers, (nv,).
        com: position of the centre of mass in the world, (3,) in m.
        com_velocity: its velocity in the world, (3,) in m/s.
        com_jacobian: (3, nv), so that com_velocity = com_jacobian v.
        com_drift: acceleration of the centre of mass at v̇ = 0, (3,) in m/s².
        centroidal_matrix: A_G, (6, nv), so that the momentum about the centre of mass, in world axes, is A_G v.
        centroidal_drift: rate of that momentum at v̇ = 0, (6,) in N and N·m.
        joint_jacobians: columns of the joint twists at the world's origin, in world axes, (6, nv), linear rows first. A
            link's twist is the sum over the joints between base and link of their columns times their velocities.
        moves: 1 where a component of v moves a link, (links, nv); the first link is the world.
        motion: these arrays for `robot.link_motion_kernels.link_terms`.
        links: twist of each link at the world's origin, in world axes, and its spatial acceleration there at v̇ = 0,
            (links, 12).
        joints: placement of each link in the world, (links, 12): the columns of the rotation, then the translation.
    """

    def __init__(self, model: RobotModel) -> None:
        self.model = model
        self._pin = model.pinocchio
        self._link_of = [frame.parentJoint for frame in model.pinocchio.frames]
        self._data = model.pinocchio.createData()
        self.q: Array
        self.v: Array
        # Pinocchio never reallocates its data, so views of them can be kept.
        data = self._data
        self._rotors, self._M = model.actuation.rotors, data.M
        # M with rotors is a separate array: Pinocchio does not rewrite entries of data.M between joints of different
        # branches, so rotors added in place would accumulate.
        self.M: Array = data.M if self._rotors is None else np.zeros_like(data.M)
        #: M row by row, as compiled code reads it: Pinocchio has it by columns, and it is symmetric.
        self.M_rows: Array = self.M.T
        self.h: Array = data.nle
        self.com: Array = data.com[0]
        self.com_velocity, self.com_drift, self.centroidal_drift = np.zeros(3), np.zeros(3), np.zeros(6)
        self._per_mass = np.zeros((6, model.nv), order="F")  # Pinocchio's memory order
        self.com_jacobian: Array = self._per_mass[:3]
        self.centroidal_matrix = _matrix(data.Ag)
        self.joint_jacobians: Array = _matrix(data.J)
        self.moves = moved_by(model.pinocchio)
        self.links = np.zeros((model.pinocchio.njoints, 12))
        self.joints = view_of([placement.rotation for placement in data.oMi], 12)
        roots = np.flatnonzero(np.array(model.pinocchio.parents) == 0)[1:].astype(np.int64)  # the first is the world
        self.motion = LinkMotion(
            joints=self.joints,
            local_twists=view_of([twist.vector for twist in data.v], 6),
            local_accelerations=view_of([acceleration.vector for acceleration in data.a_gf], 6),
            wrenches=view_of([wrench.vector for wrench in data.f], 6),
            roots=roots,
            gravity=model.pinocchio.gravity.linear.copy(),
            mass=pin.computeTotalMass(model.pinocchio),
            com=self.com,
            centroidal=self.centroidal_matrix.T,
            joint_twists=self.joint_jacobians.T,
            moves=self.moves,
            links=self.links,
            per_mass=self._per_mass.T,
            com_velocity=self.com_velocity,
            com_drift=self.com_drift,
            drift=self.centroidal_drift,
        )
        self.update(model.configuration(model.posture), np.zeros(model.nv))

    def update(self, q: Array, v: Array) -> None:
        """Compute all terms at a new state, q (nq,) and v (nv,)."""
        self.compute(q, v)
        link_terms(self.motion, v)

    def compute(self, q: Array, v: Array) -> None:
        """Compute M, h and the other terms of Pinocchio at a new state; `link_terms` completes them."""
        model, data = self._pin, self._data
        self.q, self.v = q, v
        # In the world convention `crba` also has the centre of mass, the joint Jacobians and the centroidal matrix.
        _crba(model, data, q, _WORLD)
        # Its pass at v̇ = 0 has all drifts J̇v: `link_terms` takes them from there.
        _bias_forces(model, data, q, v)
        if self._rotors is not None:
            np.add(self._M, self._rotors, out=self.M)
        if self.model.passive is not None:
            self.h[self.model.passive.v_index] -= self.model.passive.torques(q, v)

    def place(self, geometry: pin.GeometryModel, placements: pin.GeometryData) -> None:
        """Compute the placements of shapes that are fixed to the links."""
        pin.updateGeometryPlacements(self._pin, self._data, geometry, placements)

    def placement(self, frame_id: int) -> pin.SE3:
        """Placement of a frame in the world.

        Raises:
            IndexError: if the model has no such frame; likewise in the methods below.
        """
        self._require_frame(frame_id)
        return pin.updateFramePlacement(self._pin, self._data, frame_id)

    def velocity(self, frame_id: int, axes: pin.ReferenceFrame) -> Array:
        """Spatial velocity of a frame, (6,), linear part first."""
        self._require_frame(frame_id)
        velocity: Array = pin.getFrameVelocity(self._pin, self._data, frame_id, axes).vector
        return velocity

    def jacobian(self, frame_id: int, axes: pin.ReferenceFrame) -> Array:
        """Jacobian of a frame, (6, nv), linear rows first."""
        self._require_frame(frame_id)
        return _matrix(pin.getFrameJacobian(self._pin, self._data, frame_id, axes))

    def drift_local(self, frame_id: int) -> Array:
        """Spatial acceleration of a frame at v̇ = 0, in its own axes, (6,): J̇v of its local velocity J v."""
        placement = self.placement(frame_id)
        drift: Array = placement.actInv(pin.Motion(self.links[self._link_of[frame_id], 6:])).vector
        return drift

    def drift_world(self, frame_id: int) -> Array:
        """Classical acceleration of a frame's origin, and angular acceleration, at v̇ = 0, in world axes, (6,)."""
        placement = self.placement(frame_id)
        drift, twist = self.drift_local(frame_id), self.velocity(frame_id, pin.LOCAL_WORLD_ALIGNED)
        linear = placement.rotation @ drift[:3] + np.cross(twist[3:], twist[:3])
        return np.concatenate([linear, placement.rotation @ drift[3:]])

    def _require_frame(self, frame_id: int) -> None:
        """Require a frame to exist: Pinocchio reads beyond its memory for others."""
        if not 0 <= frame_id < len(self._link_of):
            count = len(self._link_of)
            raise IndexError(
                f"frame {frame_id}, but the model has {count} frames; RobotModel.frame_id finds them by name"
            )

    def external_force(self, frame: str, wrench: Array) -> Array:
        """Generalized force of a known external wrench, Jᵀ w, (nv,) (equations (20) to (22) of the note; S4).

        The wrench, (6,) in N and N·m in world axes, acts at the origin of the frame.
        """
        J = self.jacobian(self.model.frame_id(frame, "frame"), pin.LOCAL_WORLD_ALIGNED)
        return np.asarray(J.T @ wrench)


def moved_by(model: pin.Model) -> np.ndarray:
    """1 where a component of v moves a link, (links, nv); the first link is the world."""
    moves = np.zeros((model.njoints, model.nv), dtype=np.int8)
    for link, supports in enumerate(model.supports):
        for joint in (model.joints[i] for i in list(supports)[1:]):
            moves[link, joint.idx_v : joint.idx_v + joint.nv] = 1
    return moves


def view_of(parts: Sequence[Array], size: int) -> Array:
    """Return a read-only view, (n, size), of n vectors of Pinocchio, which a `std::vector` stores one after the other.

    Args:
        parts: the first numbers of each vector: of a placement its rotation, which the translation follows.
        size: numbers of each vector.

    Raises:
        RuntimeError: if this release of Pinocchio stores them in another way.
    """
    flat = [part.reshape(-1, order="A") for part in parts]
    step = flat[0].itemsize
    table = as_strided(flat[0], (len(parts), size), (size * step, step), writeable=False)
    for row, part in zip(table, flat, strict=True):
        last = len(part) - 1
        if not (np.shares_memory(row[:1], part[:1]) and np.shares_memory(row[last : last + 1], part[last:])):
            raise RuntimeError(f"Pinocchio {pin.__version__} does not store vectors of {size} numbers in one piece")
    return table


def _matrix(J: Array) -> Array:
    """A matrix of (6, nv) as such: Pinocchio gives it as (6,) where nv is 1."""
    return J if J.ndim == 2 else J[:, None]
