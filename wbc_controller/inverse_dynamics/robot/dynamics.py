"""Rigid-body dynamics at one state, and inverse inertia."""

from collections.abc import Sequence

import numpy as np
import pinocchio as pin
from numpy.lib.stride_tricks import as_strided
from scipy.linalg import null_space

from wbc_controller.inverse_dynamics.robot.link_motion_kernels import LinkMotion, link_terms
from wbc_controller.inverse_dynamics.robot.model import RobotModel
from wbc_controller.records import Array

_WORLD = pin.Convention.WORLD
_crba, _bias_forces = pin.crba, pin.nonLinearEffects


class Dynamics:
    """Terms of M(q) v̇ + h(q, v) = Sᵀτ + Σ Jᵢᵀfᵢ at one state (equations (7), (22), (34) of the note; S1).

    The arrays are overwritten by the next `update`. Drifts are accelerations at v̇ = 0.

    Attributes:
        h: bias forces: Coriolis, centrifugal and gravity terms minus passive joint forces, (nv,).
        com: centre of mass in the world, (3,) in m.
        com_velocity: (3,) in m/s.
        com_jacobian: (3, nv).
        com_drift: (3,) in m/s².
        centroidal_matrix: A_G of the centroidal momentum A_G v, world axes, (6, nv).
        centroidal_drift: Ȧ_G v, (6,) in N and N·m.
        joint_jacobians: unit twists of the joints at the world origin, world axes, linear rows first, (6, nv).
        moves: 1 if a component of v moves a link, (links, nv); link 0 is the world.
        motion: these arrays for `link_terms`.
        links: twist and drift of each link at the world origin, world axes, (links, 12).
        joints: placement of each link in the world: columns of the rotation, translation, (links, 12).
    """

    def __init__(self, model: RobotModel) -> None:
        self.model = model
        self._pin = model.pinocchio
        self._link_of = [frame.parentJoint for frame in model.pinocchio.frames]
        self._data = model.pinocchio.createData()
        self.q: Array
        self.v: Array
        data = self._data
        self._rotors, self._M = model.actuation.rotors, data.M
        # Separate: Pinocchio leaves entries of M between branches untouched, so rotors would accumulate.
        self.M: Array = data.M if self._rotors is None else np.zeros_like(data.M)
        self.M_rows: Array = self.M.T  # for compiled code: Pinocchio stores the symmetric M by columns
        self.h: Array = data.nle
        # A copy: unlike the other arrays, that of Pinocchio does not keep its data alive.
        self._com, self.com = data.com[0], np.zeros(3)
        self.com_velocity, self.com_drift, self.centroidal_drift = np.zeros(3), np.zeros(3), np.zeros(6)
        self._per_mass = np.zeros((6, model.nv), order="F")
        self.com_jacobian: Array = self._per_mass[:3]
        self.centroidal_matrix = _matrix(data.Ag)
        self.joint_jacobians: Array = _matrix(data.J)
        self.moves = support_matrix(model.pinocchio)
        self.links = np.zeros((model.pinocchio.njoints, 12))
        self.joints = view_of([placement.rotation for placement in data.oMi], 12)
        roots = np.flatnonzero(np.array(model.pinocchio.parents) == 0)[1:].astype(np.int64)
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
        """Compute all terms at a state, q (nq,) and v (nv,)."""
        self.compute(q, v)
        link_terms(self.motion, v)

    def compute(self, q: Array, v: Array) -> None:
        """Compute Pinocchio's terms; `link_terms` adds the others."""
        model, data = self._pin, self._data
        self.q, self.v = q, v
        # Also centre of mass, joint Jacobians and centroidal matrix.
        _crba(model, data, q, _WORLD)
        self.com[:] = self._com
        # At v̇ = 0, its link accelerations contain all drifts.
        _bias_forces(model, data, q, v)
        if self._rotors is not None:
            np.add(self._M, self._rotors, out=self.M)
        if self.model.passive is not None:
            self.h[self.model.passive.v_index] -= self.model.passive.torques(q, v)

    def place(self, geometry: pin.GeometryModel, placements: pin.GeometryData) -> None:
        """Compute the placements of shapes fixed to the links."""
        pin.updateGeometryPlacements(self._pin, self._data, geometry, placements)

    def placement(self, frame_id: int) -> pin.SE3:
        """Return the placement of a frame in the world; like the methods below, refuses an invalid id (IndexError)."""
        self._require_frame(frame_id)
        return pin.updateFramePlacement(self._pin, self._data, frame_id)

    def velocity(self, frame_id: int, axes: pin.ReferenceFrame) -> Array:
        """Return the spatial velocity of a frame, (6,), linear part first."""
        self._require_frame(frame_id)
        velocity: Array = pin.getFrameVelocity(self._pin, self._data, frame_id, axes).vector
        return velocity

    def jacobian(self, frame_id: int, axes: pin.ReferenceFrame) -> Array:
        """Return the Jacobian of a frame, (6, nv), linear rows first."""
        self._require_frame(frame_id)
        return _matrix(pin.getFrameJacobian(self._pin, self._data, frame_id, axes))

    def drift_local(self, frame_id: int) -> Array:
        """Return the spatial acceleration of a frame at v̇ = 0 in its own axes, (6,)."""
        placement = self.placement(frame_id)
        drift: Array = placement.actInv(pin.Motion(self.links[self._link_of[frame_id], 6:])).vector
        return drift

    def drift_world(self, frame_id: int) -> Array:
        """Return the classical acceleration of a frame at v̇ = 0 in world axes, (6,)."""
        placement = self.placement(frame_id)
        drift, twist = self.drift_local(frame_id), self.velocity(frame_id, pin.LOCAL_WORLD_ALIGNED)
        linear = placement.rotation @ drift[:3] + np.cross(twist[3:], twist[:3])
        return np.concatenate([linear, placement.rotation @ drift[3:]])

    def _require_frame(self, frame_id: int) -> None:
        """Refuse invalid frame ids: Pinocchio would read outside its memory."""
        count = len(self._link_of)
        if not 0 <= frame_id < count:
            raise IndexError(
                f"invalid frame id {frame_id}: the model has {count} frames; RobotModel.frame_id returns valid ids"
            )

    def external_force(self, frame: str, wrench: Array) -> Array:
        """Return the generalized force Jᵀw, (nv,), of a wrench w, (6,), at a frame's origin in world axes (S4)."""
        J = self.jacobian(self.model.frame_id(frame, "frame"), pin.LOCAL_WORLD_ALIGNED)
        return np.asarray(J.T @ wrench)


