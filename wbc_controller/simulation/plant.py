"""The physics of the mock robot: MuJoCo, built from the same URDF and configuration as the controller's own model.

All physical parameters come from the URDF (links, inertias, collision shapes, joints, effort and position limits) and
from `settings` (armature, step, friction of the floor). What the controller assumes of its contacts, their outline and
their friction, holds here only where the URDF has no shapes, and between two links. All inputs and outputs follow the
conventions of `wbc_controller.records`, which are Pinocchio's; the conversions to MuJoCo's are made here.
"""

import logging
import math
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import numpy.typing as npt
import pinocchio as pin

from wbc_controller.arguments import array_of_numbers, number, str_of
from wbc_controller.errors import ConfigurationError, InputRefused, WbcError, valid_choices
from wbc_controller.inverse_dynamics.arrays import cross
from wbc_controller.inverse_dynamics.robot.model import RobotModel
from wbc_controller.inverse_dynamics.robot.orientation import quaternion_of
from wbc_controller.records import Array
from wbc_controller.settings import FixedContact, PointContact, Settings, SurfaceContact
from wbc_controller.settings.resources import locate
from wbc_controller.simulation.attachments import closures_of, frame_on_joint, grips_of, place, wrench
from wbc_controller.simulation.contact_forces import ContactForces
from wbc_controller.simulation.hoist import RAMP, Hoist
from wbc_controller.simulation.mechanism import compile_mechanism, contact_frame, rub
from wbc_controller.simulation.shapes import Shape, read_shapes

_log = logging.getLogger(__name__)

#: Largest force or torque of a push, N or N·m: a larger value is a mistaken unit, and would break the simulation.
PUSH_LIMIT = 1.0e5
#: Longest push, s.
_LONGEST_PUSH = 86_400.0
#: Largest share of a joint's velocity that damping may remove within one step.
DAMPING_SHARE = 0.25
#: A robot has fallen if its base is tilted by more, rad, or is below this share of its initial height.
FALLEN_TILT, FALLEN_HEIGHT = math.radians(60.0), 0.5


@dataclass(frozen=True, slots=True)
class _Body:
    """A MuJoCo body, and the placement of a URDF frame on it."""

    id: int
    placement: pin.SE3


@dataclass(frozen=True, slots=True)
class _Push:
    """A wrench at a frame's origin, world axes, acting before the step `end`."""

    at: _Body
    wrench: Array
    end: int


