"""Change of root link, order and direction of joints (Lemma 1, 2.1.2; S2)."""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
import pinocchio as pin

from wbc_controller.errors import ConfigurationError, require_known
from wbc_controller.mechanics.checks import joint_index
from wbc_controller.records import Array

_UNSIGNED = ("armature", "rotorInertia", "rotorGearRatio")  # joint parameters independent of the direction
#: Bounds that are negated and swapped for a flipped joint.
_VELOCITY_BOUNDS = (("lowerEffortLimit", "upperEffortLimit"), ("lowerVelocityLimit", "upperVelocityLimit"))


@dataclass(frozen=True)
class CoordinateChange:
    """Second model of a robot, and the map φ of Lemma 1 (equation (14)) from the original to the new coordinates."""

    original: pin.Model  # in the original coordinates
    model: pin.Model  # new model with the same names
    root: int  # original joint of the new base link; 0 for a fixed base
    signs: dict[str, float]  # 1, or -1 for flipped joints, by name

    def configuration(self, q: Array) -> Array:
        """Map a configuration, (nq,), by φ."""
        moved = np.array(pin.neutral(self.model))
        if self.root:
            data = self.original.createData()
            pin.forwardKinematics(self.original, data, q)
            moved[:7] = pin.SE3ToXYZQUAT(data.oMi[self.root])
        for name, sign in self.signs.items():
            old, new = self._joints(name)
            signs = [sign] if old.nq == 1 else [1.0, sign]  # of cosine and sine
            moved[new.idx_q : new.idx_q + old.nq] = signs * q[old.idx_q : old.idx_q + old.nq]
        return moved

    def jacobian(self, q: Array) -> Array:
        """Return T = ∂φ/∂q of Lemma 1, (nv, nv)."""
        T = np.zeros((self.model.nv, self.original.nv))
        if self.root:
            T[:6] = pin.computeJointJacobian(self.original, self.original.createData(), q, self.root)
        for name, sign in self.signs.items():
            old, new = self._joints(name)
            T[new.idx_v, old.idx_v] = sign
        return T

    def velocity(self, q: Array, v: Array) -> Array:
        """Map a generalized velocity, (nv,): T v."""
        return np.asarray(self.jacobian(q) @ v)

    def acceleration(self, q: Array, v: Array, v_dot: Array) -> Array:
        """Map a generalized acceleration, (nv,): T v̇ + Ṫ v (equation (12))."""
        moved = self.jacobian(q) @ v_dot
        if self.root:
            data = self.original.createData()
            pin.forwardKinematics(self.original, data, q, v, v_dot)
            moved[:6] = data.a[self.root].vector
        return np.asarray(moved)

    def force(self, q: Array, force: Array) -> Array:
        """Map a generalized force, (nv,) in N and N·m, with equal work (equation (21))."""
        return np.linalg.solve(self.jacobian(q).T, force)

    def _joints(self, name: str) -> tuple[Any, Any]:
        return (self.original.joints[self.original.getJointId(name)], self.model.joints[self.model.getJointId(name)])


