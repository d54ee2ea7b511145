"""The floating-base dynamics at one state: the snapshot that tasks, contacts and limits share."""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin
from numpy.lib.stride_tricks import as_strided

from wbc_controller.core.robot.model import RobotModel
from wbc_controller.kernels.frames import link_motions
from wbc_controller.records import Array

_WORLD = pin.Convention.WORLD


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
        links: twist of each link at the world's origin, in world axes, and its spatial acceleration there at v̇ = 0,
            (links, 12).
        frames: placement of each frame in the world, (frames, 12): the columns of the rotation, then the translation.
        frame_links: the link that each frame is fixed to, (frames,).
    """

    def __init__(self, model: RobotModel) -> None:
        self.model = model
        self._pin = model.pinocchio
        self._data = model.pinocchio.createData()
        self._zero = np.zeros(model.nv)
        self._mass = float(pin.computeTotalMass(model.pinocchio))
        self.q: Array
        self.v: Array
        # Pinocchio never reallocates its data, so views of them can be kept.
        data = self._data
        self._rotors, self._M = model.actuation.rotors, data.M
        # M with rotors is a separate array: Pinocchio does not rewrite entries of data.M between joints of different
        # branches, so rotors added in place would accumulate.
        self.M: Array = data.M if self._rotors is None else np.zeros_like(data.M)
        self.h: Array = data.nle
        self.com: Array = data.com[0]
        self.com_velocity: Array = data.vcom[0]
        self._per_mass = np.zeros((6, model.nv), order="F")  # Pinocchio's memory order
        self.com_jacobian: Array = self._per_mass[:3]
        self.com_drift = np.zeros(3)
        self.centroidal_matrix = _matrix(data.Ag)
        self.centroidal_drift: Array = data.dhg.vector
        self._linear_drift = self.centroidal_drift[:3]
        self._placements: list[pin.SE3] = list(data.oMf)
        self.frames = placement_table(data.oMf)
        self.frame_links = np.array([frame.parentJoint for frame in model.pinocchio.frames], dtype=np.int64)
        self.joint_jacobians: Array = _matrix(data.J)
        self.moves = moved_by(model.pinocchio)
        self.links = np.zeros((model.pinocchio.njoints, 12))
        self._joints = placements(data)
        self._joint_motions = _table([v.vector for v in data.v], 6), _table([a.vector for a in data.a], 6)
        self.update(model.configuration(model.posture), np.zeros(model.nv))

    def update(self, q: Array, v: Array) -> None:
        """Compute all terms at a new state.

        Args:
            q: configuration, (nq,).
            v: generalized velocity, (nv,).
        """
        model, data = self._pin, self._data
        self.q, self.v = q, v
        # Separate calls instead of `computeAllTerms`, which takes a fifth longer. In the world convention `crba` also
        # computes the joint Jacobians and the centroidal matrix.
        pin.crba(model, data, q, _WORLD)
        # Second-order kinematics at v̇ = 0, where every acceleration equals its drift J̇v.
        pin.computeCentroidalMomentumTimeVariation(model, data, q, v, self._zero)
        pin.nonLinearEffects(model, data, q, v)
        pin.updateFramePlacements(model, data)
        if self._rotors is not None:
            np.add(self._M, self._rotors, out=self.M)
        if self.model.passive is not None:
            self.h[self.model.passive.v_index] -= self.model.passive.torques(q, v)
        np.divide(self.centroidal_matrix, self._mass, out=self._per_mass)
        np.divide(self._linear_drift, self._mass, out=self.com_drift)
        link_motions(self._joints, *self._joint_motions, self.links)

    def place(self, geometry: pin.GeometryModel, placements: pin.GeometryData) -> None:
        """Compute the placements of shapes that are fixed to the links."""
        pin.updateGeometryPlacements(self._pin, self._data, geometry, placements)

    def placement(self, frame_id: int) -> pin.SE3:
        """Placement of a frame in the world."""
        return self._placements[frame_id]

    def velocity(self, frame_id: int, axes: pin.ReferenceFrame) -> Array:
        """Spatial velocity of a frame, (6,), linear part first."""
        velocity: Array = pin.getFrameVelocity(self._pin, self._data, frame_id, axes).vector
        return velocity

    def jacobian(self, frame_id: int, axes: pin.ReferenceFrame) -> Array:
        """Jacobian of a frame, (6, nv), linear rows first."""
        return _matrix(pin.getFrameJacobian(self._pin, self._data, frame_id, axes))

    def drift_local(self, frame_id: int) -> Array:
        """Spatial acceleration of a frame at v̇ = 0, in its own axes, (6,): J̇v of its local velocity J v."""
        drift: Array = pin.getFrameAcceleration(self._pin, self._data, frame_id, pin.LOCAL).vector
        return drift

    def drift_world(self, frame_id: int) -> Array:
        """Classical acceleration of a frame's origin, and angular acceleration, at v̇ = 0, in world axes, (6,)."""
        axes = pin.LOCAL_WORLD_ALIGNED
        drift: Array = pin.getFrameClassicalAcceleration(self._pin, self._data, frame_id, axes).vector
        return drift

    def external_force(self, frame: str, wrench: Array) -> Array:
        """Generalized force of a known external wrench, Jᵀ w (equations (20) to (22) of the note; S4).

        Args:
            frame: name of the frame at whose origin the wrench acts.
            wrench: force in N and torque in N·m, in world axes, (6,).

        Returns:
            (nv,).
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


def placements(data: pin.Data) -> Array:
    """Placements of the links, (links, 12), in Pinocchio's memory: the rotation by columns, then the translation."""
    return placement_table(data.oMi)


def placement_table(placements: Any) -> Array:
    """Placements that Pinocchio keeps as a vector, (n, 12), in its memory: the rotation by columns, the translation."""
    return _table([placement.rotation for placement in placements], 12)


def _table(parts: list[Array], size: int) -> Array:
    """One read-only array, (n, size), over the memory of n parts that lie one after the other.

    Args:
        parts: the first numbers of each, in Pinocchio's memory.
        size: of each part.

    Raises:
        RuntimeError: where they do not lie so: this release of Pinocchio keeps them in another way.
    """
    places = [part.__array_interface__["data"][0] for part in parts]
    if any(after - before != 8 * size for before, after in zip(places, places[1:])):  # noqa: B905, RUF007
        raise RuntimeError(f"Pinocchio {pin.__version__} does not keep {size} numbers in one piece")
    flat = parts[0].reshape(-1, order="A")
    return as_strided(flat, (len(parts), size), (8 * size, 8), writeable=False)


def _matrix(J: Array) -> Array:
    """A matrix of (6, nv) as such: Pinocchio gives it as (6,) where nv is 1."""
    return J if J.ndim == 2 else J[:, None]