class Plant:
    """The simulated robot, its floor, and a hoist that holds a floating base at its start.

    After construction, `step`, `set_state` and `forward`, all quantities belong to the present state: accelerations and
    contact forces are those caused in it by the present torques, pushes and hoist. Equal calls give bit-identical
    results.

    Attributes:
        model: MuJoCo's model, which faults change; its dependent quantities are up to date after `forward`.
        data: MuJoCo's data in the present state, to be read only.
        contact_forces: the geoms of each contact, and their forces.
        steps_per_period: number of simulation steps in one control period.
        step_seconds: time step of the simulation, s: the largest divisor of the period up to ``settings.mock.step``.
        effort_limits: effort limit of each actuator, (na,) in N·m, regardless of the share that a controller may use.
    """

    def __init__(self, model: RobotModel, settings: Settings) -> None:
        """Build the physics, stand the robot in its posture with its lowest point on the floor, and hold it there.

        The settings are those from which the model was built.

        Raises:
            ConfigurationError: if MuJoCo cannot use the URDF, or a contact names an unknown frame.
        """
        self._robot = model
        period = 1.0 / settings.control.rate
        self.steps_per_period = max(1, math.ceil(period / settings.mock.step - 1e-9))
        self.step_seconds = period / self.steps_per_period
        self.effort_limits = model.actuation.effort_limits
        self.contacts = dict(settings.contacts)
        self._grips, self._closures = grips_of(model, self.contacts), closures_of(model, settings.loops)
        folder = locate(settings.robot.urdf).parent if settings.robot.urdf else None
        normal = np.array(settings.mock.floor_normal) / np.linalg.norm(settings.mock.floor_normal)
        shapes = self._shapes(folder, normal)
        self.model = compile_mechanism(
            model, self.contacts, self.step_seconds, settings.mock, shapes, {**self._grips, **self._closures}
        )
        self.data = mujoco.MjData(self.model)
        self._qpos, self._dof = self._addresses(model.joints)
        if settings.mock.joint_friction > 0.0:
            rub(self.model, self._dof, settings.mock.joint_friction, self.step_seconds)
        self.model.dof_damping[self._dof] += settings.mock.joint_viscosity
        self._following = self._addresses(model.followers.names) if model.followers is not None else None
        self._feet = {name: self._body_of(contact_frame(model, name, c)) for name, c in self.contacts.items()}
        self.contact_forces = ContactForces(
            self.model, self.contacts, {name: foot.id for name, foot in self._feet.items()}
        )
        self._count = 0
        self._tau = np.zeros(model.na)
        self._damping: Array | None = None
        # Sampled damping is stable only if step times damping times (M⁻¹)ⱼⱼ stays well below 1.
        most = DAMPING_SHARE / (self.step_seconds * self.model.dof_invweight0[self._dof])
        # Through a transmission, damping is certain to brake only if it is equal for all joints.
        self._most_damping = most if model.actuation.direct else np.full(model.nj, most[model.actuation.driven].min())
        self._pushes: list[_Push] = []
        self._imus: dict[str, _Body] = {}
        self._moved: dict[str, deque[Array]] = {}  # velocity of each of them in the world after each step of a period
        self._locks: dict[str, list[object]] = {}
        self._unlocked: dict[str, tuple[bool, Any]] = {}  # whether a locked joint is limited otherwise, and its range
        self._stale = False
        start = self._initial_base(normal)
        # Without contacts there is no floor.
        self._fallen_height = FALLEN_HEIGHT * float(start.translation[2]) if self.contacts else -math.inf
        self._hoist = Hoist(self.model, self.data, start) if model.floating_base else None
        for closure in self._closures.values():
            place(self.model, closure, closure.placements[0])
        self.set_state(model.configuration(model.posture, start), np.zeros(model.nv))
        for name in self._grips:
            self.grip(name, self.contacts[name].enabled)

    def body(self, frame: str) -> int:
        """Return the index of the MuJoCo body that carries a frame of the URDF."""
        return self._body_of(frame_on_joint(self._robot, frame)).id

    def foot_placement(self, contact: str) -> pin.SE3:
        """Place the frame of a contact in the world."""
        return self._placement(self._feet[contact])

    @property
    def time(self) -> float:
        """Simulated time, s."""
        return self._count * self.step_seconds

    @property
    def stamp(self) -> int:
        """Simulated time, ns; counted in steps, so that no error accumulates."""
        return round(self._count * self.step_seconds * 1e9)

    @property
    def held(self) -> bool:
        """True if the hoist holds the base, or is being engaged."""
        return self._hoist is not None and self._hoist.held

    @property
    def fallen(self) -> bool:
        """True if the base is tilted by more than 60° or below half of its initial height."""
        if not self._robot.floating_base:
            return False
        base = self._base()
        # Written this way round so that NaN counts as fallen.
        upright = base.rotation[2, 2] >= math.cos(FALLEN_TILT)
        high = base.translation[2] >= self._fallen_height
        return not (upright and high)

    @property
    def applied_torques(self) -> Array:
        """Torques of the actuators, (na,) in N·m: the commanded torques within the limits, or the damping torques."""
        tau = self._tau
        if self._damping is not None:
            tau = -self._robot.actuation.from_joints(self._damping * self.data.qvel[self._dof])
        return np.array(np.clip(tau, -self.effort_limits, self.effort_limits))

    def state(self) -> tuple[Array, Array]:
        """Return the configuration q, (nq,), and the generalized velocity v, (nv,), in Pinocchio's conventions."""
        q, v = self._robot.state(self.data.qpos[self._qpos], self.data.qvel[self._dof])
        if self._robot.floating_base:
            q[:3] = self.data.qpos[:3]
            q[3:7] = self._quaternion()
            # MuJoCo's free joint has the linear velocity in world axes and the angular one in the body's.
            v[:3] = self._base().rotation.T @ self.data.qvel[:3]
            v[3:6] = self.data.qvel[3:6]
        return q, v

    def coupling_error(self) -> float:
        """Return the largest error of a mimic joint's position relative to its leader, rad or m; 0 without any."""
        followers = self._robot.followers
        if followers is None or self._following is None:
            return 0.0
        q, _ = self.state()
        return float(np.max(np.abs(self.data.qpos[self._following[0]] - q[followers.q_index])))

    def acceleration(self) -> Array:
        """Return the generalized acceleration, (nv,), in Pinocchio's conventions.

        The base's linear part is the derivative of a velocity that is expressed in a rotating frame:
        v̇ = Rᵀ a − ω × v, with a the acceleration of the base's origin in world axes.
        """
        v_dot = np.zeros(self._robot.nv)
        v_dot[self._robot.v_index] = self.data.qacc[self._dof]
        if self._robot.followers is not None:
            self._robot.followers.move(v_dot)
        if self._robot.floating_base:
            rotation = self._base().rotation
            omega = self.data.qvel[3:6]
            v_dot[:3] = rotation.T @ self.data.qacc[:3] - cross(omega, rotation.T @ self.data.qvel[:3])
            v_dot[3:6] = self.data.qacc[3:6]
        return v_dot

    def imu(self, frame: str) -> tuple[Array, Array, Array]:
        """Read an ideal inertial measurement unit at the origin of a frame of the URDF, in the axes of the frame.

        Like a unit that integrates inside, it measures the mean specific force of the last control period: the force of
        the floor changes within a period, and samples of it drift by 5 % of a squat's velocity. The first value, and
        the first after `set_state`, is that of the instant.

        Returns:
            The frame's orientation in the world, (4,) as (x, y, z, w); its angular velocity, (3,) in rad/s, and the
            specific force (acceleration minus gravity) at its origin, (3,) in m/s², both in its axes.

        Raises:
            ConfigurationError: if the robot has no such frame.
        """
        if frame not in self._imus:
            self._imus[frame] = self._body_of(frame_on_joint(self._robot, frame))
        body = self._imus[frame]
        moved = self._moved.setdefault(frame, deque(maxlen=self.steps_per_period + 1))
        turning, velocity = self._motion(body)
        if not moved:
            moved.append(velocity)
        placement = self._placement(body)
        to_local = placement.rotation.T
        steps = len(moved) - 1
        if steps:
            duration = steps * self.step_seconds
            middle = pin.exp3(0.5 * duration * turning)  # from the axes of the middle of the period to those of now
            force = middle @ ((moved[-1] - moved[0]) / duration - self.model.opt.gravity)
        else:
            acceleration = np.zeros(6)
            mujoco.mj_rnePostConstraint(self.model, self.data)
            kind = mujoco.mjtObj.mjOBJ_XBODY
            mujoco.mj_objectAcceleration(self.model, self.data, kind, body.id, acceleration, 0)
            arm = placement.translation - self.data.xpos[body.id]
            # In MuJoCo the world accelerates upwards instead of gravity: its acceleration is the specific force.
            force = acceleration[3:] + cross(acceleration[:3], arm) + cross(turning, cross(turning, arm))
        return quaternion_of(placement.rotation), to_local @ turning, to_local @ force

    def _motion(self, body: _Body) -> tuple[Array, Array]:
        """Angular velocity and velocity of the origin of a frame on a body, in world axes, (3,) each."""
        motion = np.zeros(6)
        mujoco.mj_objectVelocity(self.model, self.data, mujoco.mjtObj.mjOBJ_XBODY, body.id, motion, 0)
        arm = self._placement(body).translation - self.data.xpos[body.id]
        return motion[:3], motion[3:] + cross(motion[:3], arm)

    def contact_wrenches(self) -> dict[str, Array]:
        """Return the true force or wrench on the robot at each contact of the configuration.

        Returns:
            For a surface or fixed contact, the wrench about the contact's origin in the contact frame, (6,) in N and
            N·m, force first; for a point or wheel, the force in N, (3,), in world axes, or in the axes of the frame
            `against`. Forces on links without a contact belong to none; on a link with several, to the nearest.
        """
        frames = {name: self._placement(foot) for name, foot in self._feet.items()}
        force, moment = self.contact_forces.forces(self.data, frames)
        for name, grip in self._grips.items():
            held = wrench(self.model, self.data, grip)
            force[name] += held[:3]
            moment[name] += held[3:]
        wrenches = {}
        for name, contact in self.contacts.items():
            if isinstance(contact, SurfaceContact | FixedContact):
                to_local = frames[name].rotation.T
                wrenches[name] = np.concatenate([to_local @ force[name], to_local @ moment[name]])
            elif contact.against is not None:
                other = self._body_of(frame_on_joint(self._robot, contact.against))
                wrenches[name] = self._placement(other).rotation.T @ force[name]
            else:
                wrenches[name] = force[name]
        return wrenches

    def links_on_the_floor(self) -> frozenset[str]:
        """Return the names of the links that touch the floor without a contact, such as those of a fallen robot."""
        return frozenset(self.model.body(body).name for body in self.contact_forces.bodies_elsewhere(self.data))

    def penetration(self) -> float:
        """Return the largest penetration of the robot into the floor, m; 0 if it does not touch it."""
        depths = [-float(self.data.contact[index].dist) for index in range(self.data.ncon)]
        return max([0.0, *depths])

    def apply(self, tau: npt.ArrayLike) -> None:
        """Set the torques of the actuators, (na,) in N·m, from now on. They saturate at their effort limits.

        Raises:
            InputRefused: if the size is wrong or a value is not finite; the torques are then unchanged.
        """
        torques = np.asarray(tau, dtype=np.float64)
        self.check_torques(torques)
        self._tau, self._damping, self._stale = torques.copy(), None, True

    def check_torques(self, tau: Array) -> None:
        """Refuse torques that `apply` would refuse.

        Raises:
            InputRefused: if the size is wrong or a value is not finite.
        """
        if tau.shape != (self._robot.na,):
            raise InputRefused(f"got {tau.size} torques; expected {self._robot.na}, one per actuator in their order")
        if not np.isfinite(tau).all():
            bad = [
                f"{n}: {x}" for n, x in zip(self._robot.actuators, tau.tolist(), strict=True) if not math.isfinite(x)
            ]
            raise InputRefused(f"got torques that are not finite ({', '.join(bad)}); expected finite ones, in N·m")

    def damp(self, damping: float) -> None:
        """Damp every joint instead of applying torques, as its drive would; this saturates too.

        The damping, in N·m·s/rad, is reduced if it would be unstable with the simulation's time step.
        """
        self._damping, self._stale = np.minimum(damping, self._most_damping), True

    def lock(self, joint: str) -> Callable[[], None]:
        """Lock a joint at its present position, as a brake does.

        Returns:
            The function that removes this lock; the joint moves again without any lock.
        """
        locked, lock = self.model.joint(joint), object()
        if not self._locks.setdefault(joint, []):
            self._unlocked[joint] = bool(locked.limited[0]), locked.range.copy()
            locked.limited[0], locked.range[:] = True, float(self.data.qpos[locked.qposadr[0]])
        self._locks[joint].append(lock)
        self._stale = True

        def unlock() -> None:
            self._locks[joint].remove(lock)
            if not self._locks[joint]:
                locked.limited[0], locked.range[:] = self._unlocked.pop(joint)
            self._stale = True

        return unlock

    def push(self, frame: str, wrench: npt.ArrayLike, duration: float) -> None:
        """Push the robot from now on. Pushes may overlap; they add up.

        Args:
            frame: link or joint of the URDF at whose origin the push acts; the push moves with it.
            wrench: force and torque in world axes, (6,) in N and N·m.
            duration: duration, s; rounded to steps, at least one.

        Raises:
            InputRefused: if the frame is unknown or does not move, or a value is not usable.
        """
        values = np.array(array_of_numbers(wrench, "a push"))
        duration = number(duration, "the duration of a push", 0.0, _LONGEST_PUSH)
        if values.shape != (6,):
            raise InputRefused(f"a push has the shape {values.shape}; expected (6,), force and torque")
        if not (np.abs(values) <= PUSH_LIMIT).all():
            raise InputRefused(f"a push of {values.tolist()} N, N·m; every value must be finite, at most {PUSH_LIMIT}")
        if not duration > 0.0:
            raise InputRefused("the duration of a push must be positive, not 0")
        pinocchio = self._robot.pinocchio
        moving = [f.name for f in pinocchio.frames if f.type == pin.BODY and f.parentJoint > 0]
        known = isinstance(frame, str) and frame.isprintable() and pinocchio.existFrame(frame)
        known = known and pinocchio.frames[self._robot.frame_id(frame, "push")].parentJoint > 0
        if not known:
            raise InputRefused(
                f"a push on {frame!r}: no moving link has this name; {valid_choices(str_of(frame), moving)}"
            )
        steps = max(1, round(duration / self.step_seconds))
        at = self._body_of(frame_on_joint(self._robot, frame))
        self._pushes.append(_Push(at, values, self._count + steps))
        self._stale = True

    def hold(self, held: bool, ramp: float = RAMP) -> None:
        """Hold the base at its start, or release it, within `ramp`, s; without effect on a fixed base.

        A displaced base is carried back at a bounded speed.
        """
        if self._hoist is None or held == self._hoist.held:
            return
        if held:
            self._hoist.take(self._base(), ramp)
        else:
            self._hoist.let_go(ramp)
        self.forward()

    def grip(self, contact: str, held: bool) -> None:
        """Hold the link of a fixed contact at its present placement, or release it.

        Raises:
            InputRefused: if there is no fixed contact of this name.
        """
        if contact not in self._grips:
            raise InputRefused(f"a grip at {contact!r}: {valid_choices(contact, list(self._grips))}")
        grip = self._grips[contact]
        if held:
            holder = self._placement(self._body_of((grip.joints[0], pin.SE3.Identity())))
            place(self.model, grip, holder.actInv(self._placement(self._feet[contact])))
        for constraint in grip.names:
            self.data.eq_active[self.model.equality(constraint).id] = held
        self.forward()

    def set_state(self, q: npt.ArrayLike, v: npt.ArrayLike) -> None:
        """Set the configuration, (nq,), and the generalized velocity, (nv,); time, torques, pushes and hoist stay.

        Raises:
            InputRefused: if a size is wrong or a value is not finite.
        """
        q, v = np.asarray(q, dtype=np.float64), np.asarray(v, dtype=np.float64)
        if q.shape != (self._robot.nq,) or v.shape != (self._robot.nv,):
            expected = f"({self._robot.nq},) and ({self._robot.nv},)"
            raise InputRefused(f"a state has the shapes {q.shape} and {v.shape}; expected {expected}")
        if not (np.isfinite(q).all() and np.isfinite(v).all()):
            raise InputRefused("a state is not finite; expected finite positions and velocities")
        if self._robot.floating_base and not abs(np.linalg.norm(q[3:7]) - 1.0) <= 1e-3:
            raise InputRefused(f"the base's quaternion is {q[3:7].tolist()}; expected length 1, (x, y, z, w)")
        self._write(q, v)
        self.data.qacc_warmstart[:] = 0.0
        self._moved.clear()
        self.forward()

    def _write(self, q: Array, v: Array) -> None:
        """Write a state to MuJoCo's data, in its conventions."""
        self.data.qpos[self._qpos] = q[self._robot.q_index]
        self.data.qvel[self._dof] = v[self._robot.v_index]
        if self._robot.followers is not None and self._following is not None:
            qpos, dof = self._following
            self.data.qpos[qpos], self.data.qvel[dof] = (
                q[self._robot.followers.q_index],
                v[self._robot.followers.v_index],
            )
        if self._robot.floating_base:
            self.data.qpos[:3] = q[:3]
            self.data.qpos[3:7] = q[[6, 3, 4, 5]]
            self.data.qvel[:3] = self._base().rotation @ v[:3]
            self.data.qvel[3:6] = v[3:6]

    def forward(self) -> None:
        """Recompute accelerations and contact forces in the present state, without stepping."""
        mujoco.mj_fwdPosition(self.model, self.data)
        mujoco.mj_fwdVelocity(self.model, self.data)
        self._respond()

    def step(self) -> None:
        """Simulate one step of `step_seconds`.

        Raises:
            WbcError: if the simulation has diverged.
        """
        if self._stale:
            self._respond()
        mujoco.mj_implicit(self.model, self.data)
        self._count += 1
        self._pushes = [push for push in self._pushes if self._count < push.end]
        if self._hoist is not None:
            self._hoist.advance()
        self.forward()
        for frame, moved in self._moved.items():
            moved.append(self._motion(self._imus[frame])[1])
        if not np.isfinite(self.data.qacc).all():
            raise WbcError(f"the physics diverged at {self.time:.3f} s; a smaller mock.step may help")

    def _respond(self) -> None:
        """Compute the accelerations from the present forces; positions and velocities are already computed."""
        self.data.xfrc_applied[:] = 0.0
        for push in self._pushes:
            arm = self._placement(push.at).translation - self.data.xipos[push.at.id]
            force, torque = push.wrench[:3], push.wrench[3:]
            # MuJoCo takes wrenches about a body's centre of mass.
            self.data.xfrc_applied[push.at.id] += np.concatenate([force, torque + cross(arm, force)])
        self.data.qfrc_applied[self._dof] = self._robot.actuation.at_joints(self.applied_torques)
        mujoco.mj_fwdActuation(self.model, self.data)
        mujoco.mj_fwdAcceleration(self.model, self.data)
        mujoco.mj_fwdConstraint(self.model, self.data)
        self._stale = False

    def _shapes(self, folder: Path | None, normal: Array) -> dict[int, list[Shape]]:
        """Read the shapes with which the robot touches the floor; warn of contacts without any."""
        if not self.contacts:
            return {}
        soles: dict[int, list[Array]] = {}
        tips: dict[int, Array] = {}
        standing: dict[str, int] = {}
        data = self._robot.pinocchio.createData()
        pin.forwardKinematics(self._robot.pinocchio, data, self._robot.configuration(self._robot.posture))
        for name, contact in self.contacts.items():
            joint, placement = contact_frame(self._robot, name, contact)
            if contact.against is None and not isinstance(contact, FixedContact):
                standing[name] = joint
                if isinstance(contact, SurfaceContact):
                    soles.setdefault(joint, []).append(-placement.rotation[:, 2])
                elif isinstance(contact, PointContact):
                    tips[joint] = -data.oMi[joint].rotation.T @ normal
        try:
            shapes, why = read_shapes(self._robot, soles, tips, folder), "have no collision element in the URDF"
        except ConfigurationError as error:  # the controller, too, can do without the meshes
            shapes, why = {}, f"have no shapes ({error})"
        bare = [name for name, joint in standing.items() if joint not in shapes]
        if bare:
            _log.warning(
                "the links of the contacts %s %s: in the mock robot they touch with the shapes of the configuration",
                ", ".join(bare),
                why,
            )
        return shapes

    def _initial_base(self, normal: Array) -> pin.SE3:
        """Place the base upright at the height where the robot's lowest point is on the floor."""
        if not (self._robot.floating_base and self.contacts):
            return pin.SE3.Identity()
        self._write(self._robot.configuration(self._robot.posture), np.zeros(self._robot.nv))
        mujoco.mj_kinematics(self.model, self.data)
        height = self.contact_forces.height(self.data, self.contact_forces.on_the_floor)
        if height == math.inf:
            return pin.SE3.Identity()
        return pin.SE3(np.eye(3), np.array([0.0, 0.0, -height / normal[2]]))

    def _base(self) -> pin.SE3:
        return pin.XYZQUATToSE3(np.concatenate([self.data.qpos[:3], self._quaternion()]))

    def _quaternion(self) -> Array:
        """Return the base's orientation, (4,) as (x, y, z, w)."""
        quaternion = self.data.qpos[[4, 5, 6, 3]]
        return np.array(quaternion / np.linalg.norm(quaternion))

    def _placement(self, body: _Body) -> pin.SE3:
        """Place a frame on a body in the world."""
        return pin.SE3(self.data.xmat[body.id].reshape(3, 3), self.data.xpos[body.id]) * body.placement

    def _addresses(self, names: Sequence[str]) -> tuple[np.ndarray, np.ndarray]:
        """Return the indices of joints in MuJoCo's qpos and qvel, (k,) each."""
        joints = [self.model.joint(name) for name in names]
        qpos, dof = ([int(getattr(joint, key)[0]) for joint in joints] for key in ("qposadr", "dofadr"))
        return np.array(qpos, dtype=np.intp), np.array(dof, dtype=np.intp)

    def _body_of(self, frame: tuple[int, pin.SE3]) -> _Body:
        joint, placement = frame
        name = self._robot.pinocchio.names[joint]
        if joint == 0:
            return _Body(0, placement)
        if name in self._robot.moving_joints:
            return _Body(int(self.model.joint(name).bodyid[0]), placement)
        return _Body(int(self.model.jnt_bodyid[0]), placement)