def change_coordinates(
    model: pin.Model, *, root: str | None = None, flip: Iterable[str] = (), shuffle: int | None = None
) -> CoordinateChange:
    """Return a model of the same robot in other coordinates (section 2.1.2; S2), in the same units.

    Args:
        model: robot; all joints except a floating base have one degree of freedom.
        root: joint of the new base link; None for the same base.
        flip: joints with reversed direction.
        shuffle: seed of a random joint order, or None.

    Raises:
        ConfigurationError: if a joint is unknown or unsupported, or the base is fixed and `root` is given.
    """
    floating = model.njoints > 1 and model.joints[1].nq == 7
    if root is not None and not floating:
        raise ConfigurationError(
            f"root = {root!r}: the base is fixed to the world; only a floating base has a new root"
        )
    names = list(model.names)
    first = 1 if floating else 0
    flipped = set(flip)
    require_known(sorted(flipped), names[first + 1 :], "flip: unknown joint")
    new_root = joint_index(model, root) if root is not None else first
    axes = _axes(model, first)
    order = np.random.default_rng(shuffle)

    moved = pin.Model()
    moved.gravity = model.gravity
    moved.name = model.name
    # New joint of each link, and old frame in the new joint's frame.
    links: dict[int, tuple[int, pin.SE3]] = {0: (0, pin.SE3.Identity())}
    if floating:
        base = moved.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), names[1])
        links[new_root] = (base, pin.SE3.Identity())

    def attach(link: int) -> None:
        """Add the joints of a link, away from the root."""
        at, shift = links[link]
        around = [j for j in range(first + 1, model.njoints) if link in (j, model.parents[j])]
        if shuffle is not None:
            around = [around[i] for i in order.permutation(len(around))]
        for j in around:
            sign = -1.0 if names[j] in flipped else 1.0
            backwards = link == j
            other = int(model.parents[j]) if backwards else j
            if other in links:
                continue
            # Traversed from child to parent, a joint rotates in the opposite direction.
            axis = (-sign if backwards else sign) * axes[j]
            placement = shift if backwards else shift * model.jointPlacements[j]
            joint = moved.addJoint(at, _joint(axis, model.joints[j].nq), placement, names[j])
            links[other] = (joint, model.jointPlacements[j].inverse() if backwards else pin.SE3.Identity())
            attach(other)

    attach(new_root)
    for link, (joint, shift) in links.items():
        moved.appendBodyToJoint(joint, model.inertias[link], shift)
    for frame in list(model.frames)[1:]:
        joint, shift = links[frame.parentJoint]
        moved.addFrame(pin.Frame(frame.name, joint, 0, shift * frame.placement, frame.type), False)
    signs = {name: -1.0 if name in flipped else 1.0 for name in names[first + 1 :]}
    result = CoordinateChange(original=model, model=moved, root=new_root if floating else 0, signs=signs)
    _copy_bounds(result)
    return result


def _axes(model: pin.Model, first: int) -> dict[int, Array]:
    """Return the motion subspace of each joint, (6,), in its own frame."""
    data = model.createData()
    pin.computeJointJacobians(model, data, pin.neutral(model))
    axes = {}
    for j in range(first + 1, model.njoints):
        joint = model.joints[j]
        axis = np.zeros(6)
        if joint.nv == 1:
            axis = np.array(pin.getJointJacobian(model, data, j, pin.LOCAL))[:, joint.idx_v]
        sizes = np.linalg.norm(axis.reshape(2, 3), axis=1)
        if not (joint.nv == 1 and joint.nq <= 2 and min(sizes) < 1.0e-12 and abs(max(sizes) - 1.0) < 1.0e-9):
            raise ConfigurationError(
                f"joint {model.names[j]!r} has type {joint.shortname()}, expected revolute or prismatic"
            )
        axes[j] = axis
    return axes


def _joint(axis: Array, nq: int) -> Any:
    if axis[:3].any():
        return pin.JointModelPrismaticUnaligned(axis[:3])
    return (pin.JointModelRevoluteUnaligned if nq == 1 else pin.JointModelRevoluteUnboundedUnaligned)(axis[3:])


def _copy_bounds(change: CoordinateChange) -> None:
    original, model = change.original, change.model
    for name, sign in change.signs.items():
        old, new = change._joints(name)
        for attribute in _UNSIGNED:
            getattr(model, attribute)[new.idx_v] = getattr(original, attribute)[old.idx_v]
        places = [(*pair, old.idx_v, new.idx_v) for pair in _VELOCITY_BOUNDS]
        if old.nq == 1:  # otherwise cosine and sine
            places.append(("lowerPositionLimit", "upperPositionLimit", old.idx_q, new.idx_q))
        for lower, upper, i, j in places:
            ends = sorted(sign * getattr(original, bound)[i] for bound in (lower, upper))
            getattr(model, lower)[j], getattr(model, upper)[j] = ends
