"""Physics of the mock robot.

The shapes of configured contacts apply only without shapes in the URDF, and between two links. Inputs and outputs
follow the conventions of `wbc_controller.records` (Pinocchio).
"""

import math
from collections import Counter, deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np
import numpy.typing as npt
import pinocchio as pin

from wbc_controller.arguments import array_of_numbers, number, str_of
from wbc_controller.controller.build.contacts import contact_placement
from wbc_controller.errors import InputRefused, WbcError, require_known, valid_choices
from wbc_controller.inverse_dynamics.arrays import cross
from wbc_controller.inverse_dynamics.robot.model import RobotModel
from wbc_controller.inverse_dynamics.robot.orientation import quaternion_of
from wbc_controller.records import Array
from wbc_controller.safety.damping import damping_matrix, stable_damping
from wbc_controller.settings import Settings
from wbc_controller.settings.contacts import FixedContact, SurfaceContact
from wbc_controller.settings.resources import folder_of
from wbc_controller.simulation.attachments import RAMP, Hoist, closures_of, frame_on_joint, grips_of, place, wrench
from wbc_controller.simulation.contact_forces import ContactForces
from wbc_controller.simulation.mechanism import add_friction, compile_mechanism, soften
from wbc_controller.simulation.shapes import read_shapes

PUSH_LIMIT = 1.0e5  # largest force or torque of a push, N or N·m
_LONGEST_PUSH = 86_400.0  # longest push, s
#: Tilt, rad, and share of the initial height above the lowest foot of a fallen base (of the centre of mass, if higher).
FALLEN_TILT, FALLEN_HEIGHT = math.radians(70.0), 0.5
#: Height from which the robot is lowered to the ground at its start, m; accuracy, m, and most steps.
_ABOVE, _TOUCHING, _LOWERINGS = 20.0, 1.0e-9, 20


@dataclass(frozen=True, slots=True)
class _Body:
    """MuJoCo body and the placement of a URDF frame on it."""

    id: int
    placement: pin.SE3


@dataclass(frozen=True, slots=True)
class _Push:
    """Wrench at a frame's origin in world axes, until the step `end`."""

    at: _Body
    wrench: Array
    end: int


