"""What the controller sees and counts on, as a visualization_msgs/MarkerArray for RViz and Foxglove.

Everything is in the world frame. A kind of thing is a namespace, to be switched on and off by, and one marker where it
can be: markers cost more than points. What is no longer there is not deleted but goes with its lifetime, and so it
does when the controller dies.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pinocchio as pin
from scipy.spatial import ConvexHull, QhullError

from wbc_controller.core.contacts import Contact, UnilateralContact
from wbc_controller.core.dynamics import Dynamics
from wbc_controller.core.model import RobotModel
from wbc_controller.core.tasks import (
    CapturePointTask,
    ComTask,
    FramePoseTask,
    FramePositionTask,
    GazeTask,
    RelativePoseTask,
    Task,
)
from wbc_controller.messages import TYPES, header, message, stamp
from wbc_controller.records import Array, Reference, References, RobotState, Solution

WORLD_FRAME = "world"
#: Length of the arrow for a force as large as the robot's weight, m.
FORCE_LENGTH = 0.5
#: Height of the friction cones, m.
CONE_HEIGHT = 0.1
#: Below this normal force, in weights of the robot, a contact has no centre of pressure.
_LOADED = 1.0e-3
#: Below this height of the centre of mass there is no pendulum, m.
_LOWEST_PENDULUM = 0.1

_ARROW, _LINE_STRIP, _LINE_LIST, _SPHERE_LIST = 0, 4, 5, 7
_COLORS = {
    "contact_forces": (0.9, 0.2, 0.2, 1.0),
    "friction_cones": (0.9, 0.6, 0.2, 0.6),
    "contacts": (0.6, 0.6, 0.6, 1.0),
    "support": (0.2, 0.7, 0.3, 1.0),
    "com": (0.95, 0.85, 0.2, 1.0),
    "capture_point": (0.2, 0.5, 0.95, 1.0),
    "references": (0.8, 0.3, 0.9, 1.0),
    "task_errors": (0.8, 0.3, 0.9, 1.0),
}


class MarkerScene:
    """Draws one state with what is wanted and what was answered."""

    def __init__(
        self, model: RobotModel, tasks: Mapping[str, Task], contacts: Mapping[str, Contact], lifetime: float
    ) -> None:
        """Make a scene.

        Args:
            model: the robot's model.
            tasks: by name.
            contacts: by name.
            lifetime: time after which a marker that was not sent again goes, s; none where it is not finite.
        """
        self._tasks, self._contacts = tasks, contacts
        self._lifetime = _duration(lifetime)
        # One of its own: the controller's snapshot is that of its last solution, and is not to be touched.
        self._dynamics = Dynamics(model)
        self._weight = model.mass * model.gravity

    def message(self, state: RobotState, references: References | None, solution: Solution | None) -> Any:
        """Make the message.

        Args:
            state: where the robot is.
            references: what is wanted, where the controller is active.
            solution: its answer, if there is one.
        """
        dynamics = self._dynamics
        dynamics.update(state.q, state.v)
        forces = solution.forces if solution is not None else {}
        corners = {name: contact.points(dynamics) for name, contact in self._contacts.items()}
        feet = [name for name in (forces or corners) if _supports(self._contacts[name])]
        standing = np.array([point for name in feet for point in corners[name]]).reshape(-1, 3)
        ground = float(np.mean(standing[:, 2])) if len(standing) else 0.0
        made = []
        outlines = [edge for points in corners.values() if len(points) > 2 for edge in _edges(points)]
        made.append(self._marker(state, "contacts", 0, _LINE_LIST, (0.004, 0.0, 0.0), outlines))
        cones: list[Array] = []
        for i, name in enumerate(self._contacts):
            if name in forces:
                arrow, pyramid = self._contact(self._contacts[name], forces[name], corners[name])
                made.append(self._marker(state, "contact_forces", i, _ARROW, (0.012, 0.024, 0.03), arrow))
                cones += pyramid
        made.append(self._marker(state, "friction_cones", 0, _LINE_LIST, (0.003, 0.0, 0.0), cones))
        if forces and feet:
            outline = _outline(standing[:, :2])
            hull = [np.append(point, ground) for point in outline]
            made.append(self._marker(state, "support", 0, _LINE_STRIP, (0.008, 0.0, 0.0), hull))
        made += self._balance(state, ground)
        if references is not None:
            made += self._errors(state, references, ground)
        return message("visualization_msgs/msg/MarkerArray", markers=[marker for marker in made if marker is not None])

    def _contact(self, contact: Contact, force: Array, corners: Array) -> tuple[list[Array], list[Array]]:
        """The force at its centre of pressure, and the edges of the pyramid that it must stay in."""
        dynamics, centre = self._dynamics, corners.mean(axis=0)
        wrench = contact.wrench_in_world(dynamics, force)
        if not isinstance(contact, UnilateralContact):
            return [centre, centre + FORCE_LENGTH / self._weight * wrench[:3]], []
        axes = [contact.wrench_in_world(dynamics, unit)[:3] for unit in np.eye(contact.size)[:3]]
        normal = axes[contact.normal]
        origin = centre
        pressure = float(normal @ wrench[:3])
        if pressure > _LOADED * self._weight:
            torque = wrench[3:] - pin.skew(centre) @ wrench[:3]
            origin = centre + pin.skew(normal) @ torque / pressure
        arrow = [origin, origin + FORCE_LENGTH / self._weight * wrench[:3]]
        x, y = (CONE_HEIGHT * contact.friction / math.sqrt(2.0) * axes[i] for i in range(3) if i != contact.normal)
        above = centre + CONE_HEIGHT * normal
        top = [above + x + y, above + x - y, above - x - y, above - x + y]
        return arrow, [point for corner in top for point in (centre, corner)] + _edges(top)

    def _balance(self, state: RobotState, ground: float) -> list[Any]:
        """The centre of mass, its projection onto the ground, and the capture point there."""
        dynamics = self._dynamics
        com = np.array(dynamics.com)
        below = np.array([com[0], com[1], ground])
        made = [
            self._marker(state, "com", 0, _SPHERE_LIST, (0.04, 0.04, 0.04), [com, below]),
            self._marker(state, "com", 1, _LINE_LIST, (0.004, 0.0, 0.0), [com, below]),
        ]
        if dynamics.model.floating_base:
            omega = math.sqrt(dynamics.model.gravity / max(com[2] - ground, _LOWEST_PENDULUM))
            point = below + np.append(dynamics.com_velocity[:2] / omega, 0.0)
            made.append(self._marker(state, "capture_point", 0, _SPHERE_LIST, (0.03, 0.03, 0.03), [point]))
        return made

    def _errors(self, state: RobotState, references: References, ground: float) -> list[Any]:
        """Lines from where each task's point is to where it should be, of the tasks that have a place."""
        lines: list[Array] = []
        for name, task in self._tasks.items():
            if name in references.tasks and references.weights.get(name, 0.0) > 0.0:
                lines += _from_to(task, self._dynamics, references.tasks[name], ground)
        return [
            self._marker(state, "task_errors", 0, _LINE_LIST, (0.006, 0.0, 0.0), lines),
            self._marker(state, "references", 0, _SPHERE_LIST, (0.02, 0.02, 0.02), lines[1::2]),
        ]

    def _marker(
        self,
        state: RobotState,
        namespace: str,
        number: int,
        kind: int,
        scale: tuple[float, float, float],
        points: Sequence[Array],
    ) -> Any:
        """One marker in the colour of its namespace; None without points, of which RViz would complain."""
        if not len(points):
            return None
        r, g, b, a = _COLORS[namespace]
        x, y, z = scale
        return message(
            "visualization_msgs/msg/Marker",
            header=header(state.stamp, WORLD_FRAME),
            ns=namespace,
            id=number,
            type=kind,
            action=0,
            pose=_IDENTITY,
            scale=message("geometry_msgs/msg/Vector3", x=x, y=y, z=z),
            color=message("std_msgs/msg/ColorRGBA", r=r, g=g, b=b, a=a),
            lifetime=self._lifetime,
            frame_locked=False,
            points=[_Point(x, y, z) for x, y, z in np.asarray(points).tolist()],
            colors=[],
            texture_resource="",
            texture=_NO_TEXTURE,
            uv_coordinates=[],
            text="",
            mesh_resource="",
            mesh_file=_NO_MESH,
            mesh_use_embedded_materials=False,
        )


