"""Snapshots of a running robot from its topics."""

import contextlib
import time
from collections.abc import Callable
from typing import Any

import numpy as np
import pinocchio as pin
from scipy.spatial.transform import Rotation

from wbc_controller.apps.page.snapshot import FOLLOWING, Robot, Snapshot
from wbc_controller.apps.terminal.session import Session
from wbc_controller.apps.terminal.status_view import RobotStatus, StatusListener
from wbc_controller.controller.visualization.scene import Shape
from wbc_controller.errors import InputRefused
from wbc_controller.middleware.codec import decode
from wbc_controller.middleware.decoding import READERS
from wbc_controller.middleware.stamps import stamp_of
from wbc_controller.middleware.states import BaseState, JointStateReader, JointStates, OdometryReader, StateReader
from wbc_controller.nodes.diagnostics.markers import read_shapes
from wbc_controller.nodes.wiring import make_vocabulary
from wbc_controller.records import Array, Reference, References

_MAX_AGE = 0.2  # of torques, forces and planned steps relative to the state, robot time, s


class TopicSource:
    """Reads the topics of a robot on request."""

    def __init__(self, session: Session, robot: Robot) -> None:
        self._session, self._robot = session, robot
        model, settings = robot.model, robot.settings
        measured = settings.estimation.joint_velocity == "measured"
        columns = ("position", "velocity") if measured else ("position",)
        self._joints = _Stream(session.poll("controller", "joint_states"), JointStateReader(model.joints, *columns))
        self._base = _Stream(session.poll("controller", "odom"), OdometryReader(model.base_link))
        self._commands = _Stream(session.poll("controller", "joint_commands"), JointStateReader(model.joints, "effort"))
        self._wrenches = {name: session.poll("controller", "contact_wrench", name) for name in settings.contacts}
        self._markers = session.poll("controller", "markers") if settings.walking is not None else lambda: None
        self._steps: tuple[int, list[Shape]] = 0, []
        self._forces: dict[str, tuple[int, Array]] = {}
        self._vocabulary = make_vocabulary(settings, model)
        self._listener = StatusListener(session, settings)
        self._status: RobotStatus | None = None
        self._status_at = -np.inf
        self._base_on_contacts = BaseOnContacts(robot)

    def snapshot(self) -> Snapshot:
        """Return the newest snapshot."""
        model = self._robot.model
        joints: JointStates = self._joints.update() or JointStates(stamp=0, position=model.posture)
        base: BaseState | None = self._base.update() if model.floating_base else None
        velocity = joints.velocity if len(joints.velocity) else np.zeros(model.nj)
        q, v = model.state(joints.position, velocity, *((base.pose, base.twist) if base is not None else ()))
        if model.floating_base and base is None:
            q = self._base_on_contacts.place(q)
        mode = self._session.mode()
        commands: JointStates | None = self._commands.update()
        return Snapshot(
            stamp=joints.stamp,
            age=time.monotonic() - self._joints.arrival,
            q=q,
            v=v,
            mode=mode,
            torques=commands.effort if commands is not None and _is_fresh(commands.stamp, joints.stamp) else None,
            forces=self._contact_forces(joints.stamp) if mode.startswith("active") else {},
            references=self._references() if mode.startswith(FOLLOWING) else None,
            steps=self._planned_steps(joints.stamp),
            status=self._status,
            silence=time.monotonic() - self._status_at,
            base_measured=base is not None or not model.floating_base,
        )

    def read_status(self) -> list[str]:
        """Read the status of the nodes, and return the refusals since the last call."""
        refused = []
        for status in self._listener.read_statuses():
            self._status_at = time.monotonic()
            refused += [value.value for value in status.values if value.key.startswith("refused/")]
        self._status = self._listener.newest()
        return refused

    def _contact_forces(self, stamp: int) -> dict[str, Array]:
        for name, newest in self._wrenches.items():
            payload = newest()
            if payload is not None:
                content = decode(payload, "geometry_msgs/msg/WrenchStamped")
                force, torque = content.wrench.force, content.wrench.torque
                wrench = np.array([force.x, force.y, force.z, torque.x, torque.y, torque.z])
                self._forces[name] = stamp_of(content), self._robot.contacts[name].basis.T @ wrench
        return {name: force for name, (time, force) in self._forces.items() if _is_fresh(time, stamp)}

    def _planned_steps(self, stamp: int) -> list[Shape]:
        payload = self._markers()
        if payload is not None:
            content = decode(payload, "visualization_msgs/msg/MarkerArray")
            time = stamp_of(content.markers[0]) if content.markers else 0
            self._steps = time, read_shapes(content, ("steps", "swing_paths"))
        return self._steps[1] if _is_fresh(self._steps[0], stamp) else []

    def _references(self) -> References | None:
        if self._status is None:
            return None
        values, tasks = self._status.values, dict[str, Reference]()
        for name, (_, content) in self._status.tasks.items():
            if content is not None:
                # The running controller may have another task of this name.
                with contextlib.suppress(InputRefused, ValueError):
                    (change,) = READERS["setpoint"](self._vocabulary, name, content)
                    tasks[name] = Reference(change.position, np.zeros(0), np.zeros(0))  # type: ignore[union-attr]
        weights = {name: float(values.get(f"task_weight/{name}", "0")) for name in tasks}
        return References(tasks, weights, {})


class _Stream:
    def __init__(self, poll: Callable[[], bytes | None], reader: StateReader) -> None:
        self._poll, self._reader = poll, reader
        self._newest: Any = None
        self.arrival = -np.inf

    def update(self) -> Any:
        """Return the reader's record of the newest valid message, or None."""
        payload = self._poll()
        if payload is not None:
            with contextlib.suppress(InputRefused):
                self._newest, self.arrival = self._reader.read(payload), time.monotonic()
        return self._newest


def _is_fresh(stamp: int, now: int) -> bool:
    return abs(now - stamp) <= 1.0e9 * _MAX_AGE


class BaseOnContacts:
    """Fits the base to the contacts of the nominal posture, for drawing only."""

    def __init__(self, robot: Robot) -> None:
        self._model, self._robot = robot.model, robot
        self._enabled = [name for name, contact in robot.settings.contacts.items() if contact.enabled]
        self._reference_points = self._points(self._model.configuration(self._model.posture))
        if len(self._reference_points):
            self._reference_points[:, 2] -= self._reference_points[:, 2].min()

    def _points(self, q: Array) -> Array:
        dynamics = self._robot.dynamics
        dynamics.update(q, np.zeros(self._model.nv))
        points = [self._robot.contacts[name].points(dynamics) for name in self._enabled]
        return np.vstack([np.zeros((0, 3)), *points])

    def place(self, q: Array) -> Array:
        """Return a configuration, (nq,), with the best fit of the base."""
        q = self._model.configuration(q[self._model.q_index])
        here = self._points(q)
        if not len(here):
            return q
        middle, reference_middle = here.mean(axis=0), self._reference_points.mean(axis=0)
        rotation = np.eye(3)
        if len(here) > 2:
            fitted, _ = Rotation.align_vectors(self._reference_points - reference_middle, here - middle)
            rotation = fitted.as_matrix()
        q[:7] = pin.SE3ToXYZQUAT(pin.SE3(rotation, reference_middle - rotation @ middle))
        return q