class Plant:
    """Simulated robot, its floor, and a hoist that holds a floating base at its start.

    Results belong to the present state after `step`, `set_state` and `forward`, and are reproducible bit for bit.
    Faults change MuJoCo's `model` before `forward`; its `data` are read only.
    """

    def __init__(self, model: RobotModel, settings: Settings) -> None:
        """Build the physics, and hold the robot in its posture with its lowest point on the floor."""
        self._robot = model
        period = 1.0 / settings.control.rate
        self.steps_per_period = max(1, math.ceil(period / settings.mock.step - 1e-9))
        self.step_seconds = period / self.steps_per_period  # largest divisor of the control period up to `mock.step`
        self.effort_limits = model.actuation.effort_limits  # (na,) in N·m
        self.contacts = dict(settings.contacts)
        self._grips, self._closures = grips_of(model, self.contacts), closures_of(model, settings.loops)
        normal = np.array(settings.mock.floor_normal) / np.linalg.norm(settings.mock.floor_normal)
        shapes = read_shapes(model, self.contacts, normal, folder_of(settings.robot.urdf)) if self.contacts else {}
        attachments = {**self._grips, **self._closures}
        self.model = compile_mechanism(model, self.contacts, self.step_seconds, settings.mock, shapes, attachments)
        self.data = mujoco.MjData(self.model)
        self._qpos, self._dof = self._addresses(model.joints)
        if settings.mock.joint_friction > 0.0:
            add_friction(self.model, self._dof, settings.mock.joint_friction, self.step_seconds)
        self.model.dof_damping[self._dof] += settings.mock.joint_viscosity
        self._feet = {name: self._body_of(contact_placement(model, name, c)) for name, c in self.contacts.items()}
        bodies = {name: foot.id for name, foot in self._feet.items()}
        self.contact_forces = ContactForces(self.model, self.contacts, bodies)
        self._count = 0
        self._tau = np.zeros(model.na)
        self._wanted_damping, self._damping_matrix = math.nan, np.zeros((model.na, model.nj))
        self.damp(settings.mock.damping)
        self._damps = False
        self._pushes: list[_Push] = []
        #: By frame of an IMU, its placement, and the velocities in the world after each step of a period.
        self._imus: dict[str, tuple[_Body, deque[Array]]] = {}
        self._locks: Counter[str] = Counter()  # locks by joint
        self._unlocked: dict[str, tuple[bool, Any]] = {}  # limit flag and range without the lock
        soften(self.model, settings.mock.terrain, bodies.values())
        start = self._initial_base()
        self._hoist = Hoist(self.model, self.data, start) if model.floating_base else None
        for closure in self._closures.values():
            place(self.model, closure, closure.placements[0])
        self.set_state(model.configuration(model.posture, start), np.zeros(model.nv))
        self._fallen_height = self._lowest_base() if self.contacts else -math.inf
        for name in self._grips:
            self.grip(name, self.contacts[name].enabled)

    def _lowest_base(self) -> float:
        """Return the largest height of a fallen base above the lowest foot, m."""
        model, (q, _) = self._robot, self.state()
        com = pin.centerOfMass(model.pinocchio, model.pinocchio.createData(), q)
        foot, base = self._lowest_foot(), float(q[2])
        return base - foot - (1.0 - FALLEN_HEIGHT) * (max(base, float(com[2])) - foot)

    def _lowest_foot(self) -> float:
        """Return the height of the lowest contact, m; 0 without contacts."""
        return min((float(self._placement(foot).translation[2]) for foot in self._feet.values()), default=0.0)

    def body(self, frame: str) -> int:
        """Return the MuJoCo body of a URDF frame."""
        return self._body_of(frame_on_joint(self._robot, frame)).id

    def foot_placement(self, contact: str) -> pin.SE3:
        """Return the placement of a contact's frame in the world."""
        return self._placement(self._feet[contact])

    @property
    def time(self) -> float:
        """Simulated time, s."""
        return self._count * self.step_seconds

    @property
    def stamp(self) -> int:
        """Simulated time, ns."""
        return round(self._count * self.step_seconds * 1e9)

    @property
    def held(self) -> bool:
        """True if the hoist holds the base, or is being engaged."""
        return self._hoist is not None and self._hoist.held

    @property
    def fallen(self) -> bool:
        """True if the base is tilted by more than 70° or below half of its initial height above the lowest foot."""
        if not self._robot.floating_base:
            return False
        base = self._base()
        upright = base.rotation[2, 2] >= math.cos(FALLEN_TILT)
        high = base.translation[2] - self._lowest_foot() >= self._fallen_height
        return not (upright and high)  # NaN counts as fallen

    @property
    def applied_torques(self) -> Array:
        """Torques of the actuators within their limits, (na,) in N·m, commanded or damping."""
        tau = -(self._damping_matrix @ self.data.qvel[self._dof]) if self._damps else self._tau
        return np.array(np.clip(tau, -self.effort_limits, self.effort_limits))

    def state(self) -> tuple[Array, Array]:
        """Return q, (nq,), and v, (nv,), in Pinocchio's conventions."""
        q, v = self._robot.state(self.data.qpos[self._qpos], self.data.qvel[self._dof])
        if self._robot.floating_base:
            q[:3] = self.data.qpos[:3]
            q[3:7] = self._quaternion()
            # MuJoCo's free joint: linear velocity in world axes, angular velocity in body axes.
            v[:3] = self._base().rotation.T @ self.data.qvel[:3]
            v[3:6] = self.data.qvel[3:6]
        return q, v

    def acceleration(self) -> Array:
        """Return the generalized acceleration, (nv,), in Pinocchio's conventions: v̇ = Rᵀ a − ω × v of the base."""
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
        """Measure an ideal IMU in a frame.

        Returns orientation (x, y, z, w), angular velocity in rad/s, and specific force in m/s²: the mean of the last
        control period, at first and after `set_state` the present value.
        """
        if frame not in self._imus:
            body = self._body_of(frame_on_joint(self._robot, frame))
            self._imus[frame] = body, deque([self._motion(body)[1]], self.steps_per_period + 1)
        body, moved = self._imus[frame]
        turning, placement = self._motion(body)[0], self._placement(body)
        to_local = placement.rotation.T
        duration = (len(moved) - 1) * self.step_seconds
        if duration > 0.0:
            middle = pin.exp3(0.5 * duration * turning)  # half a period
            force = middle @ ((moved[-1] - moved[0]) / duration - self.model.opt.gravity)
        else:
            acceleration = np.zeros(6)
            mujoco.mj_rnePostConstraint(self.model, self.data)
            kind = mujoco.mjtObj.mjOBJ_XBODY
            mujoco.mj_objectAcceleration(self.model, self.data, kind, body.id, acceleration, 0)
            arm = placement.translation - self.data.xpos[body.id]
            # MuJoCo accelerates the world upwards instead of gravity: its acceleration is the specific force.
            force = acceleration[3:] + cross(acceleration[:3], arm) + cross(turning, cross(turning, arm))
        return quaternion_of(placement.rotation), to_local @ turning, to_local @ force

    def _motion(self, body: _Body) -> tuple[Array, Array]:
        """Return angular velocity and velocity of a frame's origin in world axes, (3,) each."""
        motion = np.zeros(6)
        mujoco.mj_objectVelocity(self.model, self.data, mujoco.mjtObj.mjOBJ_XBODY, body.id, motion, 0)
        arm = self._placement(body).translation - self.data.xpos[body.id]
        return motion[:3], motion[3:] + cross(motion[:3], arm)

    def contact_wrenches(self) -> dict[str, Array]:
        """Return the true force or wrench on the robot at each contact.

        Surface and fixed contacts: wrench in the contact frame, (6,), force first. Points and wheels: force, (3,), in
        world axes, or in the frame `against`.
        """
        frames = {name: self._placement(foot) for name, foot in self._feet.items()}
        force, moment = self.contact_forces.forces(self.data, frames)
        for name, grip in self._grips.items():
            held = wrench(self.model, self.data, grip)
            force[name] += held[:3]
            moment[name] += held[3:]
        for name, contact in self.contacts.items():
            if isinstance(contact, SurfaceContact | FixedContact):
                to_local = frames[name].rotation.T
                force[name] = np.concatenate([to_local @ force[name], to_local @ moment[name]])
            elif contact.against is not None:
                other = self._body_of(frame_on_joint(self._robot, contact.against))
                force[name] = self._placement(other).rotation.T @ force[name]
        return force

    def links_on_the_floor(self) -> frozenset[str]:
        """Return the names of links that touch the floor without a contact."""
        return frozenset(self.model.body(body).name for body in self.contact_forces.bodies_without_contact(self.data))

    def apply(self, tau: npt.ArrayLike) -> None:
        """Set the torques of the actuators, (na,) in N·m, clamped to the effort limits."""
        torques = np.asarray(tau, dtype=np.float64)
        self.check_torques(torques)
        self._tau, self._damps, self._stale = torques.copy(), False, True

    def check_torques(self, tau: Array) -> None:
        """Raise InputRefused for torques of a wrong size, or not finite."""
        if tau.shape != (self._robot.na,):
            raise InputRefused(f"got {tau.size} torques; expected {self._robot.na}, one per actuator in their order")
        if not np.isfinite(tau).all():
            bad = [f"{self._robot.actuators[i]}: {tau[i]}" for i in np.flatnonzero(~np.isfinite(tau))]
            raise InputRefused(f"got torques that are not finite ({', '.join(bad)}); expected finite ones, in N·m")

    def damp(self, damping: float) -> None:
        """Damp every joint, N·m·s/rad, reduced if unstable."""
        if damping != self._wanted_damping:
            D = stable_damping(self._robot, damping, self.step_seconds)
            self._wanted_damping, self._damping_matrix = damping, damping_matrix(self._robot.actuation, D)
        self._damps = self._stale = True

    def lock(self, joint: str) -> Callable[[], None]:
        """Lock a joint at its position; return the function that unlocks it."""
        locked = self.model.joint(joint)
        if not self._locks[joint]:
            self._unlocked[joint] = bool(locked.limited[0]), locked.range.copy()
            locked.limited[0], locked.range[:] = True, float(self.data.qpos[locked.qposadr[0]])
        self._locks[joint] += 1
        self._stale = True

        def unlock() -> None:
            self._locks[joint] -= 1
            if not self._locks[joint]:
                locked.limited[0], locked.range[:] = self._unlocked.pop(joint)
            self._stale = True

        return unlock

    def push(self, frame: str, wrench: npt.ArrayLike, duration: float) -> None:
        """Push the robot from now on; overlapping pushes add up.

        Args:
            frame: moving link or joint; the push acts at its origin.
            wrench: force and torque in world axes, (6,) in N and N·m.
            duration: s, rounded to steps.
        """
        values = np.array(array_of_numbers(wrench, "a push"))
        duration = number(duration, "the duration of a push", 0.0, _LONGEST_PUSH)
        if values.shape != (6,):
            raise InputRefused(f"a push has the shape {values.shape}; expected (6,), force and torque")
        if not (np.abs(values) <= PUSH_LIMIT).all():
            raise InputRefused(f"a push of {values.tolist()} N, N·m; every value must be finite, at most {PUSH_LIMIT}")
        if not duration > 0.0:
            raise InputRefused("the duration of a push must be positive, got 0")
        robot = self._robot
        known = isinstance(frame, str) and frame.isprintable() and robot.pinocchio.existFrame(frame)
        if not known or robot.pinocchio.frames[robot.frame_id(frame, "push")].parentJoint == 0:
            valid = valid_choices(str_of(frame), robot.moving_links)
            raise InputRefused(f"a push on {frame!r}: unknown moving link; {valid}")
        steps = max(1, round(duration / self.step_seconds))
        self._pushes.append(_Push(self._body_of(frame_on_joint(robot, frame)), values, self._count + steps))
        self._stale = True

    def hold(self, held: bool, ramp: float = RAMP) -> None:
        """Hold the base at its start, or release it, within `ramp`, s."""
        if self._hoist is not None and held != self._hoist.held:
            self._hoist.hold(held, self._base(), ramp)
            self.forward()

    def grip(self, contact: str, held: bool) -> None:
        """Hold the link of a fixed contact at its present placement, or release it."""
        require_known(contact, self._grips, "a grip at", ": unknown fixed contact", InputRefused)
        grip = self._grips[contact]
        if held:
            holder = self._placement(self._body_of((grip.joints[0], pin.SE3.Identity())))
            place(self.model, grip, holder.actInv(self._placement(self._feet[contact])))
        for constraint in grip.names:
            self.data.eq_active[self.model.equality(constraint).id] = held
        self.forward()

    def set_state(self, q: npt.ArrayLike, v: npt.ArrayLike) -> None:
        """Set q, (nq,), and v, (nv,); time, torques, pushes and hoist do not change."""
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
        self._imus.clear()
        self.forward()

    def _write(self, q: Array, v: Array) -> None:
        self.data.qpos[self._qpos] = q[self._robot.q_index]
        self.data.qvel[self._dof] = v[self._robot.v_index]
        followers = self._robot.followers
        if followers is not None:
            qpos, dof = self._addresses(followers.names)
            self.data.qpos[qpos], self.data.qvel[dof] = q[followers.q_index], v[followers.v_index]
        if self._robot.floating_base:
            self.data.qpos[:3] = q[:3]
            self.data.qpos[3:7] = q[[6, 3, 4, 5]]
            self.data.qvel[:3] = self._base().rotation @ v[:3]
            self.data.qvel[3:6] = v[3:6]

    def forward(self) -> None:
        """Recompute accelerations and contact forces."""
        mujoco.mj_fwdPosition(self.model, self.data)
        mujoco.mj_fwdVelocity(self.model, self.data)
        self._respond()

    def step(self) -> None:
        """Simulate one step; raises WbcError if the simulation diverges."""
        if self._stale:
            self._respond()
        mujoco.mj_implicit(self.model, self.data)
        self._count += 1
        self._pushes = [push for push in self._pushes if self._count < push.end]
        if self._hoist is not None:
            self._hoist.advance()
        self.forward()
        for body, moved in self._imus.values():
            moved.append(self._motion(body)[1])
        if not np.isfinite(self.data.qacc).all():
            raise WbcError(f"the physics diverged at {self.time:.3f} s; reduce mock.step")

    def _respond(self) -> None:
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

    def _initial_base(self) -> pin.SE3:
        """Return the upright base placement with the robot's lowest point on the ground."""
        geoms = self.contact_forces.on_the_floor
        if not (self._robot.floating_base and self.contacts and geoms):
            return pin.SE3.Identity()
        start = pin.SE3(np.eye(3), np.array([0.0, 0.0, _ABOVE]))
        for _ in range(_LOWERINGS):
            self._write(self._robot.configuration(self._robot.posture, start), np.zeros(self._robot.nv))
            mujoco.mj_kinematics(self.model, self.data)
            distance = self.contact_forces.distance(self.data, geoms)
            start.translation -= np.array([0.0, 0.0, distance])
            if abs(distance) < _TOUCHING:
                break
        return start

    def _base(self) -> pin.SE3:
        return pin.XYZQUATToSE3(np.concatenate([self.data.qpos[:3], self._quaternion()]))

    def _quaternion(self) -> Array:
        quaternion = self.data.qpos[[4, 5, 6, 3]]
        return np.array(quaternion / np.linalg.norm(quaternion))

    def _placement(self, body: _Body) -> pin.SE3:
        return pin.SE3(self.data.xmat[body.id].reshape(3, 3), self.data.xpos[body.id]) * body.placement

    def _addresses(self, names: Sequence[str]) -> tuple[np.ndarray, np.ndarray]:
        joints = [self.model.joint(name) for name in names]
        qpos, dof = ([int(getattr(joint, key)[0]) for joint in joints] for key in ("qposadr", "dofadr"))
        return np.array(qpos, dtype=np.intp), np.array(dof, dtype=np.intp)

    def _body_of(self, frame: tuple[int, pin.SE3]) -> _Body:
        joint, placement = frame
        name = self._robot.pinocchio.names[joint]
        moving = name in self._robot.moving_joints
        body = self.model.joint(name).bodyid[0] if moving else self.model.jnt_bodyid[0]
        return _Body(int(body) if joint > 0 else 0, placement)