def _from_to(task: Task, dynamics: Dynamics, reference: Reference, ground: float) -> list[Array]:
    """Where a task's point is and where it should be, in the world; nothing for a task that has no place."""
    wanted = reference.position
    if isinstance(task, ComTask | FramePositionTask | FramePoseTask):
        return [task.position(dynamics)[:3], wanted[:3]]
    if isinstance(task, CapturePointTask):
        return [np.append(task.position(dynamics), ground), np.append(wanted, ground)]
    if isinstance(task, RelativePoseTask | GazeTask):
        model = dynamics.model
        at = dynamics.placement(model.frame_id(task.frame, task.name))
        if isinstance(task, GazeTask):
            return [at.translation, wanted[:3]]
        observer = dynamics.placement(model.frame_id(task.reference_frame, task.name))
        return [at.translation, observer.act(wanted[:3])]
    return []


def _supports(contact: Contact) -> bool:
    """Whether a contact carries the robot on the world: not where it is held, nor between two links."""
    return isinstance(contact, UnilateralContact) and not contact.internal


def _edges(corners: Sequence[Array] | Array) -> list[Array]:
    """A closed outline as pairs of points."""
    return [corners[j % len(corners)] for i in range(len(corners)) for j in (i, i + 1)]


def _outline(points: Array) -> Array:
    """The convex hull of points on the ground, (n, 2), in order and closed; empty where they span no area."""
    try:
        hull = points[ConvexHull(points).vertices]
    except (QhullError, ValueError):  # less than three, or on a line
        return np.zeros((0, 2))
    return np.concatenate([hull, hull[:1]])


def _duration(seconds: float) -> Any:
    time = stamp(round(1.0e9 * seconds) if math.isfinite(seconds) else 0)
    return message("builtin_interfaces/msg/Duration", sec=time.sec, nanosec=time.nanosec)


_Point = TYPES.types["geometry_msgs/msg/Point"]
_IDENTITY = message(
    "geometry_msgs/msg/Pose",
    position=message("geometry_msgs/msg/Point", x=0.0, y=0.0, z=0.0),
    orientation=message("geometry_msgs/msg/Quaternion", x=0.0, y=0.0, z=0.0, w=1.0),
)
_NO_TEXTURE = message("sensor_msgs/msg/CompressedImage", header=header(0), format="", data=np.zeros(0, dtype=np.uint8))
_NO_MESH = message("visualization_msgs/msg/MeshFile", filename="", data=np.zeros(0, dtype=np.uint8))
