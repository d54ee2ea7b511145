"""The equations of motion of a recording, linear in masses, frictions and armature.

At every moment M v̇ + h = Sᵀτ + Jᵀf - c sign(v) - b v (S1 of the note). The left side is linear in the inertias of the
links, Y(q, v, v̇) π (Atkeson, An, Hollerbach, "Estimation of inertial parameters of manipulator loads and links", IJRR
1986), and in the armature. With the inertia of each link in proportion to its mass, π = Σ μᵢ πᵢ, the unknowns are

    θ = [μ of each link, armature, c of each joint, b of each joint].

The forces of the contacts are not measured. Multiplied by a basis Z of the motions that the contacts allow, J Z = 0,
the equations have none of them (d'Alembert's principle, equations (17) to (19); S3). The friction of a joint that rests
can be anything up to c: it is taken out in the same way.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from wbc_controller.errors import ConfigurationError
from wbc_controller.inverse_dynamics.contacts import Contact
from wbc_controller.inverse_dynamics.robot.dynamics import Dynamics
from wbc_controller.inverse_dynamics.robot.model import RobotModel
from wbc_controller.records import Array

#: Width of the line that gives accelerations, and time between two moments, s.
WIDTH, _EVERY = 0.03, 0.02
#: Moments that make a stretch.
_TOGETHER = 25
#: Speed below which a joint rests, rad/s or m/s.
_RESTS = 0.03


@dataclass(frozen=True, slots=True)
class Moments:
    """Moments of a recording, smoothed."""

    q: Array  # (n, nq)
    v: Array  # (n, nv)
    v_dot: Array  # (n, nv)
    tau: Array  # (n, na) in N·m
    turns: Array  # sign of each joint's velocity, (n, nj); 0 where it rests or turns round about then
    contacts: tuple[tuple[str, ...], ...]  # the contacts that held at each


@dataclass(frozen=True, slots=True)
class Equations:
    """A θ = b, in N·m and N."""

    A: Array  # (m, k)
    b: Array  # (m,)
    names: tuple[str, ...]  # of the unknowns, (k,): ``mass <link>``, ``armature``, ``dry <joint>``, ``viscous <joint>``
    nominal: Array  # what the model has, (k,): 1 for the share of a mass
    #: Number of the stretch of time to which each equation belongs, (m,): what they miss is alike within it.
    group: np.ndarray


def moments(
    recorded: Mapping[str, Array], model: RobotModel, contacts: Mapping[str, Contact], width: float = WIDTH
) -> Moments:
    """Find moments at which the controller was active and its contacts did not change, and smooth around them.

    Args:
        recorded: arrays of the cycles (`recording.cycle_arrays`).
        width: time over which each moment is smoothed, s.

    Raises:
        ConfigurationError: where the recording is not one of this robot, or has no such moments.
    """
    lacking = [name for name in ("stamp", "mode", "tau", "q", "v") if name not in recorded]
    if lacking:
        raise ConfigurationError(f"the recording lacks {', '.join(lacking)}; `wbc run --record` writes it")
    for name, size in (("q", model.nq), ("v", model.nv), ("tau", model.na)):
        if recorded[name].ndim != 2 or recorded[name].shape[1] != size:
            raise ConfigurationError(
                f"{name} has {recorded[name].shape[1:]} values in each cycle; this robot has {size}: it is another's"
            )
    time = 1.0e-9 * np.asarray(recorded["stamp"], dtype=np.float64)
    if len(time) < 2:
        raise ConfigurationError(f"the recording has {len(time)} cycles: nothing to fit")
    gap = float(np.median(np.diff(time)))
    half = max(2, round(0.5 * width / gap))
    forces = {name: recorded[f"force/{name}"] for name in contacts if f"force/{name}" in recorded}
    holds = np.array([np.isfinite(force).all(axis=1) for force in forces.values()]).T.reshape(len(time), len(forces))
    usable = (np.asarray(recorded["mode"]) == "active") & np.isfinite(recorded["q"]).all(axis=1)
    usable &= np.isfinite(recorded["v"]).all(axis=1) & (holds.any(axis=1) if model.floating_base else True)
    steady = np.concatenate([[True], (np.abs(np.diff(time) - gap) < 0.2 * gap) & (holds[1:] == holds[:-1]).all(axis=1)])
    broken = np.concatenate([[0], np.cumsum(~(usable & steady))])
    middle = np.arange(half, len(time) - half, max(1, round(_EVERY / gap)))
    middle = middle[broken[middle + half + 1] == broken[middle - half]]
    if not len(middle):
        raise ConfigurationError(
            f"no {width:g} s of the recording have regular states, an active controller and the same contacts"
        )
    # The slope of a straight line through the velocities is this mean of their differences, of which each is caused by
    # the torques of its own interval: the same mean of these belongs to it.
    weights = np.cumsum(np.arange(-half, half + 1)[::-1])[:-1][::-1].astype(np.float64)
    weights /= weights.sum()
    intervals = middle[:, None] + np.arange(-half, half)
    speeds, tau = np.nan_to_num(recorded["v"]), np.nan_to_num(recorded["tau"])
    v_dot = np.einsum("k,ikj->ij", weights, speeds[intervals + 1] - speeds[intervals]) / gap
    v = 0.5 * np.einsum("k,ikj->ij", weights, speeds[intervals + 1] + speeds[intervals])
    tau = np.einsum("k,ikj->ij", weights, tau[intervals])
    held = tuple(tuple(name for name, on in zip(forces, holds[i], strict=True) if on) for i in middle)
    around = speeds[intervals][:, :, model.v_index]
    turns = np.where(around.min(axis=1) > _RESTS, 1.0, np.where(around.max(axis=1) < -_RESTS, -1.0, 0.0))
    return Moments(np.asarray(recorded["q"])[middle], v, v_dot, tau, turns, held)


def equations(seen: Moments, model: RobotModel, contacts: Mapping[str, Contact]) -> Equations:
    """Set up the equations of all moments."""
    robot, actuation = model.pinocchio, model.actuation
    data, dynamics = robot.createData(), Dynamics(model)
    links = [i for i in range(1, robot.njoints) if robot.inertias[i].mass > 0.0]
    shares = np.zeros((10 * (robot.njoints - 1), len(links)))
    for column, i in enumerate(links):
        shares[10 * (i - 1) : 10 * i, column] = robot.inertias[i].toDynamicParameters()
    rotors = np.zeros(model.nv) if actuation.rotors is None else None
    geared = np.array(robot.armature) > 0.0
    joints = np.zeros((model.nv, model.nj))
    joints[model.v_index, np.arange(model.nj)] = 1.0
    rows, right, group = [], [], []
    for i, (q, v, v_dot, tau, turns, held) in enumerate(
        zip(seen.q, seen.v, seen.v_dot, seen.tau, seen.turns, seen.contacts, strict=True)
    ):
        dynamics.update(q, v)
        J = np.vstack([*(contacts[name].jacobian(dynamics) for name in held), joints.T[turns == 0.0]])
        Z = _allowed(J)
        if not Z.shape[1]:
            continue
        Y = pin.computeJointTorqueRegressor(robot, data, q, v, v_dot)
        moving = v[model.v_index]
        A = np.hstack([Y @ shares, (geared * v_dot)[:, None], joints * turns, joints * moving])
        known = actuation.generalized_force(tau) + model.passive_force(q, v)
        if rotors is None:
            known = known - actuation.rotors @ v_dot
        rows.append(Z.T @ A)
        right.append(Z.T @ known)
        group.append(np.full(Z.shape[1], i // _TOGETHER))
    names = [f"mass {_link(model, i)}" for i in links]
    names += ["armature", *(f"{kind} {joint}" for kind in ("dry", "viscous") for joint in model.joints)]
    armature = float(np.max(robot.armature, initial=0.0))
    nominal = np.concatenate([np.ones(len(links)), [armature], np.zeros(2 * model.nj)])
    if not rows:
        raise ConfigurationError("in no moment of the recording does anything move that its contacts allow")
    return Equations(np.vstack(rows), np.concatenate(right), tuple(names), nominal, np.concatenate(group))


def _allowed(J: Array) -> Array:
    """An orthonormal basis of the velocities v with J v = 0, (nv, n - rank)."""
    _, sizes, V = np.linalg.svd(J)
    rank = int(np.count_nonzero(sizes > 1.0e-9 * max(1.0, float(np.max(sizes, initial=0.0)))))
    return np.asarray(V[rank:].T)


def _link(model: RobotModel, joint: int) -> str:
    """Name of the link that a joint of Pinocchio's model moves, with all that is fixed to it."""
    robot = model.pinocchio
    frames = [f.name for f in robot.frames if f.type == pin.BODY and f.parentJoint == joint]
    return str(frames[0]) if frames else str(robot.names[joint])