class Mobility:
    """Velocity change per generalized impulse: G (Gᵀ M G)⁻¹ Gᵀ with C G = 0 (`Actuation`), or M⁻¹ without followers."""

    def __init__(self, model: RobotModel) -> None:
        self._model, self._data = model, model.pinocchio.createData()
        coupling = model.actuation.C
        self._free = null_space(coupling) if len(coupling) else np.eye(model.nv)

    def __call__(self, q: Array) -> Array:
        """Return the matrix, (nv, nv), of a configuration, (nq,)."""
        M = np.triu(pin.crba(self._model.pinocchio, self._data, q))
        M += np.triu(M, 1).T
        if self._model.actuation.rotors is not None:
            M += self._model.actuation.rotors
        G = self._free
        return np.asarray(G @ np.linalg.solve(G.T @ M @ G, G.T))


def support_matrix(model: pin.Model) -> np.ndarray:
    """Return 1 if a component of v moves a link, else 0, (links, nv); link 0 is the world."""
    moves = np.zeros((model.njoints, model.nv), dtype=np.int8)
    for link, supports in enumerate(model.supports):
        for joint in (model.joints[i] for i in list(supports)[1:]):
            moves[link, joint.idx_v : joint.idx_v + joint.nv] = 1
    return moves


def view_of(parts: Sequence[Array], size: int) -> Array:
    """Return a read-only view (n, size) of n Pinocchio vectors that are contiguous in memory.

    `parts` are the first numbers of each vector. Raises `RuntimeError` for another memory layout.
    """
    flat = [part.reshape(-1, order="A") for part in parts]
    step = flat[0].itemsize
    table = as_strided(flat[0], (len(parts), size), (size * step, step), writeable=False)
    for row, part in zip(table, flat, strict=True):
        last = len(part) - 1
        if not (np.shares_memory(row[:1], part[:1]) and np.shares_memory(row[last : last + 1], part[last:])):
            raise RuntimeError(f"Pinocchio {pin.__version__} does not store vectors of {size} numbers contiguously")
    return table


def _matrix(J: Array) -> Array:
    """Return a (6, nv) matrix; Pinocchio returns (6,) for nv = 1."""
    return J if J.ndim == 2 else J[:, None]
